//! Policies: which time contract to give the estimator, scan by scan.

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

/// What a policy may know when a scan comes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Situation {
    /// How fast the car is, m/s.
    pub speed: f64,
    /// The distance ahead that its law looks at, m.
    pub lookahead: f64,
    /// Room beside the car on its path within the look-ahead, m.
    pub clearance: f64,
    /// How fast the car turns there, as far as its follower does not make up for the delay of poses, rad/s.
    pub uncompensated_turn: f64,
    /// Time from one scan to the next.
    pub period: Duration,
    /// Whether the last answers were found in the conditions that what is known beforehand is of.
    pub is_familiar: bool,
    /// Time that a whole answer would take, begun now; nobody but an oracle knows.
    pub whole: Duration,
}

/// What is asked of the answer to a scan.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Terms {
    /// The contract.
    pub contract: Contract,
    /// Iterations at most; `None`: as the configuration says.
    pub max_iterations: Option<u32>,
}

/// How contracts are chosen.
#[derive(Clone, Debug, PartialEq)]
pub enum Policy {
    /// No contract: every answer takes as long as it takes.
    Completion,
    /// So many iterations at most.
    Iterations(u32),
    /// The same contract always.
    Fixed(Contract),
    /// A time budget that goes down with the speed.
    BySpeed(BySpeed),
    /// The cheapest mode of a profile that the controller tolerates.
    Table(Table),
    /// Knows the load.
    Oracle,
}

impl Policy {
    /// The terms in a situation.
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

/// Text that names no policy.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error(
    "expected completion, iterations:N, fixed:TIME[,METRES] (fixed:10ms,0.02), by_speed:TIME,TIME,SPEED (at rest, and from SPEED on: \
     by_speed:10ms,2ms,4), table or oracle, got '{0}'"
)]
pub struct UnknownPolicy(String);

impl FromStr for Policy {
    type Err = UnknownPolicy;

    /// A table has no modes yet.
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
        uncompensated_turn: 0.0,
        period: Duration::from_millis(25),
        is_familiar: true,
        whole: Duration::from_millis(5),
    };

    #[test]
    fn policies_are_named_as_they_are_read() {
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
    fn a_table_takes_the_cheapest_mode_that_the_controller_tolerates() {
        let mode = |ms: u64, translation: f64| Mode {
            delay: Duration::from_millis(ms),
            error: ErrorEstimate { translation, rotation: 0.1 * translation },
        };
        let modes = vec![mode(1, 0.2), mode(5, 0.0045), mode(20, 0.002)];
        let policy = Policy::Table(Table { modes, ..Table::default() });
        let budget = |situation: &Situation| policy.terms(situation).contract.time_budget.unwrap().as_millis();
        assert_eq!(budget(&SITUATION), 5);
        assert_eq!(budget(&Situation { clearance: 0.046, ..SITUATION }), 20, "little room: a better pose");
        assert_eq!(budget(&Situation { lookahead: 8.0, ..SITUATION }), 20, "far ahead the heading counts for more");
        assert_eq!(budget(&Situation { uncompensated_turn: 1.0, ..SITUATION }), 5, "in a curve");
        let even = vec![mode(1, 0.0021), mode(5, 0.0021), mode(20, 0.002)];
        let even = Policy::Table(Table { modes: even, ..Table::default() });
        assert_eq!(even.terms(&SITUATION).contract.time_budget, Some(Duration::from_millis(1)), "the cheapest of equal ones");
        assert_eq!(budget(&Situation { clearance: 0.0, speed: 40.0, ..SITUATION }), 5, "the best of those in time");
        assert_eq!(
            budget(&Situation { is_familiar: false, ..SITUATION }),
            20,
            "elsewhere nobody knows the errors: what time allows"
        );
        assert_eq!(Policy::Table(Table::default()).terms(&SITUATION), Terms::default());
    }

    #[test]
    fn the_faster_the_shorter_down_to_the_budget_of_full_speed() {
        let policy: Policy = "by_speed:10ms,2ms,4".parse().unwrap();
        let budget = |speed| policy.terms(&Situation { speed, ..SITUATION }).contract.time_budget.unwrap().as_millis();
        assert_eq!([0.0, 2.0, 4.0, 9.0, -2.0].map(budget), [10, 6, 2, 2, 6]);
    }

    #[test]
    fn an_oracle_asks_for_less_under_load() {
        assert_eq!(Policy::Oracle.terms(&SITUATION).contract.time_budget, Some(SITUATION.period));
        let loaded = Policy::Oracle.terms(&Situation { whole: Duration::from_millis(100), ..SITUATION });
        assert_eq!(loaded.contract.time_budget, Some(SITUATION.period / 2));
    }
}
