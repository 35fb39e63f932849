//! Decides when to send a contract.

use std::time::Duration;

use crate::anytime::contract::Contract;

/// Minimum relative change of the time budget for which a new contract is sent.
const MIN_CHANGE: f64 = 0.05;
/// Minimum time between two contracts.
const MIN_PERIOD: Duration = Duration::from_millis(100);
/// A contract is sent again if reports still show another one after this time: it was lost, or another node has replaced it.
const TIMEOUT: Duration = Duration::from_secs(1);

/// Keeps the matcher's contract close to the wanted one with few messages.
#[derive(Default)]
pub(super) struct Schedule {
    sent: Option<(Contract, Duration)>,
    in_force: Option<Contract>,
}

impl Schedule {
    /// Records the contract in force, as a report gives it.
    pub(super) fn observe(&mut self, in_force: Contract) {
        self.in_force = Some(in_force);
    }

    /// Whether to send `wanted` at the time `now`. If so, it is recorded as sent.
    pub(super) fn is_due(&mut self, wanted: Contract, now: Duration) -> bool {
        let due = self.sent.is_none_or(|(sent, at)| {
            let age = now.saturating_sub(at);
            let not_in_force = self.in_force.is_some_and(|in_force| in_force != sent);
            age >= MIN_PERIOD && (differ(&sent, &wanted) || (age >= TIMEOUT && not_in_force))
        });
        if due {
            self.sent = Some((wanted, now));
        }
        due
    }
}

/// Whether the time budgets differ noticeably.
fn differ(sent: &Contract, wanted: &Contract) -> bool {
    let [sent, wanted] = [sent, wanted].map(|contract| contract.time_budget.unwrap_or_default().as_secs_f64());
    (wanted - sent).abs() > MIN_CHANGE * sent
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A contract with a time budget in ms.
    fn contract(milliseconds: f64) -> Contract {
        Contract { time_budget: Some(Duration::from_secs_f64(1e-3 * milliseconds)), ..Contract::default() }
    }

    fn at(milliseconds: u64) -> Duration {
        Duration::from_millis(milliseconds)
    }

    #[test]
    fn small_changes_and_too_frequent_ones_are_not_sent() {
        let mut schedule = Schedule::default();
        assert!(schedule.is_due(contract(10.0), at(0)), "the first one");
        assert!(!schedule.is_due(contract(9.8), at(5000)), "2 % less");
        assert!(schedule.is_due(contract(8.0), at(5001)));
        assert!(!schedule.is_due(contract(2.0), at(5050)), "too soon");
        assert!(schedule.is_due(contract(2.0), at(5101)));
    }

    #[test]
    fn a_contract_that_does_not_take_effect_is_sent_again() {
        let (wanted, mut schedule) = (contract(8.0), Schedule::default());
        assert!(schedule.is_due(wanted, at(0)));
        schedule.observe(Contract::default());
        assert!(!schedule.is_due(wanted, at(900)) && schedule.is_due(wanted, at(1000)));
        schedule.observe(wanted);
        assert!(!schedule.is_due(wanted, at(9000)));
    }
}
