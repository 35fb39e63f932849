//! From the speed to the contract, and when it is worth a message.

use std::time::Duration;

use super::ContractDemoKnobs;
use crate::anytime::contract::{Contract, ContractError};

/// A budget that differs from the one sent by less than this share of it is the same.
const SAME: f64 = 0.05;
/// Contracts are at least this far apart.
const MIN_PERIOD: Duration = Duration::from_millis(100);
/// Reports that still name another contract after this time: ours was lost, or somebody else's came after it.
const PATIENCE: Duration = Duration::from_secs(1);

/// The contract for each speed.
pub(super) struct BudgetLaw {
    slow: f64,
    fast: f64,
    speed_fast: f64,
    bounds: Contract,
}

impl TryFrom<&ContractDemoKnobs> for BudgetLaw {
    type Error = ContractError;

    fn try_from(knobs: &ContractDemoKnobs) -> Result<Self, ContractError> {
        let bounds = Contract::new(0.0, knobs.translation_error_bound, knobs.rotation_error_bound)?;
        Ok(Self { slow: knobs.budget_slow.0, fast: knobs.budget_fast.0, speed_fast: knobs.speed_fast, bounds })
    }
}

impl BudgetLaw {
    /// At `speed`, m/s.
    pub(super) fn contract(&self, speed: f64) -> Contract {
        let share = (speed.abs() / self.speed_fast).min(1.0);
        let budget = self.slow + share * (self.fast - self.slow);
        Contract { time_budget: Some(Duration::from_secs_f64(budget)), ..self.bounds }
    }
}

/// Keeps the matcher's contract near the one that is wanted, with few messages.
#[derive(Default)]
pub(super) struct Schedule {
    sent: Option<(Contract, Duration)>,
    in_force: Option<Contract>,
}

impl Schedule {
    /// A report names the contract that was in force.
    pub(super) fn observe(&mut self, in_force: Contract) {
        self.in_force = Some(in_force);
    }

    /// Whether to send `wanted` when the clock reads `now`. What is due is taken to be sent.
    pub(super) fn is_due(&mut self, wanted: Contract, now: Duration) -> bool {
        let due = self.sent.is_none_or(|(sent, at)| {
            let age = now.saturating_sub(at);
            let not_in_force = self.in_force.is_some_and(|in_force| in_force != sent);
            age >= MIN_PERIOD && (differ(&sent, &wanted) || (age >= PATIENCE && not_in_force))
        });
        if due {
            self.sent = Some((wanted, now));
        }
        due
    }
}

fn differ(sent: &Contract, wanted: &Contract) -> bool {
    let [sent, wanted] = [sent, wanted].map(|contract| contract.time_budget.unwrap_or_default().as_secs_f64());
    (wanted - sent).abs() > SAME * sent
}

#[cfg(test)]
mod tests {
    use super::*;

    fn law() -> BudgetLaw {
        BudgetLaw::try_from(&ContractDemoKnobs { translation_error_bound: 0.02, ..Default::default() }).unwrap()
    }

    fn at(milliseconds: u64) -> Duration {
        Duration::from_millis(milliseconds)
    }

    #[test]
    fn the_faster_the_shorter_down_to_the_budget_of_full_speed() {
        let budget = |speed| law().contract(speed).time_budget.unwrap();
        assert_eq!([0.0, 2.0, 4.0, 9.0, -2.0].map(budget), [at(10), at(6), at(2), at(2), at(6)]);
        let contract = law().contract(1.0);
        assert_eq!((contract.translation_error_bound, contract.rotation_error_bound), (Some(0.02), None));
    }

    #[test]
    fn small_changes_and_hasty_ones_are_not_sent() {
        let (law, mut schedule) = (law(), Schedule::default());
        assert!(schedule.is_due(law.contract(0.0), at(0)), "the first one");
        assert!(!schedule.is_due(law.contract(0.1), at(5000)), "2 % less");
        assert!(schedule.is_due(law.contract(1.0), at(5001)));
        assert!(!schedule.is_due(law.contract(4.0), at(5050)), "too soon");
        assert!(schedule.is_due(law.contract(4.0), at(5101)));
    }

    #[test]
    fn a_contract_that_does_not_come_into_force_is_sent_again() {
        let (wanted, mut schedule) = (law().contract(1.0), Schedule::default());
        assert!(schedule.is_due(wanted, at(0)));
        schedule.observe(Contract::default());
        assert!(!schedule.is_due(wanted, at(900)) && schedule.is_due(wanted, at(1000)));
        schedule.observe(wanted);
        assert!(!schedule.is_due(wanted, at(9000)));
    }
}
