//! The time contract: answer within a time delta, with an error of at most epsilon.

use std::fmt;
use std::time::Duration;

use thiserror::Error;

use crate::knobs::Seconds;
use crate::messages::own;

crate::knobs! {
    /// Default contract, in force until another one is received at run time.
    pub struct ContractKnobs {
        /// Time budget from the arrival of a scan to its pose; 0: run to completion.
        time_budget: Seconds = Seconds(0.0), in 0 to 60, unit "s";
        /// Stop as soon as three standard deviations of the position are below this, which holds for at least 95 % of the
        /// answers; 0: no bound.
        translation_error_bound: f64 = 0.0, in 0 to 100, unit "m";
        /// Stop as soon as three standard deviations of the heading are below this, which holds for at least 95 % of the answers;
        /// 0: no bound.
        rotation_error_bound: f64 = 0.0, in 0 to 4, unit "rad";
        /// Continue to refine an answer after it has been published, if the time budget ended it early or if it becomes the
        /// reference, until the next scan arrives. Later scans start from the better pose; the published answer does not change.
        finish_after_answer: bool = true;
        /// Fraction of the answers limited by the time budget that must be on time: a high value keeps deadlines, a low one uses
        /// more of the budget.
        confidence: f64 = 0.9998, in 0.5 to 0.9999;
        /// Name of the shared memory through which a controller on the same machine requests answers, such as
        /// `/anytime_scan_matcher`; unset: none.
        shared_memory: Option<String> = None;
        /// Profile written by `anytime profile`: the report then states the error to expect for the time budget.
        profile: Option<String> = None;
        /// File that keeps the learned costs between runs: read at start if it exists, written on exit.
        cost_file: Option<String> = None;
    }
}

/// An error bound must hold for at least 95 % of the answers, so this many standard deviations are compared with it. Two were
/// enough for noise alone, but the remaining convergence error is known less well.
pub const BOUND_SIGMAS: f64 = 3.0;

/// What the controller demands of every answer.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Contract {
    /// Time from a scan's arrival to its pose; `None`: no limit.
    pub time_budget: Option<Duration>,
    /// Position error to stop at, m.
    pub translation_error_bound: Option<f64>,
    /// Heading error to stop at, rad.
    pub rotation_error_bound: Option<f64>,
}

/// Why a contract is rejected.
#[derive(Clone, Debug, Error, PartialEq)]
#[error(
    "contract refused: {field} is {value}, but must be a finite number of {unit}, 0 (no limit) or greater; \
     the previous contract stays in force"
)]
pub struct ContractError {
    field: &'static str,
    value: f64,
    unit: &'static str,
}

impl Contract {
    /// Creates a contract from seconds, metres and radians; zero means no limit.
    pub fn new(time_budget: f64, translation_error_bound: f64, rotation_error_bound: f64) -> Result<Self, ContractError> {
        let limit = |field, value: f64, unit| {
            if value.is_finite() && value >= 0.0 {
                Ok((value > 0.0).then_some(value))
            } else {
                Err(ContractError { field, value, unit })
            }
        };
        let time_budget = limit("time_budget", time_budget, "seconds")?
            .map(|seconds| {
                Duration::try_from_secs_f64(seconds).map_err(|_| ContractError {
                    field: "time_budget",
                    value: seconds,
                    unit: "seconds",
                })
            })
            .transpose()?;
        Ok(Self {
            time_budget,
            translation_error_bound: limit("translation_error_bound", translation_error_bound, "metres")?,
            rotation_error_bound: limit("rotation_error_bound", rotation_error_bound, "radians")?,
        })
    }

    /// Whether an answer with these errors (one sigma, m and rad) satisfies the error bounds; false if there are none.
    pub fn is_satisfied_by(&self, translation_error: f64, rotation_error: f64) -> bool {
        let within = |bound: Option<f64>, error: f64| bound.is_none_or(|bound| BOUND_SIGMAS * error <= bound);
        self.has_error_bound()
            && within(self.translation_error_bound, translation_error)
            && within(self.rotation_error_bound, rotation_error)
    }

    /// Maximum time to wait for data that improve the answer: `limit`, but at most half of the time budget.
    pub fn max_wait(&self, limit: Duration) -> Duration {
        self.time_budget.map_or(limit, |budget| limit.min(budget / 2))
    }

    /// Time by which an answer that took `elapsed` exceeds the time budget.
    pub fn overrun(&self, elapsed: Duration) -> Duration {
        self.time_budget.map_or(Duration::ZERO, |budget| elapsed.saturating_sub(budget))
    }

    /// Whether there is an error bound to stop at.
    pub fn has_error_bound(&self) -> bool {
        self.translation_error_bound.is_some() || self.rotation_error_bound.is_some()
    }
}

/// For example `within 5ms, to 0.01 m`.
impl fmt::Display for Contract {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let limits = [
            self.time_budget.map(|budget| format!("within {budget:?}")),
            self.translation_error_bound.map(|bound| format!("to {bound} m")),
            self.rotation_error_bound.map(|bound| format!("to {bound} rad")),
        ];
        let limits: Vec<String> = limits.into_iter().flatten().collect();
        f.write_str(if limits.is_empty() { "to completion" } else { "" })?;
        f.write_str(&limits.join(", "))
    }
}

impl TryFrom<&ContractKnobs> for Contract {
    type Error = ContractError;

    fn try_from(knobs: &ContractKnobs) -> Result<Self, ContractError> {
        Self::new(knobs.time_budget.0, knobs.translation_error_bound, knobs.rotation_error_bound)
    }
}

/// Without a header; zero means no limit.
impl From<&Contract> for own::Contract {
    fn from(contract: &Contract) -> Self {
        Self {
            time_budget: contract.time_budget.unwrap_or_default().into(),
            translation_error_bound: contract.translation_error_bound.unwrap_or_default(),
            rotation_error_bound: contract.rotation_error_bound.unwrap_or_default(),
            ..Self::default()
        }
    }
}

impl TryFrom<&own::Contract> for Contract {
    type Error = ContractError;

    fn try_from(message: &own::Contract) -> Result<Self, ContractError> {
        Self::new(message.time_budget.seconds(), message.translation_error_bound, message.rotation_error_bound)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn zero_means_no_limit_and_invalid_values_are_rejected() {
        assert_eq!(Contract::new(0.0, 0.0, 0.0), Ok(Contract::default()));
        assert_eq!(Contract::new(0.005, 0.0, 0.0).unwrap().time_budget, Some(Duration::from_millis(5)));
        for bad in [f64::NAN, f64::INFINITY, -1.0] {
            assert!(
                Contract::new(bad, 0.0, 0.0).is_err()
                    && Contract::new(0.0, bad, 0.0).is_err()
                    && Contract::new(0.0, 0.0, bad).is_err()
            );
        }
        assert!(Contract::new(1e300, 0.0, 0.0).is_err());
    }

    #[test]
    fn every_bound_that_is_set_must_hold() {
        let both = Contract::new(0.0, 0.01, 0.01).unwrap();
        assert!(both.is_satisfied_by(0.003, 0.003) && !both.is_satisfied_by(0.004, 0.003) && !both.is_satisfied_by(0.003, 0.004));
        assert!(Contract::new(0.0, 0.01, 0.0).unwrap().is_satisfied_by(0.003, 1.0));
        assert!(!Contract::default().is_satisfied_by(0.0, 0.0));
    }
}
