//! A controller that follows paths.
#![allow(clippy::print_stdout, clippy::print_stderr)] // a program speaks to its user

mod node_program;

use std::process::ExitCode;

use anytime_scan_matcher::knobs::KnobGroup as _;
use anytime_scan_matcher::ros::path_follower::{self, AllKnobs};
use node_program::{NodeProgram, own_arguments};

const USAGE: &str = "\
Follows a path, compensating the delay of the pose estimates. A ROS 1 node; if there is no master yet, it waits for one.

Usage: path_follower [TOPIC:=OTHER_TOPIC]... [_PARAMETER:=VALUE]... [__name:=NAME] [__ns:=NAMESPACE]

Subscribes to:  pose (nav_msgs/Odometry), path (nav_msgs/Path), scan (the emergency brake), /tf, /tf_static,
                move_base_simple/goal and map (to plan a path to the goal)
Publishes:      drive (ackermann_msgs/AckermannDriveStamped), follower/report, follower/viz
Service:        ~resume (drives on after an emergency stop)

Parameters, in the node's private namespace (such as ~speed):";

fn main() -> ExitCode {
    let parameters = AllKnobs::default().table().into_iter().map(|knob| (knob.name.into(), knob)).collect();
    NodeProgram { name: "path_follower", usage: USAGE, parameters, run: path_follower::run }.main(&own_arguments())
}
