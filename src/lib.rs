//! Anytime 2D laser scan matching for ROS 1: a pose within a given time budget, with its uncertainty.
//!
//! ```
//! use anytime_scan_matcher::matching::classic::rejection::RejectionKnobs;
//! use anytime_scan_matcher::matching::{Matcher, MatchingKnobs};
//! use anytime_scan_matcher::simulation::pairs::Pairs;
//! use anytime_scan_matcher::simulation::random_world::RandomWorld;
//!
//! // Two simulated scans of a room, and an initial guess of the motion between them, with an error of 15 mm and 0.6 degrees.
//! let pair = Pairs::new(RandomWorld::Room, 1081, 1).next().expect("pairs never end");
//!
//! let mut matcher = Matcher::new(&MatchingKnobs::default(), &RejectionKnobs::default());
//! matcher.set_reference(&pair.reference);
//! let mut refinement = matcher.begin(&pair.sensed, pair.first_guess);
//! while refinement.refine().is_none() {} // stop at any time: `pose` is the best pose so far
//!
//! let error = pair.reference_from_sensed.between(&refinement.pose());
//! assert!(error.distance() < 0.005 && error.theta.abs() < 0.001);
//! ```
//!
//! `examples/` has more: odometry over a bag, a custom correspondence search, a custom solver, a controller with contracts.
//! `ARCHITECTURE.md` describes where to add what, and `docs/mathematics.md` has the formulas.
//!
//! # How a scan becomes a pose
//!
//! ```text
//!  LaserScan ──► Scan ──► prediction ──► correspondences ──► quadratic ──► solve ──► pose ──► Estimate ──► messages, files
//!  (messages)    (scan)   (odometry::    with nearby views   form          (matching::        (app)        (ros, replay)
//!                         wheel)         (surfaces, classic)               solver)
//!                                        └ Refinement::refine, until the contract ends (anytime module) ┘
//! ```
//!
//! The node (`ros`, behind the feature of that name) and the offline tool ([`replay`]) use the same [`app::App`]: a replay runs the
//! same code as the live node.
//!
//! # Modules
//!
//! From the bottom up: a module imports only modules below it (`tests/offline/layers.rs` checks the imports).
//!
//! | module | contents |
//! |---|---|
//! | [`time`], [`geometry`] | stamps in nanoseconds; poses in the plane, named like `odom_from_base` |
//! | [`quantile`] | quantiles in linear time |
//! | [`output`] | output files that are renamed into place when complete |
//! | `parallel` | parallel work on several threads |
//! | `text_table` | text tables that fit the terminal |
//! | [`knobs`](mod@knobs) | parameters, each declared once |
//! | [`map`] | occupancy grids and their distance fields |
//! | [`raycasting`] | ray casting in a map: four methods |
//! | [`messages`] | ROS messages and their serialization, with or without ROS |
//! | [`scan`], [`transforms`] | validated scans; the pose of the laser from `/tf` |
//! | `shared_memory` | on Linux: lets a controller on the same machine request an answer now and read it, without ROS |
//! | [`cloud`] | conversion of point clouds to scans |
//! | [`matching`] | PL-ICP and its variants: `begin()`, `refine()`, best pose so far |
//! | [`simulation`] | simulated worlds, lidar, car and odometry |
//! | [`evaluation`] | ATE, RPE, relations, plots |
//! | [`anytime`] | contracts, clocks, and refinement until the contract ends |
//! | [`odometry`] | from a scan to a pose: prediction, matching, the local map of keyframes |
//! | [`control`] | path following, and the choice of contracts |
//! | [`localization`] | particle filter: localization on a map |
//! | [`mapping`] | keyframes, pose graph, loop closures, and the resulting occupancy grid |
//! | [`io`] | bags, CARMEN logs, trajectories, relations, maps |
//! | [`config`] | all parameters together: YAML, ROS parameters, `--set`, docs/parameters.md |
//! | [`app`] | messages in, estimates out |
//! | [`replay`], `ros` | drivers of the application: from a bag, or on a live ROS graph |
//! | [`profile`] | many replays: error as a function of delay |
//! | [`drive`](mod@drive) | closed loop offline: simulator, estimator and path follower on a modelled processor |
//!
//! # Invariants
//!
//! - [`matching`] never reads a clock, prints or panics, and allocates nothing after warm-up (`tests/offline/no_allocation.rs`).
//! - Every scan gets exactly one answer, or is counted as dropped. If it cannot be matched or read, the answer is the prediction
//!   with the reason.
//! - Stamps are those of the scans. No content of a message depends on when it is handled, except measurements of that time.
//! - Without a time budget, or on the virtual clock, the same input gives the same output to the last bit.
//! - External data is checked before use: an invalid message, file or parameter is an error that states where it is and how to
//!   fix it, never a panic.
//! - Only `ros` depends on rosrust; only the programs read arguments; only `shared_memory::mapping` and one line of `ros::node_api`
//!   are unsafe.

#![cfg_attr(test, allow(clippy::unwrap_used, clippy::panic, clippy::cast_possible_truncation))]

pub mod anytime;
#[cfg(feature = "cli")]
pub mod app;
pub mod cloud;
#[cfg(feature = "cli")]
pub mod config;
pub mod control;
#[cfg(feature = "cli")]
pub mod drive;
pub mod evaluation;
pub mod geometry;
#[cfg(feature = "cli")]
pub mod io;
pub mod knobs;
pub mod localization;
pub mod map;
pub mod mapping;
pub mod matching;
pub mod messages;
pub mod odometry;
pub mod output;
mod parallel;
#[cfg(feature = "cli")]
pub mod profile;
pub mod quantile;
pub mod raycasting;
#[cfg(feature = "cli")]
pub mod replay;
#[cfg(feature = "ros")]
pub mod ros;
pub mod scan;
#[cfg(all(feature = "cli", target_os = "linux"))]
pub mod shared_memory;
pub mod simulation;
#[cfg(feature = "cli")]
mod text_table;
pub mod time;
pub mod transforms;
