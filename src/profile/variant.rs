//! A variant: a scan matcher, that is, a correspondence search and a solver; or the particle filter.

use std::fmt;
use std::str::FromStr;

use thiserror::Error;

use crate::config::Config;
use crate::knobs::{KnobValue, nearest_name};
use crate::matching::classic::correspondence::Correspondence;
use crate::matching::solver::SolverKind;

/// The name of the particle filter.
const FILTER: &str = "particle_filter";

/// A scan matcher, named `search+solver`, or `particle_filter`.
///
/// ```
/// use anytime_scan_matcher::profile::variant::Variant;
///
/// let variant: Variant = "jump_table+point_to_line".parse()?;
/// assert_eq!(variant.to_string(), "jump_table+point_to_line");
/// assert!(Variant::matchers().contains(&variant));
/// assert_eq!("particle_filter".parse(), Ok(Variant::Filter));
/// # Ok::<(), anytime_scan_matcher::profile::variant::VariantError>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Variant {
    /// Matches scans.
    Matcher {
        /// How correspondences are found.
        search: Correspondence,
        /// How the pose is found.
        solver: SolverKind,
    },
    /// Finds the robot on a map.
    Filter,
}

/// A name that is no variant's.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error(
    "there is no variant '{name}'{hint}; a variant is SEARCH+SOLVER with SEARCH {} and SOLVER {}, or particle_filter",
    Correspondence::kind(),
    SolverKind::kind()
)]
pub struct VariantError {
    name: String,
    hint: String,
}

impl Variant {
    /// Every search with every solver that it serves.
    pub fn matchers() -> Vec<Self> {
        let served = |&search: &Correspondence| SolverKind::ALL.iter().filter(move |&&solver| search.serves(solver));
        let with = |search| served(search).map(move |&solver| Self::Matcher { search: *search, solver });
        Correspondence::ALL.iter().flat_map(with).collect()
    }

    /// How correspondences are found; `None`: there are none.
    pub fn search(self) -> Option<Correspondence> {
        match self {
            Self::Matcher { search, .. } => Some(search),
            Self::Filter => None,
        }
    }

    /// How the pose of a match is found.
    pub fn solver(self) -> Option<SolverKind> {
        match self {
            Self::Matcher { solver, .. } => Some(solver),
            Self::Filter => None,
        }
    }

    /// Sets the variant in a configuration.
    pub fn set(self, config: &mut Config) {
        if let Self::Matcher { search, solver } = self {
            (config.matching.correspondence, config.matching.solver) = (search, solver);
        }
    }
}

impl fmt::Display for Variant {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Matcher { search, solver } => write!(f, "{}+{}", search.name(), solver.name()),
            Self::Filter => f.write_str(FILTER),
        }
    }
}

impl FromStr for Variant {
    type Err = VariantError;

    fn from_str(name: &str) -> Result<Self, VariantError> {
        let all = [Self::matchers(), vec![Self::Filter]].concat();
        all.iter().copied().find(|variant| variant.to_string() == name).ok_or_else(|| {
            let names: Vec<String> = all.iter().map(ToString::to_string).collect();
            let near = nearest_name(name, names.iter().map(String::as_str));
            VariantError { name: name.into(), hint: near.map_or_else(String::new, |near| format!(" (did you mean '{near}'?)")) }
        })
    }
}
