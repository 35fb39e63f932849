//! The parameters (knobs) whose trade-off between delay and error is measured.

use std::time::Duration;

use super::variant::Variant;
use crate::config::{Config, ConfigError};
use crate::knobs::{KnobValue, Seconds, Value};
use crate::matching::MatchingKnobs;

crate::choices! {
    /// A parameter that a study varies.
    pub enum Knob {
        /// Maximum iterations of a match.
        MaxIterations = "max_iterations",
        /// Maximum time from the arrival of a scan to its pose.
        TimeBudget = "time_budget",
        /// Maximum rays of a scan that are matched; 0: all.
        Beams = "beams",
        /// Driven distance after which a scan becomes a new keyframe.
        KeyframeDistance = "keyframe_distance",
        /// Number of particles of the filter.
        Particles = "particles",
        /// Period of the filter's update timer; 0: every scan triggers an update.
        UpdatePeriod = "update_period",
    }
}

/// Properties of a knob.
struct Description {
    path: &'static str,
    unit: &'static str,
    values: &'static [f64],
    /// Values for correspondence searches other than the default one: a few suffice to compare them.
    few_values: &'static [f64],
}

impl Knob {
    fn description(self) -> Description {
        match self {
            Self::MaxIterations => Description {
                path: "matching.max_iterations",
                unit: "",
                values: &[1.0, 2.0, 3.0, 4.0, 6.0, 10.0, 30.0],
                few_values: &[1.0, 2.0, 4.0],
            },
            Self::TimeBudget => Description {
                path: "contract.time_budget",
                unit: "s",
                values: &[2e-5, 5e-5, 1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 5e-3],
                few_values: &[1e-3, 5e-3],
            },
            Self::Beams => Description {
                path: "matching.max_rays",
                unit: "",
                values: &[45.0, 90.0, 180.0, 360.0, 720.0, 0.0],
                few_values: &[90.0, 360.0],
            },
            Self::KeyframeDistance => {
                Description { path: "odometry.keyframe_distance", unit: "m", values: &[0.0, 0.25, 0.5, 1.0], few_values: &[0.5] }
            }
            Self::Particles => Description {
                path: "localization.particles",
                unit: "",
                values: &[50.0, 100.0, 200.0, 500.0, 1000.0, 2000.0, 4000.0, 8000.0],
                few_values: &[],
            },
            Self::UpdatePeriod => Description {
                path: "localization.update_period",
                unit: "s",
                values: &[0.01, 0.025, 0.05, 0.1, 0.2, 0.4, 0.8],
                few_values: &[],
            },
        }
    }

    /// Name of the parameter in the configuration, with its group.
    pub fn path(self) -> &'static str {
        self.description().path
    }

    /// Unit of the values; empty for counts.
    pub fn unit(self) -> &'static str {
        self.description().unit
    }

    /// Whether the knob affects a variant.
    pub fn applies_to(self, variant: Variant) -> bool {
        match self {
            Self::TimeBudget => true,
            Self::Particles | Self::UpdatePeriod => variant == Variant::Filter,
            Self::MaxIterations | Self::Beams | Self::KeyframeDistance => variant != Variant::Filter,
        }
    }

    /// The values that are tested if none are given.
    pub fn default_values(self, variant: Variant) -> &'static [f64] {
        let description = self.description();
        match variant.search() {
            None if self == Self::TimeBudget => &[5e-4, 1e-3, 2e-3, 5e-3, 1e-2, 2e-2],
            Some(search) if search != MatchingKnobs::default().correspondence => description.few_values,
            _ => description.values,
        }
    }

    /// Whether the values are times.
    fn is_time(self) -> bool {
        matches!(self, Self::TimeBudget | Self::UpdatePeriod)
    }

    /// Parses a value in the knob's unit: a number, for times also with a unit such as `5ms`.
    pub fn parse(self, text: &str) -> Result<f64, String> {
        let value = text.parse::<f64>().map_or_else(|_| Value::from(text), Value::from);
        let number = match self {
            _ if self.is_time() => Seconds::from_value(&value).map(|seconds| seconds.0),
            _ => f64::from_value(&value),
        };
        number.map_err(|problem| format!("{}: {problem}", self.name()))
    }

    /// Formats a value for reports.
    pub fn show(self, value: f64) -> String {
        match self {
            Self::TimeBudget if value == 0.0 => "no limit".into(),
            Self::UpdatePeriod if value == 0.0 => "every scan".into(),
            _ if self.is_time() => Duration::try_from_secs_f64(value)
                .map_or_else(|_| value.to_string(), |d| humantime::format_duration(d).to_string()),
            Self::Beams if value == 0.0 => "all".into(),
            Self::KeyframeDistance => format!("{value} m"),
            _ => value.to_string(),
        }
    }

    /// Sort key of a value: 0, if it means "no limit", comes last.
    pub(super) fn sort_key(self, value: f64) -> f64 {
        let is_unlimited = matches!(self, Self::TimeBudget | Self::Beams) && value == 0.0;
        if is_unlimited { f64::INFINITY } else { value }
    }

    /// Sets the knob's value in a configuration.
    pub fn set(self, config: &mut Config, value: f64) -> Result<(), ConfigError> {
        // Knobs that are counts accept 8 but not 8.0.
        #[allow(clippy::cast_possible_truncation)] // whole numbers only, saturating: the configuration checks the range
        let number = if value.fract() == 0.0 { Value::from(value as i64) } else { Value::from(value) };
        config.set(self.path(), &number, self.name())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_parsed_with_and_without_units() {
        assert_eq!(Knob::TimeBudget.parse("5ms"), Ok(0.005));
        assert_eq!(Knob::TimeBudget.parse("0.005"), Ok(0.005));
        assert_eq!(Knob::KeyframeDistance.parse("0.5"), Ok(0.5));
        assert!(Knob::MaxIterations.parse("many").unwrap_err().contains("max_iterations"));
        assert_eq!([Knob::TimeBudget.show(0.005), Knob::Beams.show(0.0), Knob::Beams.show(90.0)], ["5ms", "all", "90"]);
    }

    #[test]
    fn the_configuration_accepts_every_default_value() {
        for &knob in Knob::ALL {
            for variant in Variant::matchers().into_iter().chain([Variant::Filter]) {
                for value in knob.default_values(variant) {
                    knob.set(&mut Config::default(), *value).unwrap();
                }
            }
        }
    }
}
