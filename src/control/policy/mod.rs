//! Policies: choose the time contract of the estimator for each scan.

mod bound;
mod by_speed;
mod completion;
mod fixed;
mod iterations;
mod oracle;
mod table;

use std::fmt;
use std::str::FromStr;
use std::time::Duration;

pub use by_speed::BySpeed;
pub use table::Table;

use crate::anytime::contract::Contract;

/// Inputs of a policy when a scan arrives.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Situation {
    /// Speed of the car, m/s.
    pub speed: f64,
    /// Lookahead distance of the control law, m.
    pub lookahead: f64,
    /// Clearance beside the car on its path within the lookahead distance, m.
    pub clearance: f64,
    /// Maximum yaw rate on that part of the path, rad/s; 0 if the follower compensates the delay of poses.
    pub uncompensated_yaw_rate: f64,
    /// Period of the scans.
    pub period: Duration,
    /// Whether the conditions of the last answers are within those of the profile.
    pub is_profile_valid: bool,
    /// Time that a complete answer would take if begun now; only the oracle policy uses it.
    pub full_answer_time: Duration,
}

/// The limits for the answer to a scan.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Terms {
    /// The contract.
    pub contract: Contract,
    /// Maximum iterations; `None`: as configured.
    pub max_iterations: Option<u32>,
}

/// The policy that chooses contracts.
#[derive(Clone, Debug, PartialEq)]
pub enum Policy {
    /// No contract: every answer runs to completion.
    Completion,
    /// An iteration limit.
    Iterations(u32),
    /// The same contract for every scan.
    Fixed(Contract),
    /// A time budget that decreases with the speed.
    BySpeed(BySpeed),
    /// The cheapest mode of a performance profile that the controller tolerates.
    Table(Table),
    /// Knows in advance how long an answer will take.
    Oracle,
}

impl Policy {
    /// The terms for a situation.
    pub fn terms(&self, situation: &Situation) -> Terms {
        match self {
            Self::Completion => completion::terms(),
            Self::Iterations(count) => iterations::terms(*count),
            Self::Fixed(contract) => fixed::terms(*contract),
            Self::BySpeed(rule) => by_speed::terms(rule, situation),
            Self::Table(table) => table::terms(table, situation),
            Self::Oracle => oracle::terms(situation),
        }
    }
}

/// Text that is not a valid policy.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error(
    "expected completion, iterations:N, fixed:TIME[,METRES] (such as fixed:10ms,0.02), by_speed:SLOW,FAST,SPEED (time budget at rest and \
     at SPEED or faster, such as by_speed:10ms,2ms,4), table or oracle, got '{0}'"
)]
pub struct UnknownPolicy(String);

impl FromStr for Policy {
    type Err = UnknownPolicy;

    /// The table of a table policy has no modes yet.
    fn from_str(text: &str) -> Result<Self, UnknownPolicy> {
        let unknown = || UnknownPolicy(text.into());
        let (name, value) = text.split_once(':').unwrap_or((text, ""));
        match (name, value) {
            ("completion", "") => Ok(Self::Completion),
            ("table", "") => Ok(Self::Table(Table::default())),
            ("oracle", "") => Ok(Self::Oracle),
            ("iterations", count) => count.parse().ok().filter(|count| *count > 0).map(Self::Iterations).ok_or_else(unknown),
            ("by_speed", value) => by_speed::parse(value).map(Self::BySpeed).ok_or_else(unknown),
            ("fixed", value) => fixed::parse(value).map(Self::Fixed).ok_or_else(unknown),
            _ => Err(unknown()),
        }
    }
}

impl fmt::Display for Policy {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Completion => write!(f, "completion"),
            Self::Iterations(count) => write!(f, "iterations:{count}"),
            Self::Fixed(contract) => {
                write!(f, "fixed:{}ms", contract.time_budget.unwrap_or_default().as_secs_f64() * 1e3)?;
                contract.translation_error_bound.map_or(Ok(()), |bound| write!(f, ",{bound}"))
            }
            Self::BySpeed(rule) => rule.fmt(f),
            Self::Table(_) => write!(f, "table"),
            Self::Oracle => write!(f, "oracle"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::anytime::ErrorEstimate;
    use crate::anytime::mode::Mode;

    const SITUATION: Situation = Situation {
        speed: 7.0,
        lookahead: 2.0,
        clearance: 0.6,
        uncompensated_yaw_rate: 0.0,
        period: Duration::from_millis(25),
        is_profile_valid: true,
        full_answer_time: Duration::from_millis(5),
    };

    #[test]
    fn policies_are_displayed_as_they_are_parsed() {
        let by_speed = "by_speed:10ms,2.5ms,4";
        for name in ["completion", "iterations:3", "fixed:10ms", "fixed:2.5ms,0.02", by_speed, "table", "oracle"] {
            assert_eq!(name.parse::<Policy>().unwrap().to_string(), name);
        }
        let wrong_speeds = ["by_speed:10ms", "by_speed:2ms,10ms,4", "by_speed:10ms,2ms,0", "by_speed:0,0,1"];
        for wrong in
            wrong_speeds.into_iter().chain(["", "fixed", "fixed:x", "fixed:10ms,-1", "iterations:0", "tables", "oracle:1"])
        {
            assert!(wrong.parse::<Policy>().is_err(), "{wrong}");
        }
    }

    #[test]
    fn a_table_chooses_the_cheapest_tolerated_mode() {
        let mode = |ms: u64, translation: f64| Mode {
            delay: Duration::from_millis(ms),
            error: ErrorEstimate { translation, rotation: 0.1 * translation },
        };
        let modes = vec![mode(1, 0.2), mode(5, 0.0045), mode(20, 0.002)];
        let policy = Policy::Table(Table { modes, ..Table::default() });
        let budget = |situation: &Situation| policy.terms(situation).contract.time_budget.unwrap().as_millis();
        assert_eq!(budget(&SITUATION), 5);
        assert_eq!(budget(&Situation { clearance: 0.046, ..SITUATION }), 20, "small clearance: a better pose");
        assert_eq!(budget(&Situation { lookahead: 8.0, ..SITUATION }), 20, "with a long lookahead the heading matters more");
        assert_eq!(budget(&Situation { uncompensated_yaw_rate: 1.0, ..SITUATION }), 5, "in a curve");
        let even = vec![mode(1, 0.0021), mode(5, 0.0021), mode(20, 0.002)];
        let even = Policy::Table(Table { modes: even, ..Table::default() });
        assert_eq!(even.terms(&SITUATION).contract.time_budget, Some(Duration::from_millis(1)), "the cheapest of equal modes");
        assert_eq!(budget(&Situation { clearance: 0.0, speed: 40.0, ..SITUATION }), 5, "the best mode within the maximum delay");
        assert_eq!(
            budget(&Situation { is_profile_valid: false, ..SITUATION }),
            20,
            "errors unknown: the longest mode within the maximum delay"
        );
        assert_eq!(Policy::Table(Table::default()).terms(&SITUATION), Terms::default());
    }

    #[test]
    fn the_budget_decreases_with_the_speed() {
        let policy: Policy = "by_speed:10ms,2ms,4".parse().unwrap();
        let budget = |speed| policy.terms(&Situation { speed, ..SITUATION }).contract.time_budget.unwrap().as_millis();
        assert_eq!([0.0, 2.0, 4.0, 9.0, -2.0].map(budget), [10, 6, 2, 2, 6]);
    }

    #[test]
    fn an_oracle_shortens_the_budget_under_load() {
        assert_eq!(Policy::Oracle.terms(&SITUATION).contract.time_budget, Some(SITUATION.period));
        let loaded = Policy::Oracle.terms(&Situation { full_answer_time: Duration::from_millis(100), ..SITUATION });
        assert_eq!(loaded.contract.time_budget, Some(SITUATION.period / 2));
    }
}
