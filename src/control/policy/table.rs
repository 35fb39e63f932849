//! A look-up table of modes (Pant et al., Anytime Computation and Control for Autonomous Systems, 2021).

use std::time::Duration;

use super::{ControllerBound, Situation, Terms};
use crate::anytime::contract::Contract;

/// A way for the estimator to work: its delay, and the error to expect of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mode {
    /// The time budget.
    pub delay: Duration,
    /// One standard deviation of the position, m.
    pub error: f64,
}

/// The mode of the least delay, which is the cheapest, of those that the controller's bound tolerates; if it tolerates none, the best of
/// those in time. `modes` come by their delay. An estimator that is done, or good enough, before answers earlier.
pub(super) fn terms(modes: &[Mode], situation: &Situation) -> Terms {
    let bound = ControllerBound::of(situation);
    let in_time = || modes.iter().filter(|mode| mode.delay <= bound.delay);
    let chosen =
        in_time().find(|mode| mode.error <= bound.error).or_else(|| in_time().min_by(|a, b| a.error.total_cmp(&b.error)));
    let time_budget = chosen.or(modes.first()).map(|mode| mode.delay);
    Terms { contract: Contract { time_budget, ..Contract::default() }, max_iterations: None }
}
