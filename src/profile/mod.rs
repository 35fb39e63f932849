//! The trade-off between delay and error: the whole bag under every variant and value of a knob, in interleaved rounds.
//!
//! A [`plan`] says what is run; a [`study`] runs it ([`run`]) and sums it up ([`summary`]) in tables ([`csv_files`]), [`pictures`], a
//! page that gathers them ([`html`]) and a file for the node and for planners ([`crate::io::profile_file`]). Besides the runs it fits what an
//! iteration costs ([`cost`]), times the correspondence searches ([`search_time`]), and holds the look-up table of delays ([`look_up`])
//! against contracts by learned costs ([`comparison`]).
//!
//! Errors are those of `anytime evaluate`: of each pose, after the rigid motion that lays the whole trajectory onto the truth with the
//! least squared distance of the positions (ATE). They are the same to the last bit in every run, except where a time budget is kept
//! by the machine's clock.

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

/// Why a study was not done.
#[derive(Debug, Error)]
pub enum ProfileError {
    /// The bag cannot be read.
    #[error(transparent)]
    Bag(#[from] BagError),
    /// A value is none of its knob's.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The contract of the configuration is invalid.
    #[error(transparent)]
    Contract(#[from] ContractError),
    /// The particle filter cannot be had.
    #[error(transparent)]
    Localizer(#[from] LocalizerError),
    /// A file of the configuration cannot be read.
    #[error(transparent)]
    Start(#[from] StartError),
    /// The answers make no trajectory.
    #[error("the answers make no trajectory: {0} (is there a scan that can be read on the topic?)")]
    Trajectory(#[from] TrajectoryError),
    /// The truth is of another time.
    #[error(transparent)]
    Association(#[from] AssociationError),
    /// A picture cannot be drawn.
    #[error(transparent)]
    Plot(#[from] PlotError),
    /// A file cannot be written.
    #[error("cannot write {}: {error}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        error: io::Error,
    },
}

impl ProfileError {
    fn write(path: &Path, error: io::Error) -> Self {
        Self::Write { path: path.into(), error }
    }
}
