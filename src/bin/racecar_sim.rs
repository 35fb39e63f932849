//! A simulated racecar.
#![allow(clippy::print_stdout, clippy::print_stderr)] // a program speaks to its user

mod node_program;

use std::process::ExitCode;

use anytime_scan_matcher::knobs::KnobGroup as _;
use anytime_scan_matcher::ros::racecar_sim::{self, RacecarSimKnobs};
use node_program::{NodeProgram, own_arguments};

const USAGE: &str = "\
Simulates a racecar with a laser in real time, like F1TENTH's racecar_simulator. A ROS 1 node; if there is no master yet, it waits for
one.

Usage: racecar_sim [TOPIC:=OTHER_TOPIC]... [_PARAMETER:=VALUE]... [__name:=NAME] [__ns:=NAMESPACE]

Subscribes to:  drive (ackermann_msgs/AckermannDriveStamped), cmd_vel (geometry_msgs/Twist),
                pose and initialpose (both set the pose of the car)
Publishes:      scan, odom, gt_pose, /tf

Parameters, in the node's private namespace (such as ~world):";

fn main() -> ExitCode {
    let parameters = RacecarSimKnobs::default().table().into_iter().map(|knob| (knob.name.into(), knob)).collect();
    NodeProgram { name: "racecar_sim", usage: USAGE, parameters, run: racecar_sim::run }.main(&own_arguments())
}
