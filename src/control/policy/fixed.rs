//! One contract for every scan.

use super::Terms;
use crate::anytime::contract::Contract;
use crate::knobs::{KnobValue as _, Seconds};

pub(super) fn terms(contract: Contract) -> Terms {
    Terms { contract, max_iterations: None }
}

/// Parses `TIME[,METRES]`.
pub(super) fn parse(text: &str) -> Option<Contract> {
    let (time, metres) = text.split_once(',').unwrap_or((text, "0"));
    let Seconds(budget) = Seconds::from_value(&time.into()).ok()?;
    Contract::new(budget, metres.trim().parse().ok()?, 0.0).ok().filter(|contract| contract.time_budget.is_some())
}
