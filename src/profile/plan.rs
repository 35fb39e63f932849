//! Which cases are run, and in which order.

use rand::seq::SliceRandom;
use rand_pcg::Pcg64;

use super::knob::Knob;
use super::variant::Variant;
use crate::config::{Config, ConfigError};

/// A variant with one knob set to one value.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Case {
    /// The variant.
    pub variant: Variant,
    /// The knob.
    pub knob: Knob,
    /// Value of the knob, in its unit.
    pub value: f64,
}

impl Case {
    /// The configuration of the case: `base` with the variant and the value set.
    pub fn config(&self, base: &Config) -> Result<Config, ConfigError> {
        let mut config = base.clone();
        self.variant.set(&mut config);
        self.knob.set(&mut config, self.value)?;
        Ok(config)
    }
}

/// A knob and the values to test.
#[derive(Clone, Debug, PartialEq)]
pub struct Sweep {
    /// The knob.
    pub knob: Knob,
    /// Values in the knob's unit; `None`: its default values.
    pub values: Option<Vec<f64>>,
}

/// All cases; each is run once per round.
#[derive(Clone, Debug)]
pub struct Plan {
    /// The cases, sorted by variant, knob and value.
    pub cases: Vec<Case>,
    /// Number of runs of each case.
    pub rounds: u32,
    /// Seed of the order within the rounds.
    pub seed: u32,
}

impl Plan {
    /// Combines every variant with every value of every sweep that affects it. A value that the configuration rejects is an error
    /// here, before anything is run.
    pub fn new(base: &Config, variants: &[Variant], sweeps: &[Sweep], rounds: u32, seed: u32) -> Result<Self, ConfigError> {
        let mut cases: Vec<Case> = Vec::new();
        for &variant in variants {
            for sweep in sweeps.iter().filter(|sweep| sweep.knob.applies_to(variant)) {
                let knob = sweep.knob;
                let mut values = sweep.values.clone().unwrap_or_else(|| knob.default_values(variant).to_vec());
                values.sort_by(|a, b| knob.sort_key(*a).total_cmp(&knob.sort_key(*b)));
                cases.extend(values.into_iter().map(|value| Case { variant, knob, value }));
            }
        }
        // Duplicate values and variants are run once.
        let mut distinct: Vec<Case> = Vec::new();
        for case in cases {
            case.config(base)?;
            if !distinct.contains(&case) {
                distinct.push(case);
            }
        }
        Ok(Self { cases: distinct, rounds, seed })
    }

    /// The random order of the cases in a round. It differs between rounds, so that slow changes of the machine affect all cases
    /// equally.
    pub fn order(&self, round: u32) -> Vec<usize> {
        let mut order: Vec<usize> = (0..self.cases.len()).collect();
        order.shuffle(&mut Pcg64::new(self.seed.into(), round.into()));
        order
    }

    /// Total number of runs.
    pub fn runs(&self) -> usize {
        self.cases.len() * self.rounds as usize
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plan(values: &[f64]) -> Result<Plan, ConfigError> {
        let sweep = Sweep { knob: Knob::MaxIterations, values: Some(values.to_vec()) };
        Plan::new(&Config::default(), &Variant::matchers(), &[sweep], 3, 7)
    }

    #[test]
    fn every_round_runs_every_case_once_in_a_different_order() {
        let plan = plan(&[8.0, 1.0, 8.0]).unwrap();
        let cases = 2 * Variant::matchers().len();
        assert_eq!((plan.cases.len(), plan.runs()), (cases, 3 * cases));
        assert_eq!((plan.cases[0].value, plan.cases[1].value), (1.0, 8.0));
        let (first, second) = (plan.order(0), plan.order(1));
        assert_ne!(first, second);
        for mut order in [first, second] {
            order.sort_unstable();
            assert_eq!(order, (0..cases).collect::<Vec<_>>());
        }
        assert_eq!(plan.order(2), plan.order(2));
    }

    #[test]
    fn a_value_out_of_range_is_rejected_before_anything_is_run() {
        let problem = plan(&[4.0, 0.0]).unwrap_err().to_string();
        assert!(problem.contains("matching.max_iterations") && problem.contains("1 to 1000"), "{problem}");
        assert!(plan(&[1.5]).is_err());
    }
}
