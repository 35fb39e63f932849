//! A look-up table of modes (Pant et al., Anytime Computation and Control for Autonomous Systems, 2021).

use super::{ControllerBound, Situation, Terms};
use crate::anytime::contract::Contract;
use crate::anytime::mode::{Mode, Ranges};

/// The modes of an estimator, by their delay, and the conditions that they were found in.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Table {
    /// By rising delay.
    pub modes: Vec<Mode>,
    /// Where what they say holds.
    pub conditions: Ranges,
}

/// The mode of the least delay, which is the cheapest, of those that the controller's bound tolerates; if it tolerates none, or the
/// conditions are others than the table's, so that nobody knows the errors, the best of those in time. An estimator that is done, or good
/// enough, before answers earlier.
pub(super) fn terms(table: &Table, situation: &Situation) -> Terms {
    let bound = ControllerBound::of(situation);
    let in_time = || table.modes.iter().filter(|mode| mode.delay <= bound.delay);
    let cheapest = in_time().find(|mode| mode.error <= bound.error).filter(|_| situation.is_familiar);
    let best =
        || if situation.is_familiar { in_time().min_by(|a, b| a.error.total_cmp(&b.error)) } else { in_time().next_back() };
    let time_budget = cheapest.or_else(best).or(table.modes.first()).map(|mode| mode.delay);
    Terms { contract: Contract { time_budget, ..Contract::default() }, max_iterations: None }
}
