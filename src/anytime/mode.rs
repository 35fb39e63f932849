//! The profile of an estimator: its operating modes, and the conditions under which they were measured.

use std::collections::VecDeque;
use std::fmt;
use std::time::Duration;

use serde::{Deserialize, Serialize};

use super::ErrorEstimate;
use crate::quantile::quantile;

/// An operating mode of the estimator: its delay and the errors to expect.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mode {
    /// Time budget.
    pub delay: Duration,
    /// Position error across the direction of travel, and heading error.
    pub error: ErrorEstimate,
}

/// The non-increasing sequence closest to `values` by least squares: increasing neighbours are pooled at their mean (isotonic
/// regression, M. Ayer et al., Annals of Mathematical Statistics 1955). The smallest value so far would instead promise what was
/// only luck.
pub fn make_non_increasing(values: &mut [f64]) {
    let mut pools: Vec<(f64, usize)> = Vec::new();
    for &value in values.iter() {
        let mut pool = (value, 1);
        while let Some((mean, count)) = pools.pop_if(|(mean, _)| *mean <= pool.0) {
            // Equal values stay the same to the last bit.
            let pooled = mean + (pool.0 - mean) * pool.1 as f64 / (count + pool.1) as f64;
            pool = (pooled, count + pool.1);
        }
        pools.push(pool);
    }
    let pooled = pools.into_iter().flat_map(|(mean, count)| std::iter::repeat_n(mean, count));
    values.iter_mut().zip(pooled).for_each(|(value, pooled)| *value = pooled);
}

/// Number of answers in the median, about a second of scans, so that no single one moves it.
const WINDOW: usize = 40;
/// Fraction of the answers, at either end, that a range leaves out as outliers.
const TAIL_FRACTION: f64 = 0.01;
/// Relative difference of conditions that changes delays and errors by no more than that.
const TOLERANCE: f64 = 0.1;
/// Larger condition numbers are clipped to this: they mean the same, and not every file format can hold them.
const MAX_CONDITION_NUMBER: f64 = 1e9;

/// Conditions of an answer, on which its error and cost depend. NaN: the estimator does not report it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Conditions {
    /// Fraction of the rays that agree with the map or the reference.
    pub agreement: f64,
    /// Number of rays with a valid measurement.
    pub rays: f64,
    /// Condition number of the information matrix of the pose: large if a direction is unconstrained.
    pub condition_number: f64,
}

impl Conditions {
    const NAMES: [&'static str; 3] = ["agreement", "rays", "condition number"];

    fn values(&self) -> [f64; 3] {
        let condition_number =
            if self.condition_number > MAX_CONDITION_NUMBER { MAX_CONDITION_NUMBER } else { self.condition_number };
        [self.agreement, self.rays, condition_number]
    }
}

/// Ranges of the conditions, [min, max] without outliers. `None`: not reported.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ConditionRanges {
    /// Range of [`Conditions::agreement`].
    pub agreement: Option<[f64; 2]>,
    /// Range of [`Conditions::rays`].
    pub rays: Option<[f64; 2]>,
    /// Range of [`Conditions::condition_number`].
    pub condition_number: Option<[f64; 2]>,
}

impl ConditionRanges {
    /// The ranges of these answers, without 1 % at either end.
    pub fn of(answers: impl IntoIterator<Item = Conditions>) -> Self {
        let mut values_of: [Vec<f64>; 3] = Default::default();
        for answer in answers {
            values_of
                .iter_mut()
                .zip(answer.values())
                .for_each(|(values_of, value)| values_of.extend((!value.is_nan()).then_some(value)));
        }
        let [agreement, rays, condition_number] = values_of.map(|mut values| {
            let mut at = |share| quantile(&mut values, share, f64::total_cmp);
            Some([at(TAIL_FRACTION)?, at(1.0 - TAIL_FRACTION)?])
        });
        Self { agreement, rays, condition_number }
    }
}

/// A condition outside the range of the profile: the median of the latest answers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OutOfRange {
    what: &'static str,
    median: f64,
    range: [f64; 2],
}

impl fmt::Display for OutOfRange {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { what, median, range: [min, max] } = self;
        let number = |value: f64| if value < 10.0 { format!("{value:.2}") } else { format!("{value:.0}") };
        write!(f, "{what} {}, in the profile {} to {}", number(*median), number(*min), number(*max))
    }
}

/// Monitors whether answers are in the conditions of a profile.
#[derive(Clone, Debug)]
pub struct ConditionMonitor {
    ranges: ConditionRanges,
    last: VecDeque<[f64; 3]>,
}

impl ConditionMonitor {
    /// Creates a monitor for these ranges.
    pub fn new(ranges: ConditionRanges) -> Self {
        Self { ranges, last: VecDeque::with_capacity(WINDOW) }
    }

    /// Adds an answer; returns a condition that is now out of range, if there is one.
    pub fn add(&mut self, answer: &Conditions) -> Option<OutOfRange> {
        if self.last.len() == WINDOW {
            self.last.pop_front();
        }
        self.last.push_back(answer.values());
        if self.last.len() < WINDOW {
            return None;
        }
        let ranges = [self.ranges.agreement, self.ranges.rays, self.ranges.condition_number];
        ranges.iter().enumerate().find_map(|(k, range)| self.out_of_range(k, (*range)?))
    }

    fn out_of_range(&self, k: usize, range: [f64; 2]) -> Option<OutOfRange> {
        let mut values = [0.0; WINDOW];
        let mut count = 0;
        for value in self.last.iter().map(|values| values[k]).filter(|value| !value.is_nan()) {
            values[count] = value;
            count += 1;
        }
        let median = quantile(&mut values[..count], 0.5, f64::total_cmp)?;
        let is_inside = (range[0] * (1.0 - TOLERANCE)..=range[1] * (1.0 + TOLERANCE)).contains(&median);
        (!is_inside).then_some(OutOfRange { what: Conditions::NAMES[k], median, range })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn conditions(agreement: f64, rays: f64, condition_number: f64) -> Conditions {
        Conditions { agreement, rays, condition_number }
    }

    fn profile() -> ConditionRanges {
        ConditionRanges::of((0..=1000).map(|i| conditions(0.8 + 0.0001 * f64::from(i), 1000.0, 5.0 + 0.01 * f64::from(i))))
    }

    /// The result after this many equal answers.
    fn watched(answer: Conditions, count: usize) -> Option<String> {
        let mut watch = ConditionMonitor::new(profile());
        (0..count).map(|_| watch.add(&answer)).last().flatten().map(|out_of_range| out_of_range.to_string())
    }

    #[test]
    fn increasing_errors_are_pooled() {
        let non_increasing = |values: &[f64]| {
            let mut values = values.to_vec();
            make_non_increasing(&mut values);
            values
        };
        assert_eq!(non_increasing(&[5.0, 3.0, 1.0]), [5.0, 3.0, 1.0]);
        assert_eq!(non_increasing(&[1.0, 3.0, 0.5]), [2.0, 2.0, 0.5]);
        assert_eq!(non_increasing(&[1.0, 2.0, 6.0]), [3.0, 3.0, 3.0]);
        assert_eq!(non_increasing(&[0.1, 0.1, 0.1]), [0.1, 0.1, 0.1]);
        assert_eq!(non_increasing(&[]), [0.0; 0]);
    }

    #[test]
    fn a_range_contains_nearly_all_answers() {
        let [min, max] = profile().condition_number.unwrap();
        assert!((min - 5.1).abs() < 0.02 && (max - 14.9).abs() < 0.02, "{min} {max}");
        assert_eq!(ConditionRanges::of([]), ConditionRanges::default());
        assert_eq!(ConditionRanges::of([conditions(0.5, f64::NAN, f64::INFINITY)]).condition_number, Some([1e9, 1e9]));
    }

    #[test]
    fn a_second_of_answers_out_of_range_is_reported_and_single_ones_are_not() {
        assert_eq!(watched(conditions(0.85, 950.0, 9.0), 100), None);
        assert_eq!(watched(conditions(0.4, 1000.0, 9.0), WINDOW - 1), None);
        assert_eq!(watched(conditions(0.4, 1000.0, 9.0), WINDOW).unwrap(), "agreement 0.40, in the profile 0.80 to 0.90");
        assert!(watched(conditions(0.85, 360.0, 9.0), 100).unwrap().starts_with("rays 360"));
        assert!(watched(conditions(0.85, 1000.0, f64::INFINITY), 100).unwrap().starts_with("condition number"));
        assert_eq!(watched(conditions(f64::NAN, f64::NAN, f64::NAN), 100), None, "unknown conditions are not out of range");
        let mut watch = ConditionMonitor::new(profile());
        let mut mixed = (0..200).map(|i| conditions(if i % 3 == 0 { 0.1 } else { 0.85 }, 1000.0, 9.0));
        assert!(!mixed.any(|answer| watch.add(&answer).is_some()));
    }
}
