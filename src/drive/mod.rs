//! Closed-loop simulation: simulator, pose estimator and path follower in one process, on a simulated clock.
//!
//! ```text
//!  car ──► lidar, odometer ──► estimator ──► answer, delayed by its cost ──► follower ──► command, delayed by the actuator ──► car
//!                                  ▲ terms                                      │
//!                                  └─────────── policy ◄── situation ───────────┘
//! ```
//!
//! Every answer becomes available when it would have been ready on a real machine: each piece of work takes its typical time
//! (`costs`) on a simulated [`processor`] that other programs load. A run is therefore bitwise reproducible on any machine, and
//! faster than real time.

mod closed_loop;
mod costs;
pub mod course;
mod estimator;
pub mod figures;
pub mod flaws;
mod page;
mod pictures;
pub mod processor;
mod profiling;
mod replanning;
pub mod study;

use std::io;
use std::path::PathBuf;

use thiserror::Error;

use crate::anytime::contract::ContractError;
use crate::app::StartError;
use crate::app::localizer::LocalizerError;
use crate::choices;
use crate::control::path::PathError;
use crate::control::waypoint_file::WaypointFileError;
use crate::evaluation::plot::PlotError;
use crate::io::cost_file::CostFileError;
use crate::io::map_file::MapError;
use crate::io::profile_file::ProfileFileError;
use crate::simulation::planner::NoLoop;

choices! {
    /// The source of the follower's poses.
    pub enum EstimatorKind {
        /// The true poses of the simulator.
        Truth = "truth",
        /// Laser odometry by scan matching.
        ScanMatcher = "scan_matcher",
        /// The particle filter on a map.
        ParticleFilter = "particle_filter",
    }
}

/// Why a drive is not possible.
#[derive(Debug, Error)]
pub enum DriveError {
    /// The world cannot be read.
    #[error(transparent)]
    Map(#[from] MapError),
    /// There is no loop to drive in the world.
    #[error("no loop to drive was found in this world; give a path with --path FILE.csv")]
    Route(#[from] NoLoop),
    /// A file cannot be read or written.
    #[error("{}: {problem}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// The operating system's error.
        problem: io::Error,
    },
    /// The file is not a valid waypoint file.
    #[error("{}: {problem}", path.display())]
    Waypoints {
        /// The file.
        path: PathBuf,
        /// The invalid line.
        problem: WaypointFileError,
    },
    /// The waypoints form no valid path.
    #[error("{}: {problem}", path.display())]
    Path {
        /// The file.
        path: PathBuf,
        /// What is wrong with the waypoints.
        problem: PathError,
    },
    /// The path starts in or at a wall.
    #[error("the path begins at ({x:.2}, {y:.2}), where the car touches a wall: does the path belong to this world?")]
    InWall {
        /// x of the first point, m.
        x: f64,
        /// y of the first point, m.
        y: f64,
    },
    /// Several laps need a closed path.
    #[error("an open path allows only one lap: give --laps 1, or close the path")]
    OpenPath,
    /// The particle filter needs a map.
    #[error(
        "estimator particle_filter: the world '{0}' has no map; give the YAML file of a map to --world (maps/corridor.yaml is the map of 'corridor')"
    )]
    NoMap(String),
    /// The estimator cannot start.
    #[error(transparent)]
    Localizer(#[from] LocalizerError),
    /// The scan matcher cannot start.
    #[error(transparent)]
    Start(#[from] StartError),
    /// The configured contract is invalid.
    #[error(transparent)]
    Contract(#[from] ContractError),
    /// The profile cannot be read.
    #[error(transparent)]
    Profile(#[from] ProfileFileError),
    /// The cost file cannot be read.
    #[error(transparent)]
    Costs(#[from] CostFileError),
    /// A plot cannot be rendered.
    #[error(transparent)]
    Plot(#[from] PlotError),
}
