//! Accuracy of the estimates over many drives, pairs of scans and long logs; each test takes some ten seconds.
#![cfg(feature = "cli")]
#![allow(clippy::unwrap_used, clippy::print_stderr, clippy::print_stdout, clippy::cast_possible_truncation)]

mod accuracy;
#[path = "../common/mod.rs"]
mod common;
mod live_map;
mod localization;
mod log_variants;
mod logs;
mod mapping;
mod odometry;
