//! The ROS 1 node.
#![allow(clippy::print_stdout, clippy::print_stderr)] // a program speaks to its user

use std::process::ExitCode;

use anytime_scan_matcher::config::Config;
use anytime_scan_matcher::ros;

const USAGE: &str = "\
Matches laser scans and publishes where the robot is. A ROS 1 node; waits for the master when there is none.

Usage: scan_matcher [TOPIC:=OTHER_TOPIC]... [_PARAMETER:=VALUE]... [__name:=NAME] [__ns:=NAMESPACE]

Subscribes to:  scan, odom, icp_contract, initialpose, /tf, /tf_static
Publishes:      scan_match_location, icp_state, icp/odom, icp_report, icp/path, scan_match_debug, /tf, /diagnostics
Service:        ~reset

Parameters, in the node's private namespace (~matching/max_iterations), or in the YAML file that ~config names:";

fn main() -> ExitCode {
    match unknown_argument() {
        None => {}
        Some(argument) if ["-h", "--help"].contains(&argument.as_str()) => {
            println!("{USAGE}");
            for (path, knob) in Config::default().table() {
                println!("  {path} ({}; default {}): {}", knob.accepts, knob.default, knob.help);
            }
            return ExitCode::SUCCESS;
        }
        Some(argument) if ["-V", "--version"].contains(&argument.as_str()) => {
            println!("scan_matcher {}", env!("CARGO_PKG_VERSION"));
            return ExitCode::SUCCESS;
        }
        Some(argument) => {
            eprintln!("scan_matcher: unexpected argument '{argument}': see scan_matcher --help");
            return ExitCode::from(2);
        }
    }
    match ros::run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("scan_matcher: {error}");
            ExitCode::FAILURE
        }
    }
}

/// The first argument that is not ROS's.
fn unknown_argument() -> Option<String> {
    std::env::args_os().skip(1).map(|argument| argument.to_string_lossy().into_owned()).find(|argument| !argument.contains(":="))
}
