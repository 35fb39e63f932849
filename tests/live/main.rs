//! The nodes on a live ROS graph: a real master, rosbag, rostopic, rosnode, roslaunch, `RViz` and catkin.
#![cfg(feature = "ros")]
#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stderr, unreachable_pub)]

#[path = "../common/mod.rs"]
mod common;
mod compat;
mod contracts;
#[cfg(target_os = "linux")]
mod faults;
mod localization;
mod mapper;
mod mounts;
mod node;
mod path_follower;
mod peer;
mod racecar_sim;
mod runtime;
mod rviz;
