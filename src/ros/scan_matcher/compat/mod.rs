//! Compatibility with `laser_scan_matcher`: its parameters, topics and keyframe rule, with this matcher.
//!
//! Its faults are not copied: if a scan cannot be matched, the prediction is published, and the covariances are those of the
//! match.

mod parameters;
mod poses;

pub(super) use parameters::{NodeInterface, Predictors, read};
pub(super) use poses::PoseOutputs;
