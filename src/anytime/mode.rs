//! What is known of an estimator beforehand: its modes, and the conditions that they were found in.

use std::collections::VecDeque;
use std::fmt;
use std::time::Duration;

use serde::{Deserialize, Serialize};

use super::ErrorEstimate;
use crate::quantile::quantile;

/// A way for the estimator to work: its delay, and the errors to expect of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mode {
    /// The time budget.
    pub delay: Duration,
    /// Of the position across the direction of travel, and of the heading.
    pub error: ErrorEstimate,
}

/// The falling sequence nearest to `values` by least squares: neighbours that rise are pooled at their mean (M. Ayer et al., Annals of
/// Mathematical Statistics 1955). Taking the least value so far instead would promise what chance alone gave.
pub fn make_falling(values: &mut [f64]) {
    let mut pools: Vec<(f64, usize)> = Vec::new();
    for &value in values.iter() {
        let mut pool = (value, 1);
        while let Some((mean, count)) = pools.pop_if(|(mean, _)| *mean <= pool.0) {
            // Equal ones keep their value to the last bit.
            let pooled = mean + (pool.0 - mean) * pool.1 as f64 / (count + pool.1) as f64;
            pool = (pooled, count + pool.1);
        }
        pools.push(pool);
    }
    let pooled = pools.into_iter().flat_map(|(mean, count)| std::iter::repeat_n(mean, count));
    values.iter_mut().zip(pooled).for_each(|(value, pooled)| *value = pooled);
}

/// As many answers are looked at as make a median that no single one moves: a second of scans.
const WINDOW: usize = 40;
/// Part of the answers that a range leaves out at either end: the odd ones.
const ODD: f64 = 0.01;
/// Conditions that are off by a smaller part than this change delays and errors by no more.
const UNNOTICED: f64 = 0.1;
/// A greater condition number says no more, but could not stand in every file.
const GREATEST_CONDITION: f64 = 1e9;

/// What an answer found: how good and how costly it can be depends on that. NaN: the estimator does not tell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Conditions {
    /// Part of the rays that agree with what is known of the place.
    pub agreement: f64,
    /// Rays that carry a measurement.
    pub rays: f64,
    /// Of the information about the pose: large where the walls leave a direction open.
    pub condition_number: f64,
}

impl Conditions {
    const NAMES: [&'static str; 3] = ["agreement", "rays", "condition number"];

    fn values(&self) -> [f64; 3] {
        let condition_number =
            if self.condition_number > GREATEST_CONDITION { GREATEST_CONDITION } else { self.condition_number };
        [self.agreement, self.rays, condition_number]
    }
}

/// The conditions of nearly all answers: least and greatest. `None`: they were not told.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Ranges {
    /// Of [`Conditions::agreement`].
    pub agreement: Option<[f64; 2]>,
    /// Of [`Conditions::rays`].
    pub rays: Option<[f64; 2]>,
    /// Of [`Conditions::condition_number`].
    pub condition_number: Option<[f64; 2]>,
}

impl Ranges {
    /// Of these answers, but for one in a hundred at either end.
    pub fn of(answers: impl IntoIterator<Item = Conditions>) -> Self {
        let mut told: [Vec<f64>; 3] = Default::default();
        for answer in answers {
            told.iter_mut().zip(answer.values()).for_each(|(told, value)| told.extend((!value.is_nan()).then_some(value)));
        }
        let [agreement, rays, condition_number] = told.map(|mut values| {
            let mut at = |share| quantile(&mut values, share, f64::total_cmp);
            Some([at(ODD)?, at(1.0 - ODD)?])
        });
        Self { agreement, rays, condition_number }
    }
}

/// What is as it was not where the ranges are from: a median of the last answers outside its range.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Outside {
    what: &'static str,
    median: f64,
    range: [f64; 2],
}

impl fmt::Display for Outside {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { what, median, range: [least, greatest] } = self;
        let number = |value: f64| if value < 10.0 { format!("{value:.2}") } else { format!("{value:.0}") };
        write!(f, "{what} {}, in the profile {} to {}", number(*median), number(*least), number(*greatest))
    }
}

/// Watches whether answers are found in the conditions of a profile.
#[derive(Clone, Debug)]
pub struct Watch {
    ranges: Ranges,
    last: VecDeque<[f64; 3]>,
}

impl Watch {
    /// Against these ranges.
    pub fn new(ranges: Ranges) -> Self {
        Self { ranges, last: VecDeque::with_capacity(WINDOW) }
    }

    /// Takes an answer. What is outside its range then, if anything is.
    pub fn add(&mut self, answer: &Conditions) -> Option<Outside> {
        if self.last.len() == WINDOW {
            self.last.pop_front();
        }
        self.last.push_back(answer.values());
        if self.last.len() < WINDOW {
            return None;
        }
        let ranges = [self.ranges.agreement, self.ranges.rays, self.ranges.condition_number];
        ranges.iter().enumerate().find_map(|(k, range)| self.outside(k, (*range)?))
    }

    fn outside(&self, k: usize, range: [f64; 2]) -> Option<Outside> {
        let mut values = [0.0; WINDOW];
        let mut count = 0;
        for value in self.last.iter().map(|values| values[k]).filter(|value| !value.is_nan()) {
            values[count] = value;
            count += 1;
        }
        let median = quantile(&mut values[..count], 0.5, f64::total_cmp)?;
        let is_inside = (range[0] * (1.0 - UNNOTICED)..=range[1] * (1.0 + UNNOTICED)).contains(&median);
        (!is_inside).then_some(Outside { what: Conditions::NAMES[k], median, range })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn conditions(agreement: f64, rays: f64, condition_number: f64) -> Conditions {
        Conditions { agreement, rays, condition_number }
    }

    fn hall() -> Ranges {
        Ranges::of((0..=1000).map(|i| conditions(0.8 + 0.0001 * f64::from(i), 1000.0, 5.0 + 0.01 * f64::from(i))))
    }

    /// After so many equal answers.
    fn watched(answer: Conditions, count: usize) -> Option<String> {
        let mut watch = Watch::new(hall());
        (0..count).map(|_| watch.add(&answer)).last().flatten().map(|outside| outside.to_string())
    }

    #[test]
    fn errors_that_rise_are_pooled() {
        let falling = |values: &[f64]| {
            let mut values = values.to_vec();
            make_falling(&mut values);
            values
        };
        assert_eq!(falling(&[5.0, 3.0, 1.0]), [5.0, 3.0, 1.0]);
        assert_eq!(falling(&[1.0, 3.0, 0.5]), [2.0, 2.0, 0.5]);
        assert_eq!(falling(&[1.0, 2.0, 6.0]), [3.0, 3.0, 3.0]);
        assert_eq!(falling(&[0.1, 0.1, 0.1]), [0.1, 0.1, 0.1]);
        assert_eq!(falling(&[]), [0.0; 0]);
    }

    #[test]
    fn a_range_holds_nearly_all_answers() {
        let [least, greatest] = hall().condition_number.unwrap();
        assert!((least - 5.1).abs() < 0.02 && (greatest - 14.9).abs() < 0.02, "{least} {greatest}");
        assert_eq!(Ranges::of([]), Ranges::default());
        assert_eq!(Ranges::of([conditions(0.5, f64::NAN, f64::INFINITY)]).condition_number, Some([1e9, 1e9]));
    }

    #[test]
    fn a_second_of_answers_elsewhere_is_told_and_single_ones_are_not() {
        assert_eq!(watched(conditions(0.85, 950.0, 9.0), 100), None);
        assert_eq!(watched(conditions(0.4, 1000.0, 9.0), WINDOW - 1), None);
        assert_eq!(watched(conditions(0.4, 1000.0, 9.0), WINDOW).unwrap(), "agreement 0.40, in the profile 0.80 to 0.90");
        assert!(watched(conditions(0.85, 360.0, 9.0), 100).unwrap().starts_with("rays 360"));
        assert!(watched(conditions(0.85, 1000.0, f64::INFINITY), 100).unwrap().starts_with("condition number"));
        assert_eq!(watched(conditions(f64::NAN, f64::NAN, f64::NAN), 100), None, "who tells nothing is nowhere");
        let mut watch = Watch::new(hall());
        let mut mixed = (0..200).map(|i| conditions(if i % 3 == 0 { 0.1 } else { 0.85 }, 1000.0, 9.0));
        assert!(!mixed.any(|answer| watch.add(&answer).is_some()));
    }
}
