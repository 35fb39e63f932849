//! Knows how long a whole answer will take: what nobody else can know.

use super::bound::longest_delay;
use super::{Situation, Terms};
use crate::anytime::contract::Contract;

/// What the controller tolerates, where a whole answer fits into it; else half of that, so that what is left over can be done before the
/// next scan. Never without a limit: a filter that looks for its robot takes many times as long as usual.
pub(super) fn terms(situation: &Situation) -> Terms {
    let longest = longest_delay(situation);
    let time_budget = if situation.whole <= longest { longest } else { longest / 2 };
    Terms { contract: Contract { time_budget: Some(time_budget), ..Contract::default() }, max_iterations: None }
}
