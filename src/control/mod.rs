//! Path following: computes speed and steering angle from a path and delayed poses.
//!
//! ```text
//!  path ──► Progress ──► Projection ──► law ──► curvature ──┐
//!                            ▲     └──► speed profile ──────┼──► Command ──► history ─┐
//!  pose ──► predicted to when the command takes effect ─────┘                         │
//!             ▲─────────────────────────────────────────────── using recent commands ─┘
//! ```
//!
//! The published steering angle is that of the command minus the [`trim`], which is learned from the difference between actual
//! and commanded heading change.
//!
//! [`follower::Follower`] combines these; the node and the closed-loop simulation both use it. Each file in [`laws`] is a control
//! law, each file in [`policy`] is a policy that chooses the time contract of the pose estimator.

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
