//! A time budget that decreases with speed: a simple rule that needs no profile.

use std::fmt;
use std::time::Duration;

use super::{Situation, Terms};
use crate::anytime::contract::Contract;
use crate::knobs::{KnobValue as _, Seconds};

/// A time budget that decreases linearly with the speed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BySpeed {
    /// Budget at rest.
    pub slow: Duration,
    /// Budget at `speed_fast` and above; at most `slow`.
    pub fast: Duration,
    /// Speed from which on the budget is `fast`, m/s; above 0.
    pub speed_fast: f64,
}

pub(super) fn terms(rule: &BySpeed, situation: &Situation) -> Terms {
    let fraction = (situation.speed.abs() / rule.speed_fast).min(1.0);
    let time_budget = rule.slow.saturating_sub(rule.slow.saturating_sub(rule.fast).mul_f64(fraction));
    Terms { contract: Contract { time_budget: Some(time_budget), ..Contract::default() }, max_iterations: None }
}

/// Parses `SLOW,FAST,SPEED`.
pub(super) fn parse(text: &str) -> Option<BySpeed> {
    let [slow, fast, speed] = text.split(',').map(str::trim).collect::<Vec<_>>().try_into().ok()?;
    let time = |text: &str| {
        let Seconds(budget) = Seconds::from_value(&text.into()).ok()?;
        Contract::new(budget, 0.0, 0.0).ok()?.time_budget
    };
    let rule = BySpeed { slow: time(slow)?, fast: time(fast)?, speed_fast: speed.parse().ok()? };
    (rule.fast <= rule.slow && rule.speed_fast > 0.0 && rule.speed_fast.is_finite()).then_some(rule)
}

impl fmt::Display for BySpeed {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [slow, fast] = [self.slow, self.fast].map(|budget| budget.as_secs_f64() * 1e3);
        write!(f, "by_speed:{slow}ms,{fast}ms,{}", self.speed_fast)
    }
}
