//! A variant of the matcher: a correspondence search and a solver.

use std::fmt;
use std::str::FromStr;

use thiserror::Error;

use crate::config::Config;
use crate::knobs::{KnobValue, nearest_name};
use crate::matching::correspondence::Correspondence;
use crate::matching::solver::SolverKind;

/// A correspondence search and a solver, named `search+solver`.
///
/// ```
/// use anytime_scan_matcher::profile::variant::Variant;
///
/// let variant: Variant = "jump_table+point_to_line".parse()?;
/// assert_eq!(variant.to_string(), "jump_table+point_to_line");
/// assert_eq!(Variant::all().len(), 15);
/// # Ok::<(), anytime_scan_matcher::profile::variant::VariantError>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Variant {
    /// How correspondences are found.
    pub search: Correspondence,
    /// How the pose is found.
    pub solver: SolverKind,
}

/// A name that is no variant's.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error(
    "there is no variant '{name}'{hint}; a variant is SEARCH+SOLVER with SEARCH {} and SOLVER {}",
    Correspondence::kind(),
    SolverKind::kind()
)]
pub struct VariantError {
    name: String,
    hint: String,
}

impl Variant {
    /// Every search with every solver that it serves.
    pub fn all() -> Vec<Self> {
        let with = |&search| SolverKind::ALL.iter().map(move |&solver| Self { search, solver });
        Correspondence::ALL.iter().flat_map(with).filter(|variant| variant.search.serves(variant.solver)).collect()
    }

    /// Sets the variant in a configuration.
    pub fn set(self, config: &mut Config) {
        config.matching.correspondence = self.search;
        config.matching.solver = self.solver;
    }
}

impl fmt::Display for Variant {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}+{}", self.search.name(), self.solver.name())
    }
}

impl FromStr for Variant {
    type Err = VariantError;

    fn from_str(name: &str) -> Result<Self, VariantError> {
        Self::all().into_iter().find(|variant| variant.to_string() == name).ok_or_else(|| {
            let names: Vec<String> = Self::all().iter().map(ToString::to_string).collect();
            let near = nearest_name(name, names.iter().map(String::as_str));
            VariantError { name: name.into(), hint: near.map_or_else(String::new, |near| format!(" (did you mean '{near}'?)")) }
        })
    }
}
