//! `profile.yaml`: what error to expect of a time budget, for the node and for planners.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Duration;

use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::yaml;
use crate::anytime::ErrorEstimate;
use crate::anytime::mode::{Mode, Ranges, make_falling};
use crate::knobs::{Value, nearest_name};

/// The expected error of every variant, and the data it was measured on.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Profile {
    /// Where the figures come from.
    pub provenance: Provenance,
    /// By the variant's name.
    pub variants: BTreeMap<String, VariantProfile>,
}

/// What the figures were measured with and on.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Provenance {
    /// Version of this program.
    pub version: String,
    /// The bag.
    pub bag: String,
    /// Topic of the scans.
    pub scan_topic: String,
    /// Topic of the wheel odometry, if there is any.
    pub odometry_topic: Option<String>,
    /// File or topic of the true poses.
    pub truth: String,
    /// What the errors are.
    pub error: String,
    /// Scans of the bag.
    pub scans: usize,
    /// Beams of a scan.
    pub beams: usize,
    /// Runs of each case.
    pub rounds: u32,
    /// Seed of the order of the runs, and of a simulated drive.
    pub seed: u32,
    /// The clock that delays were measured by.
    pub clock: String,
    /// Parameters that were not at their defaults.
    pub parameters: BTreeMap<String, Value>,
}

/// What to expect of one variant.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct VariantProfile {
    /// The knob whose runs the budgets are: `time_budget`, or another one whose delay at percentile 99 stands for the budget.
    pub measured_by: String,
    /// Delay without any iteration, us, on the machine of the study.
    pub setup_us: Option<f64>,
    /// Delay of each ray of an iteration, us, on the machine of the study.
    pub per_ray_us: Option<f64>,
    /// The conditions of the study's answers; elsewhere nothing is known of delays and errors.
    #[serde(default)]
    pub conditions: Ranges,
    /// By rising budget.
    pub budgets: Vec<Budget>,
}

/// A time budget and what came of it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Budget {
    /// The budget, s.
    pub delta_s: f64,
    /// The error to expect.
    #[serde(flatten)]
    pub error: ExpectedError,
}

/// Errors to expect of a pose. They never rise with the budget: who has more time can stop where less would have.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ExpectedError {
    /// Of the position, mean, m.
    pub position_mean_m: f64,
    /// Of the position, at percentile 95, m.
    pub position_p95_m: f64,
    /// Of the orientation, mean, rad.
    pub orientation_mean_rad: f64,
    /// Of the orientation, at percentile 95, rad.
    pub orientation_p95_rad: f64,
}

/// Why a profile is unusable.
#[derive(Debug, Error)]
pub enum ProfileFileError {
    /// The file cannot be read.
    #[error("cannot read the profile {}: {source} (`anytime profile` writes one)", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// The file is no profile.
    #[error("{}: this is no profile: {problem} (`anytime profile` writes one)", path.display())]
    NotAProfile {
        /// The file.
        path: PathBuf,
        /// What does not fit.
        problem: String,
    },
    /// The profile does not have this variant.
    #[error("the profile has no variant '{name}'{hint}; it has: {known}")]
    NoSuchVariant {
        /// The variant asked for.
        name: String,
        /// The one that may have been meant.
        hint: String,
        /// All that it has.
        known: String,
    },
}

impl Profile {
    /// Reads and checks a profile.
    pub fn load(path: &Path) -> Result<Self, ProfileFileError> {
        let text = std::fs::read_to_string(path).map_err(|source| ProfileFileError::Unreadable { path: path.into(), source })?;
        Self::from_yaml(&text).map_err(|problem| ProfileFileError::NotAProfile { path: path.into(), problem })
    }

    /// Reads and checks the text of a profile; the error says what does not fit.
    pub fn from_yaml(text: &str) -> Result<Self, String> {
        let profile: Self = yaml::from_str(text)?;
        for (name, variant) in &profile.variants {
            variant.check().map_err(|problem| format!("{name}: {problem}"))?;
        }
        Ok(profile)
    }

    /// The text of the profile.
    pub fn to_yaml(&self) -> Result<String, String> {
        serde_saphyr::to_string(self).map_err(|error| error.to_string())
    }

    /// What there is on a variant, such as `jump_table+point_to_line`.
    pub fn variant(&self, name: &str) -> Result<&VariantProfile, ProfileFileError> {
        self.variants.get(name).ok_or_else(|| {
            let known: Vec<&str> = self.variants.keys().map(String::as_str).collect();
            let hint =
                nearest_name(name, known.iter().copied()).map_or_else(String::new, |near| format!(" (did you mean '{near}'?)"));
            ProfileFileError::NoSuchVariant { name: name.into(), hint, known: known.join(", ") }
        })
    }
}

impl VariantProfile {
    /// From what was measured: in any order, and with errors that chance may have made rise with the budget.
    pub fn new(measured_by: &str, cost: Option<(f64, f64)>, conditions: Ranges, mut budgets: Vec<Budget>) -> Self {
        budgets.sort_by(|a, b| a.delta_s.total_cmp(&b.delta_s));
        budgets.dedup_by_key(|budget| budget.delta_s);
        for figure in FIGURES {
            let mut values: Vec<f64> = budgets.iter_mut().map(|budget| *figure(&mut budget.error)).collect();
            make_falling(&mut values);
            for (budget, value) in budgets.iter_mut().zip(values) {
                *figure(&mut budget.error) = value;
            }
        }
        let (setup_us, per_ray_us) = cost.unzip();
        Self { measured_by: measured_by.into(), setup_us, per_ray_us, conditions, budgets }
    }

    /// The error to expect within a budget: on the line between the budgets measured; beyond the longest that of the longest. `None` below
    /// the shortest: of that nothing is known.
    pub fn expected_error(&self, delta: Duration) -> Option<ExpectedError> {
        let delta = delta.as_secs_f64();
        let next = self.budgets.partition_point(|budget| budget.delta_s <= delta);
        let before = self.budgets.get(next.checked_sub(1)?)?;
        let Some(after) = self.budgets.get(next) else { return Some(before.error) };
        let fraction = (delta - before.delta_s) / (after.delta_s - before.delta_s);
        let mut error = before.error;
        let mut later = after.error;
        for figure in FIGURES {
            *figure(&mut error) += fraction * (*figure(&mut later) - *figure(&mut error));
        }
        Some(error)
    }

    /// What a controller may choose from, by rising delay. Across the direction of travel the error is no greater than in all.
    pub fn modes(&self) -> Vec<Mode> {
        let mode = |&Budget { delta_s, error }: &Budget| Mode {
            delay: Duration::from_secs_f64(delta_s),
            error: ErrorEstimate { translation: error.position_mean_m, rotation: error.orientation_mean_rad },
        };
        self.budgets.iter().map(mode).collect()
    }

    fn check(&self) -> Result<(), String> {
        if self.budgets.is_empty() {
            return Err("it has no budgets".into());
        }
        let mut longest = 0.0;
        let mut errors: Option<ExpectedError> = None;
        for Budget { delta_s, mut error } in self.budgets.iter().copied() {
            if !(delta_s.is_finite() && delta_s > longest) {
                return Err(format!("delta_s {delta_s} is not a number of seconds above the {longest} before it"));
            }
            for figure in FIGURES {
                let most = errors.as_mut().map_or(f64::MAX, |errors| *figure(errors));
                let value = *figure(&mut error);
                if !(0.0..=most).contains(&value) {
                    return Err(format!(
                        "at delta_s {delta_s} an error is {value}: it must be 0 or more, and not above that of less time"
                    ));
                }
            }
            (longest, errors) = (delta_s, Some(error));
        }
        Ok(())
    }
}

/// Each figure of an expected error.
const FIGURES: [fn(&mut ExpectedError) -> &mut f64; 4] =
    [|e| &mut e.position_mean_m, |e| &mut e.position_p95_m, |e| &mut e.orientation_mean_rad, |e| &mut e.orientation_p95_rad];

#[cfg(test)]
mod tests {
    use super::*;

    fn variant(errors: &[(f64, f64)]) -> VariantProfile {
        let budget = |&(delta_s, e): &(f64, f64)| Budget {
            delta_s,
            error: ExpectedError {
                position_mean_m: e,
                position_p95_m: 2.0 * e,
                orientation_mean_rad: 0.1 * e,
                orientation_p95_rad: 0.2 * e,
            },
        };
        VariantProfile {
            measured_by: "time_budget".into(),
            setup_us: None,
            per_ray_us: None,
            conditions: Ranges { rays: Some([900.0, 1000.0]), ..Ranges::default() },
            budgets: errors.iter().map(budget).collect(),
        }
    }

    #[test]
    fn between_budgets_lies_a_line_and_beyond_them_no_promise() {
        let variant = variant(&[(0.001, 0.5), (0.002, 0.3), (0.004, 0.2)]);
        let at = |ms: f64| variant.expected_error(Duration::from_secs_f64(ms * 1e-3)).map(|e| e.position_mean_m);
        assert_eq!([at(0.5), at(1.0), at(4.0), at(1000.0)], [None, Some(0.5), Some(0.2), Some(0.2)]);
        assert!((at(1.5).unwrap() - 0.4).abs() < 1e-12 && (at(3.0).unwrap() - 0.25).abs() < 1e-12);
    }

    #[test]
    fn a_damaged_profile_is_refused() {
        assert!(variant(&[(0.001, 0.5), (0.002, 0.3)]).check().is_ok());
        for bad in [&[][..], &[(0.002, 0.5), (0.001, 0.3)], &[(0.001, 0.3), (0.002, 0.5)], &[(0.001, f64::NAN)], &[(0.0, 1.0)]] {
            assert!(variant(bad).check().is_err(), "{bad:?}");
        }
        assert!(Profile::from_yaml("a: 1\n").is_err());
    }
}
