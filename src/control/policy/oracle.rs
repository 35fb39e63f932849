//! Knows how long a whole answer will take: nobody who does not can do better.

use super::{ControllerBound, Situation, Terms};
use crate::anytime::contract::Contract;

/// Whole answers as long as the controller tolerates their delay; else the best in time.
pub(super) fn terms(situation: &Situation) -> Terms {
    let bound = ControllerBound::of(situation);
    if situation.whole <= bound.delay {
        return Terms::default();
    }
    Terms { contract: Contract { time_budget: Some(bound.delay), ..Contract::default() }, max_iterations: None }
}
