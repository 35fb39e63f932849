//! A look-up table of modes (Pant et al., Anytime Computation and Control for Autonomous Systems, 2021).

use super::bound::{expected_tracking_error, max_delay, max_error};
use super::{Situation, Terms};
use crate::anytime::contract::Contract;
use crate::anytime::mode::{ConditionRanges, Mode};

/// The modes of an estimator and the conditions under which they were measured.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Table {
    /// The modes, sorted by delay.
    pub modes: Vec<Mode>,
    /// The conditions for which the modes are valid.
    pub conditions: ConditionRanges,
}

/// Chooses among the modes within the maximum delay: the shortest (cheapest) one whose error is about as small as the smallest
/// and fits the clearance; if there is none, the one with the smallest error. Outside the conditions of the table the errors are
/// unknown, and the longest mode is chosen. An estimator that finishes early answers earlier anyway.
pub(super) fn terms(table: &Table, situation: &Situation) -> Terms {
    let max_delay = max_delay(situation);
    let in_time = || table.modes.iter().filter(|mode| mode.delay <= max_delay);
    let error = |mode: &Mode| expected_tracking_error(mode, situation);
    let best = || in_time().min_by(|a, b| error(a).total_cmp(&error(b)));
    let cheapest = || {
        let max_error = max_error(error(best()?), situation);
        in_time().find(|mode| error(mode) <= max_error)
    };
    let chosen = if situation.is_profile_valid { cheapest().or_else(best) } else { in_time().next_back() };
    let time_budget = chosen.or(table.modes.first()).map(|mode| mode.delay);
    Terms { contract: Contract { time_budget, ..Contract::default() }, max_iterations: None }
}
