//! Knows how long a whole answer will take: what nobody else can know.

use super::{ControllerBound, Situation, Terms};
use crate::anytime::contract::Contract;

/// What the controller tolerates, where a whole answer fits into it; else half of that, so that what is left over can be done before the
/// next scan. Never without a limit: a filter that looks for its robot takes many times as long as usual.
pub(super) fn terms(situation: &Situation) -> Terms {
    let bound = ControllerBound::of(situation);
    let time_budget = if situation.whole <= bound.delay { bound.delay } else { bound.delay / 2 };
    Terms { contract: Contract { time_budget: Some(time_budget), ..Contract::default() }, max_iterations: None }
}
