//! A look-up table of modes (Pant et al., Anytime Computation and Control for Autonomous Systems, 2021).

use super::bound::{error_followed, greatest_error, longest_delay};
use super::{Situation, Terms};
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

/// The mode of the least delay, which is the cheapest, of those in time whose error is as good as the least of them and leaves the car
/// enough room. If there is none, the best of those in time; in conditions other than the table's nobody knows the errors, and the
/// longest of those in time is. An estimator that is done, or good enough, before answers earlier.
pub(super) fn terms(table: &Table, situation: &Situation) -> Terms {
    let longest = longest_delay(situation);
    let in_time = || table.modes.iter().filter(|mode| mode.delay <= longest);
    let error = |mode: &Mode| error_followed(mode, situation);
    let best = || in_time().min_by(|a, b| error(a).total_cmp(&error(b)));
    let cheapest = || {
        let greatest = greatest_error(error(best()?), situation);
        in_time().find(|mode| error(mode) <= greatest)
    };
    let chosen = if situation.is_familiar { cheapest().or_else(best) } else { in_time().next_back() };
    let time_budget = chosen.or(table.modes.first()).map(|mode| mode.delay);
    Terms { contract: Contract { time_budget, ..Contract::default() }, max_iterations: None }
}
