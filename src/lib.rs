//! Anytime 2D laser scan matching for ROS 1.

pub mod anytime;
pub mod app;
pub mod config;
pub mod evaluation;
pub mod geometry;
pub mod io;
pub mod knobs;
pub mod matching;
pub mod messages;
pub mod odometry;
pub mod replay;
#[cfg(feature = "ros")]
pub mod ros;
pub mod scan;
pub mod simulation;
pub mod time;
pub mod transforms;
