//! The car drives itself: from a path and poses that come late to a speed and a steering angle.
//!
//! ```text
//!  path ──► Progress ──► Projection ──► law ──► curvature ──┐
//!                            ▲     └──► speed profile ──────┼──► Command ──► history ─┐
//!  pose ──► carried from its stamp to when the command acts ┘                         │
//!             ▲──────────────────────────────────────────────── by the last commands ─┘
//! ```
//!
//! What the wheels are told is the steering angle of the command less the [`trim`], which is learned from how far the car turns otherwise
//! than commanded.
//!
//! [`follower::Follower`] puts this together; the node and the closed loop offline both drive it. A [`laws`] file is one control law, a
//! [`policy`] file is one way to choose the time contract of the estimator that the poses come from.

pub mod delay;
pub mod follower;
pub mod laws;
pub mod path;
pub mod policy;
pub mod progress;
pub mod safety;
pub mod speed;
pub mod trim;
pub mod waypoint_file;
