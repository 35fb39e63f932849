//! An oracle that knows in advance how long a complete answer will take: a reference for the other policies.

use super::bound::max_delay;
use super::{Situation, Terms};
use crate::anytime::contract::Contract;

/// The maximum delay that the controller tolerates if a complete answer fits into it; otherwise half of it, so that the remaining
/// work is done before the next scan. There is always a limit because a filter during global localization takes many times longer
/// than usual.
pub(super) fn terms(situation: &Situation) -> Terms {
    let max_delay = max_delay(situation);
    let time_budget = if situation.full_answer_time <= max_delay { max_delay } else { max_delay / 2 };
    Terms { contract: Contract { time_budget: Some(time_budget), ..Contract::default() }, max_iterations: None }
}
