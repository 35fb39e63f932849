//! The face of `laser_scan_matcher`: its parameters, its topics, its rule for keyframes, around this matcher.
//!
//! What that node does wrong is not copied: a scan that cannot be matched is answered with the prediction, and covariances are what the
//! match says.

mod parameters;
mod poses;

pub(super) use parameters::{Face, Predictors, read};
pub(super) use poses::PoseOutputs;
