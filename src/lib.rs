//! Anytime 2D laser scan matching for ROS 1: a pose within the time you allow, and how good it is.
//!
//! ```
//! use anytime_scan_matcher::matching::classic::rejection::RejectionKnobs;
//! use anytime_scan_matcher::matching::{Matcher, MatchingKnobs};
//! use anytime_scan_matcher::simulation::pairs::Pairs;
//! use anytime_scan_matcher::simulation::random_world::RandomWorld;
//!
//! // Two simulated scans of a room, and a guess of the motion between them that is 15 mm and 0.6 degrees off.
//! let pair = Pairs::new(RandomWorld::Room, 1081, 1).next().expect("pairs never end");
//!
//! let mut matcher = Matcher::new(&MatchingKnobs::default(), &RejectionKnobs::default());
//! matcher.set_reference(&pair.reference);
//! let mut refinement = matcher.begin(&pair.sensed, pair.first_guess);
//! while refinement.refine().is_none() {} // stop whenever you like: `pose` is the best one so far
//!
//! let error = pair.reference_from_sensed.between(&refinement.pose());
//! assert!(error.distance() < 0.005 && error.theta.abs() < 0.001);
//! ```
//!
//! More in `examples/`: odometry over a bag, a search and a solver of one's own, a controller with contracts. `ARCHITECTURE.md` says where
//! to add what, `docs/mathematics.md` has the formulas.
//!
//! # How a scan becomes a pose
//!
//! ```text
//!  LaserScan ──► Scan ──► prediction ──► pairs with the ──► quadratic ──► solve ──► pose ──► Estimate ──► messages, files
//!  (messages)   (scan)   (odometry::    views around       form          (matching::         (app)       (ros, replay)
//!                         wheel)         (surfaces or classic)            solver)
//!                                       └────────── Refinement::refine, until the contract ends (anytime::drive) ─────────┘
//! ```
//!
//! The node (`ros`, behind the feature of that name) and the offline tool ([`replay`]) feed the same [`app::App`]: a replay is what
//! ran live.
//!
//! # Where things are
//!
//! From the bottom up; a module knows only modules below its own (`tests/offline/layers.rs` holds this against the imports).
//!
//! | module | what it is |
//! |---|---|
//! | [`time`], [`geometry`] | stamps to the nanosecond; poses of the plane, named `odom_from_base` |
//! | [`quantile`] | quantiles in linear time |
//! | [`output`] | files that are in their place once they are whole |
//! | `parallel` | work that threads share |
//! | `text_table` | tables that fit the terminal |
//! | [`knobs`](mod@knobs) | parameters, each declared once |
//! | [`map`] | occupancy grids, distances in them |
//! | [`raycasting`] | how far a beam goes in a map: four methods |
//! | [`messages`] | ROS messages and their wire form, with or without ROS |
//! | [`scan`], [`transforms`] | a checked scan; where `/tf` says the laser is |
//! | `shared_memory` | on Linux: a controller on the same machine calls for the answer now and reads it, without ROS |
//! | [`cloud`] | point clouds as scans |
//! | [`matching`] | PL-ICP and its relatives: `begin()`, `refine()`, best so far |
//! | [`simulation`] | worlds, a lidar, a car, its odometry |
//! | [`evaluation`] | ATE, RPE, relations, plots |
//! | [`anytime`] | contracts, clocks, and refining until the contract ends |
//! | [`odometry`] | predict, match, keep the map of keyframes: one scan to one pose |
//! | [`control`] | follows paths, and chooses contracts |
//! | [`localization`] | a particle filter: where on a map |
//! | [`mapping`] | keyframes, a pose graph, loops, and the grid that comes of them |
//! | [`io`] | bags, CARMEN logs, trajectories, relations, maps |
//! | [`config`] | every module's knobs under one roof: YAML, ROS parameters, `--set`, docs/parameters.md |
//! | [`app`] | messages in, estimates out |
//! | [`replay`], `ros` | a bag, or a live graph, through the application |
//! | [`profile`] | many replays: delay against error |
//! | [`drive`](mod@drive) | the closed loop offline: simulator, estimator and follower on a modelled processor |
//!
//! # What always holds
//!
//! - [`matching`] never reads a clock, prints or panics, and its warm loop never allocates (`tests/offline/no_allocation.rs`).
//! - Every scan gets exactly one answer. One that cannot be matched, or read, is answered with the prediction, and says why.
//! - Stamps are those of the scans. Nothing a message says depends on the time it is handled at, except what measures that time.
//! - With no time budget, or on the virtual clock, the same input gives the same output, to the last bit.
//! - Bytes from outside are checked before they are used: a bad message, file or parameter is an error that names its place and its
//!   remedy, never a panic.
//! - Only `ros` knows rosrust; only the programs read arguments; only `shared_memory::mapping` is unsafe, and one line of
//!   `ros::node_api`.

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
