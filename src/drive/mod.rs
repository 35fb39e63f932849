//! The closed loop, offline: simulator, estimator and follower in one process, on a clock that is modelled.
//!
//! ```text
//!  car ──► lidar, odometer ──► estimator ──► answer, late by what it costs ──► follower ──► command, late by the actuator ──► car
//!                                 ▲ terms                                          │
//!                                 └───────────── policy ◄── situation ─────────────┘
//! ```
//!
//! Every answer takes effect when it would have been ready: the work done for it, at what it costs on a machine (`costs`), on a
//! [`processor`] that other programs load. So a run is the same to the last bit on any machine, and faster than real time.

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
    /// Where the follower's poses come from.
    pub enum EstimatorKind {
        /// The simulator.
        Truth = "truth",
        /// Laser odometry.
        ScanMatcher = "scan_matcher",
        /// The particle filter.
        ParticleFilter = "particle_filter",
    }
}

/// Why there is no drive.
#[derive(Debug, Error)]
pub enum DriveError {
    /// The world cannot be read.
    #[error(transparent)]
    Map(#[from] MapError),
    /// There is no way round it.
    #[error("there is no way round this world, --path FILE.csv gives one")]
    Route(#[from] NoLoop),
    /// A file cannot be read or written.
    #[error("{}: {problem}", path.display())]
    File {
        /// Which one.
        path: PathBuf,
        /// The system's reason.
        problem: io::Error,
    },
    /// The file holds no waypoints.
    #[error("{}: {problem}", path.display())]
    Waypoints {
        /// Which one.
        path: PathBuf,
        /// The place.
        problem: WaypointFileError,
    },
    /// The waypoints make no path.
    #[error("{}: {problem}", path.display())]
    Path {
        /// Which one.
        path: PathBuf,
        /// What is wrong with them.
        problem: PathError,
    },
    /// The path goes where the car does not fit.
    #[error("the path begins at ({x:.2}, {y:.2}), where the car touches a wall: is the path of this world?")]
    InWall {
        /// Where, m.
        x: f64,
        /// Where, m.
        y: f64,
    },
    /// Laps need a closed path.
    #[error("the path is open, and ends once: give --laps 1, or close it")]
    OpenPath,
    /// A particle filter without a map.
    #[error(
        "estimator particle_filter: the world '{0}' has no map; give --world a map's YAML file (maps/corridor.yaml is 'corridor')"
    )]
    NoMap(String),
    /// The estimator cannot start.
    #[error(transparent)]
    Localizer(#[from] LocalizerError),
    /// The scan matcher cannot start.
    #[error(transparent)]
    Start(#[from] StartError),
    /// The configured contract is none.
    #[error(transparent)]
    Contract(#[from] ContractError),
    /// The profile cannot be read.
    #[error(transparent)]
    Profile(#[from] ProfileFileError),
    /// The costs cannot be read.
    #[error(transparent)]
    Costs(#[from] CostFileError),
    /// A picture cannot be drawn.
    #[error(transparent)]
    Plot(#[from] PlotError),
}
