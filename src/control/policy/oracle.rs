//! Knows how loaded the machine is: what no policy can do better than.

use super::{Situation, Terms};
use crate::anytime::contract::Contract;

/// Whole answers as long as they come before the next scan; else the best that does.
pub(super) fn terms(situation: &Situation) -> Terms {
    if situation.whole.mul_f64(situation.load) <= situation.period {
        return Terms::default();
    }
    Terms { contract: Contract { time_budget: Some(situation.period), ..Contract::default() }, max_iterations: None }
}
