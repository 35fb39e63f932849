//! Anytime 2D laser scan matching for ROS 1.

pub mod evaluation;
pub mod geometry;
pub mod io;
pub mod knobs;
pub mod messages;
pub mod scan;
pub mod simulation;
pub mod time;
