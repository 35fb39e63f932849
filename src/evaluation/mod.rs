//! Evaluation of trajectories against ground truth (ATE, RPE, relations), of maps against a true map, and plots.
//!
//! [`trajectory`] and [`association`] pair the poses by their stamps. [`ate`], [`rpe`] and [`relations`] are the three metrics; each
//! yields pose errors, which [`statistics`] summarizes. [`consistency`] checks covariances. `map_alignment` aligns a map with the true
//! one, for `map_comparison`. [`report`] formats the results as text and JSON, and [`plot`] draws them.

pub mod association;
pub mod ate;
pub mod consistency;
#[cfg(feature = "cli")]
mod map_alignment;
#[cfg(feature = "cli")]
pub mod map_comparison;
#[cfg(feature = "cli")]
pub mod plot;
pub mod relations;
#[cfg(feature = "cli")]
pub mod report;
pub mod rpe;
pub mod statistics;
pub mod trajectory;
