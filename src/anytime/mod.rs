//! Anytime operation: refine a match until its contract ends.

pub mod clock;
pub mod contract;

use std::time::Duration;

use clock::Clock;
use contract::Contract;

use crate::geometry::PoseCovariance;
use crate::matching::{Refinement, StopReason};

/// A contract on one scan: its time counts from the scan's arrival.
#[derive(Clone, Copy, Debug)]
pub struct Task {
    /// What is asked for.
    pub contract: Contract,
    /// Reading of the clock when the scan arrived.
    pub arrival: Duration,
}

impl Task {
    /// The reading of the clock by which the answer is due.
    pub fn deadline(&self) -> Option<Duration> {
        self.contract.time_budget.map(|budget| self.arrival.saturating_add(budget))
    }
}

/// Errors of an answer, one sigma.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ErrorEstimate {
    /// Of the position, m.
    pub translation: f64,
    /// Of the heading, rad.
    pub rotation: f64,
}

impl ErrorEstimate {
    /// Nothing is known.
    pub const UNKNOWN: Self = Self { translation: f64::INFINITY, rotation: f64::INFINITY };

    /// From a covariance.
    pub fn of_covariance(covariance: &PoseCovariance) -> Self {
        Self { translation: (covariance.m11 + covariance.m22).max(0.0).sqrt(), rotation: covariance.m33.max(0.0).sqrt() }
    }
}

/// Refines until the match is done, good enough, or out of time.
///
/// An iteration is begun only when one as long as the longest so far still fits before the deadline; the first one, when any time is
/// left at all.
pub fn drive(refinement: &mut Refinement, task: &Task, clock: &dyn Clock) -> StopReason {
    let mut longest = Duration::ZERO;
    let mut now = if task.contract.time_budget.is_some() { clock.now() } else { Duration::ZERO };
    loop {
        if task.deadline().is_some_and(|deadline| now + longest >= deadline) {
            return StopReason::Budget;
        }
        if let Some(reason) = refinement.refine() {
            return reason;
        }
        if task.contract.has_error_bound() {
            let error = estimated_error(refinement);
            if task.contract.is_satisfied_by(error.translation, error.rotation) {
                return StopReason::ErrorBound;
            }
        }
        if task.contract.time_budget.is_some() {
            let then = std::mem::replace(&mut now, clock.now());
            longest = longest.max(now.saturating_sub(then));
        }
    }
}

/// Error of the pose reached so far: the noise of the scans, and what the next step may still change, for which the last one stands.
pub fn estimated_error(refinement: &mut Refinement) -> ErrorEstimate {
    let Some(covariance) = refinement.covariance() else { return ErrorEstimate::UNKNOWN };
    let noise = ErrorEstimate::of_covariance(&covariance);
    let [.., before, last] = refinement.trace() else { return ErrorEstimate::UNKNOWN };
    let step = before.pose.between(&last.pose);
    ErrorEstimate { translation: noise.translation.hypot(step.distance()), rotation: noise.rotation.hypot(step.theta) }
}
