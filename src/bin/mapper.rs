//! The scan matcher with a map, as a ROS 1 node.
#![allow(clippy::print_stdout, clippy::print_stderr)] // a program speaks to its user

mod node_program;

use std::process::ExitCode;

use anytime_scan_matcher::config::Config;
use anytime_scan_matcher::ros;
use node_program::{NodeProgram, own_arguments};

const USAGE: &str = "\
Matches laser scans and builds a map from them while the robot drives. A ROS 1 node; if there is no master yet, it waits for one.

Usage: mapper [TOPIC:=OTHER_TOPIC]... [_PARAMETER:=VALUE]... [__name:=NAME] [__ns:=NAMESPACE]

Subscribes to:  the topics of scan_matcher
Publishes:      the topics of scan_matcher, and map, map_metadata, mapper/graph
Services:       those of scan_matcher, and dynamic_map, ~save_map

Parameters, in the node's private namespace (such as ~mapping/resolution) or in the YAML file named by ~config:";

fn main() -> ExitCode {
    let is_used = |path: &str| !path.starts_with("localization");
    let parameters = Config::default().table().into_iter().filter(|(path, _)| is_used(path)).collect();
    NodeProgram { name: "mapper", usage: USAGE, parameters, run: ros::run_mapper }.main(&own_arguments())
}
