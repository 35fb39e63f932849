//! Tests that need no ROS graph and take seconds; longer ones are in `tests/soak`.
#![cfg(feature = "cli")]
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stderr, clippy::print_stdout)]
#![allow(clippy::float_cmp, clippy::cast_possible_truncation, clippy::cast_sign_loss)]

mod app;
mod bag;
mod cases;
mod clouds;
#[path = "../common/mod.rs"]
mod common;
mod contract;
mod convert;
mod correspondences;
mod covariance;
mod documents;
mod drive;
mod evaluation;
mod fuzz;
mod initial_pose;
mod late_odometry;
mod layers;
#[cfg(target_os = "linux")]
mod licences;
mod live_map;
mod localization;
mod mapping;
mod no_allocation;
mod odometry_frames;
mod plotjuggler;
mod profile;
mod raycasting;
mod refinement;
mod replay;
mod sensitivity;
#[cfg(target_os = "linux")]
mod shared_memory;
mod shell;
mod shipped_map;
mod simulation;
mod solvers;
mod terminal;
