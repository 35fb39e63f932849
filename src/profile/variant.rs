//! Variants: a scan matcher (a correspondence search with a solver) or the particle filter.

use std::fmt;
use std::str::FromStr;

use thiserror::Error;

use crate::config::Config;
use crate::knobs::{KnobValue, nearest_name};
use crate::matching::classic::correspondence::CorrespondenceKind;
use crate::matching::solver::SolverKind;

/// Name of the particle filter variant.
const FILTER_NAME: &str = "particle_filter";

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
    /// A scan matcher.
    Matcher {
        /// The correspondence search.
        search: CorrespondenceKind,
        /// The solver.
        solver: SolverKind,
    },
    /// The particle filter.
    Filter,
}

/// An unknown variant name.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error(
    "unknown variant '{name}'{hint}; expected particle_filter, or SEARCH+SOLVER with SEARCH {} and SOLVER {}",
    CorrespondenceKind::kind(),
    SolverKind::kind()
)]
pub struct VariantError {
    name: String,
    hint: String,
}

impl Variant {
    /// Every search with every solver that it supports.
    pub fn matchers() -> Vec<Self> {
        let solvers = |&search: &CorrespondenceKind| SolverKind::ALL.iter().filter(move |&&solver| search.supports(solver));
        let with = |search| solvers(search).map(move |&solver| Self::Matcher { search: *search, solver });
        CorrespondenceKind::ALL.iter().flat_map(with).collect()
    }

    /// The correspondence search; `None` for the particle filter.
    pub fn search(self) -> Option<CorrespondenceKind> {
        match self {
            Self::Matcher { search, .. } => Some(search),
            Self::Filter => None,
        }
    }

    /// The solver; `None` for the particle filter.
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
            Self::Filter => f.write_str(FILTER_NAME),
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
