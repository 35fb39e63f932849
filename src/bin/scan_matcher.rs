//! The scan matcher as a ROS 1 node.
#![allow(clippy::print_stdout, clippy::print_stderr)] // a program speaks to its user

mod node_program;

use std::process::ExitCode;

use anytime_scan_matcher::config::Config;
use anytime_scan_matcher::ros;
use node_program::{NodeProgram, own_arguments};

const USAGE: &str = "\
Matches laser scans and publishes the robot's pose. A ROS 1 node; if there is no master yet, it waits for one.

Usage: scan_matcher [--compat laser_scan_matcher] [TOPIC:=OTHER_TOPIC]... [_PARAMETER:=VALUE]... [__name:=NAME] [__ns:=NAMESPACE]

With --compat it also accepts the parameters of laser_scan_matcher and publishes its topics: pose2D, pose_stamped,
pose_with_covariance, pose_with_covariance_stamped.

Subscribes to:  scan or cloud, odom, imu/data, vel, icp_contract, icp_interrupt, initialpose, /tf, /tf_static
Publishes:      scan_match_location, icp_state, icp/odom, icp_report, icp/path, scan_match_debug, /tf, /diagnostics
Service:        ~reset

Parameters, in the node's private namespace (such as ~matching/max_iterations) or in the YAML file named by ~config:";

/// The arguments that make the node a replacement for `laser_scan_matcher`.
const COMPAT: [&str; 2] = ["--compat", "laser_scan_matcher"];

fn main() -> ExitCode {
    let parameters = Config::default().table();
    let mut arguments = own_arguments();
    let run = if arguments.starts_with(&COMPAT.map(String::from)) {
        arguments.drain(..COMPAT.len());
        ros::run_as_laser_scan_matcher
    } else {
        ros::run
    };
    NodeProgram { name: "scan_matcher", usage: USAGE, parameters, run }.main(&arguments)
}
