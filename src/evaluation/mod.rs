//! Trajectories against truth: ATE, RPE, relations; plots. Maps against the true map.
//!
//! [`trajectory`] and [`association`] bring the poses together, [`ate`], [`rpe`] and [`relations`] are the three metrics, each a
//! set of pose errors that [`statistics`] sums up, [`consistency`] is whether covariances hold; `map_alignment` lays a
//! map on the true one, for `map_comparison`; [`report`] is all of it for people and machines, [`plot`] the picture.

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
