//! Performance profiles: the trade-off between delay and error, measured by replaying a bag with every variant and knob value in
//! interleaved rounds.
//!
//! A [`plan`] lists the cases; a [`study`] runs them ([`run`]) and summarizes the results ([`summary`]) in tables
//! ([`csv_files`]), [`pictures`], an HTML report ([`html`]) and a profile file for the node and for planners
//! ([`crate::io::profile_file`]). It also fits the cost of an iteration ([`cost`]), times the correspondence searches
//! ([`search_time`]), and compares a look-up table of delays ([`look_up`]) with contracts based on learned costs
//! ([`comparison`]).
//!
//! Errors are computed as by `anytime evaluate`: absolute trajectory error (ATE) of each pose after least-squares rigid alignment
//! of the whole trajectory to the ground truth. They are bitwise identical in every run, unless a time budget runs on the
//! machine's clock.

pub mod comparison;
pub mod cost;
pub mod csv_files;
pub mod html;
pub mod knob;
pub mod look_up;
pub mod pictures;
pub mod plan;
pub mod results;
pub mod run;
pub mod search_time;
pub mod study;
pub mod summary;
mod tables;
pub mod variant;

use std::io;
use std::path::{Path, PathBuf};

use thiserror::Error;

use crate::anytime::contract::ContractError;
use crate::app::StartError;
use crate::app::localizer::LocalizerError;
use crate::config::ConfigError;
use crate::evaluation::association::AssociationError;
use crate::evaluation::plot::PlotError;
use crate::evaluation::trajectory::TrajectoryError;
use crate::io::bag::BagError;

/// Why a study failed.
#[derive(Debug, Error)]
pub enum ProfileError {
    /// The bag cannot be read.
    #[error(transparent)]
    Bag(#[from] BagError),
    /// The configuration rejects a value of a knob.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The contract of the configuration is invalid.
    #[error(transparent)]
    Contract(#[from] ContractError),
    /// The particle filter cannot start.
    #[error(transparent)]
    Localizer(#[from] LocalizerError),
    /// The scan matcher cannot start, for example because a configured file cannot be read.
    #[error(transparent)]
    Start(#[from] StartError),
    /// The answers form no valid trajectory.
    #[error("the estimated poses form no valid trajectory: {0} (does the topic carry readable scans?)")]
    Trajectory(#[from] TrajectoryError),
    /// The estimated poses cannot be associated with the ground truth, for example because their stamps do not overlap.
    #[error(transparent)]
    Association(#[from] AssociationError),
    /// A plot cannot be rendered.
    #[error(transparent)]
    Plot(#[from] PlotError),
    /// A file cannot be written.
    #[error("cannot write {}: {error}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// The operating system's error.
        error: io::Error,
    },
}

impl ProfileError {
    fn write(path: &Path, error: io::Error) -> Self {
        Self::Write { path: path.into(), error }
    }
}
