//! The particle filter as a ROS 1 node.
#![allow(clippy::print_stdout, clippy::print_stderr)] // a program speaks to its user

mod node_program;

use std::process::ExitCode;

use anytime_scan_matcher::config::Config;
use anytime_scan_matcher::ros::particle_filter;
use node_program::{NodeProgram, own_arguments};

const USAGE: &str = "\
Localizes the robot on a map with a particle filter and publishes its pose. A ROS 1 node; if there is no master yet, it waits for one.

Usage: particle_filter [TOPIC:=OTHER_TOPIC]... [_PARAMETER:=VALUE]... [__name:=NAME] [__ns:=NAMESPACE]

Subscribes to:  scan or cloud, odom, map, initialpose, clicked_point, icp_contract, /tf, /tf_static
Publishes:      pf/pose/odom, pf/report, pf/viz/particles, pf/viz/inferred_pose, pf/viz/fake_scan, /tf, /diagnostics,
                and map, map_metadata if the map is read from a file
Services:       ~global_localization, static_map

Parameters, in the node's private namespace (such as ~localization/map) or in the YAML file named by ~config:";

fn main() -> ExitCode {
    let is_used = |path: &str| {
        ["localization", "contract", "odometry.laser", "odometry.max_wait"].iter().any(|used| path.starts_with(used))
    };
    let parameters = Config::default().table().into_iter().filter(|(path, _)| is_used(path) || !path.contains('.')).collect();
    NodeProgram { name: "particle_filter", usage: USAGE, parameters, run: particle_filter::run }.main(&own_arguments())
}
