//! `profile.yaml`: the expected error for each time budget, for the node and for planners.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::Duration;

use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::yaml;
use crate::anytime::ErrorEstimate;
use crate::anytime::mode::{ConditionRanges, Mode, make_non_increasing};
use crate::knobs::{Value, nearest_name};

/// The expected errors of every variant, and the data on which they were measured.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Profile {
    /// How the errors were measured.
    pub provenance: Provenance,
    /// Expected errors by name of the variant.
    pub variants: BTreeMap<String, VariantProfile>,
}

/// How, and on which data, the errors were measured.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Provenance {
    /// Version of this program.
    pub version: String,
    /// Path of the bag.
    pub bag: String,
    /// Topic of the scans.
    pub scan_topic: String,
    /// Topic of the wheel odometry, if it was used.
    pub odometry_topic: Option<String>,
    /// File or topic of the true poses.
    pub truth: String,
    /// Definition of the errors.
    pub error: String,
    /// Number of scans of the bag.
    pub scans: usize,
    /// Number of beams of a scan.
    pub beams: usize,
    /// Number of runs of each case.
    pub rounds: u32,
    /// Random seed of the order of the runs, and of a simulated drive.
    pub seed: u32,
    /// The clock that measured the delays.
    pub clock: String,
    /// Parameters that were not at their defaults.
    pub parameters: BTreeMap<String, Value>,
}

/// Expected errors of one variant.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct VariantProfile {
    /// The knob that was varied: `time_budget`, or another one, whose 99th percentile of the delay then serves as the budget.
    pub measured_by: String,
    /// Delay without any iteration, us, on the machine of the study.
    pub setup_us: Option<f64>,
    /// Delay of each ray of an iteration, us, on the machine of the study.
    pub per_ray_us: Option<f64>,
    /// The conditions under which the study was made; outside them, delays and errors are unknown.
    #[serde(default)]
    pub conditions: ConditionRanges,
    /// The budgets, in increasing order.
    pub budgets: Vec<Budget>,
}

/// A time budget and its expected error.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Budget {
    /// The budget, s.
    pub delta_s: f64,
    /// The expected error.
    #[serde(flatten)]
    pub error: ExpectedError,
}

/// Expected errors of a pose. They never increase with the budget: a longer budget need not be used up.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ExpectedError {
    /// Mean position error, m.
    pub position_mean_m: f64,
    /// 95th percentile of the position error, m.
    pub position_p95_m: f64,
    /// Mean orientation error, rad.
    pub orientation_mean_rad: f64,
    /// 95th percentile of the orientation error, rad.
    pub orientation_p95_rad: f64,
}

/// Why a profile cannot be used.
#[derive(Debug, Error)]
pub enum ProfileFileError {
    /// The file cannot be read.
    #[error("cannot read the profile {}: {source} (`anytime profile` writes one)", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        source: std::io::Error,
    },
    /// The file is not a valid profile.
    #[error("{} is not a valid profile: {problem} (`anytime profile` writes one)", path.display())]
    NotAProfile {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        problem: String,
    },
    /// The profile does not have this variant.
    #[error("the profile has no variant '{name}'{hint}; it has: {known}")]
    NoSuchVariant {
        /// The requested variant.
        name: String,
        /// Suggestion of a similar name, or empty.
        hint: String,
        /// Names of all variants.
        known: String,
    },
}

impl Profile {
    /// Reads and checks a profile.
    pub fn load(path: &Path) -> Result<Self, ProfileFileError> {
        let text = std::fs::read_to_string(path).map_err(|source| ProfileFileError::Unreadable { path: path.into(), source })?;
        Self::from_yaml(&text).map_err(|problem| ProfileFileError::NotAProfile { path: path.into(), problem })
    }

    /// Parses and checks the text of a profile; the error says what is wrong.
    pub fn from_yaml(text: &str) -> Result<Self, String> {
        let profile: Self = yaml::from_str(text)?;
        for (name, variant) in &profile.variants {
            variant.check().map_err(|problem| format!("{name}: {problem}"))?;
        }
        Ok(profile)
    }

    /// Serializes the profile.
    pub fn to_yaml(&self) -> Result<String, String> {
        serde_saphyr::to_string(self).map_err(|error| error.to_string())
    }

    /// The profile of a variant, such as `jump_table+point_to_line`.
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
    /// Makes a profile from measured budgets, in any order. Errors that increase with the budget by chance are made
    /// non-increasing.
    pub fn new(measured_by: &str, cost: Option<(f64, f64)>, conditions: ConditionRanges, mut budgets: Vec<Budget>) -> Self {
        budgets.sort_by(|a, b| a.delta_s.total_cmp(&b.delta_s));
        budgets.dedup_by_key(|budget| budget.delta_s);
        for field in ERROR_FIELDS {
            let mut values: Vec<f64> = budgets.iter_mut().map(|budget| *field(&mut budget.error)).collect();
            make_non_increasing(&mut values);
            for (budget, value) in budgets.iter_mut().zip(values) {
                *field(&mut budget.error) = value;
            }
        }
        let (setup_us, per_ray_us) = cost.unzip();
        Self { measured_by: measured_by.into(), setup_us, per_ray_us, conditions, budgets }
    }

    /// The expected error for a budget: interpolated linearly between the measured budgets; beyond the longest, that of the
    /// longest. `None` below the shortest, where it is unknown.
    pub fn expected_error(&self, delta: Duration) -> Option<ExpectedError> {
        let delta = delta.as_secs_f64();
        let next = self.budgets.partition_point(|budget| budget.delta_s <= delta);
        let before = self.budgets.get(next.checked_sub(1)?)?;
        let Some(after) = self.budgets.get(next) else { return Some(before.error) };
        let fraction = (delta - before.delta_s) / (after.delta_s - before.delta_s);
        let mut error = before.error;
        let mut later = after.error;
        for field in ERROR_FIELDS {
            *field(&mut error) += fraction * (*field(&mut later) - *field(&mut error));
        }
        Some(error)
    }

    /// The modes from which a controller may choose, by increasing delay. Their translation error is the total position error, an
    /// upper bound of the error across the direction of travel.
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
                return Err(format!("delta_s {delta_s} must be a number of seconds greater than the previous one, {longest}"));
            }
            for field in ERROR_FIELDS {
                let previous = errors.as_mut().map_or(f64::MAX, |errors| *field(errors));
                let value = *field(&mut error);
                if !(0.0..=previous).contains(&value) {
                    return Err(format!(
                        "an error at delta_s {delta_s} is {value}: it must be at least 0 and at most that of a shorter budget"
                    ));
                }
            }
            (longest, errors) = (delta_s, Some(error));
        }
        Ok(())
    }
}

/// Accessors of all fields of an expected error.
const ERROR_FIELDS: [fn(&mut ExpectedError) -> &mut f64; 4] =
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
            conditions: ConditionRanges { rays: Some([900.0, 1000.0]), ..ConditionRanges::default() },
            budgets: errors.iter().map(budget).collect(),
        }
    }

    #[test]
    fn errors_are_interpolated_between_budgets_and_unknown_below_them() {
        let variant = variant(&[(0.001, 0.5), (0.002, 0.3), (0.004, 0.2)]);
        let at = |ms: f64| variant.expected_error(Duration::from_secs_f64(ms * 1e-3)).map(|e| e.position_mean_m);
        assert_eq!([at(0.5), at(1.0), at(4.0), at(1000.0)], [None, Some(0.5), Some(0.2), Some(0.2)]);
        assert!((at(1.5).unwrap() - 0.4).abs() < 1e-12 && (at(3.0).unwrap() - 0.25).abs() < 1e-12);
    }

    #[test]
    fn a_damaged_profile_is_rejected() {
        assert!(variant(&[(0.001, 0.5), (0.002, 0.3)]).check().is_ok());
        for bad in [&[][..], &[(0.002, 0.5), (0.001, 0.3)], &[(0.001, 0.3), (0.002, 0.5)], &[(0.001, f64::NAN)], &[(0.0, 1.0)]] {
            assert!(variant(bad).check().is_err(), "{bad:?}");
        }
        assert!(Profile::from_yaml("a: 1\n").is_err());
    }
}
