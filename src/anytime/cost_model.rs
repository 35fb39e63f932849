//! What an answer costs on this machine: learned while running, kept as quantiles, asked before every step.
//!
//! Costs are kept per phase and per octave of rays (64 to 127, 128 to 255, ...), as time per ray in a window of the latest samples.
//! (What the particle filter counts is not rays but particles, and beams cast from all of them.)
//! The quantile of the contract's confidence guards the deadline, the median plans. Nothing is assumed of their distribution, but
//! that a step of many times the usual cost has been preempted: that is not what a step costs. A reserve of its own guards against it.

use std::time::Duration;

use serde::{Deserialize, Serialize};

use super::preemption::Preemptions;
use crate::quantile::quantile;

/// Samples that an octave remembers.
const WINDOW: usize = 2048;
/// Octaves: up to 2^26 rays, as a hundred thousand particles can cast.
const OCTAVES: usize = 26;

/// A cost of so many times the median is a preemption.
const PREEMPTED: f32 = 5.0;

crate::choices! {
    /// A part of the work on a scan, in the order of the work.
    pub enum Phase {
        /// From taking up the scan to the first iteration.
        Setup = "setup",
        /// One iteration.
        Iteration = "iteration",
        /// From the last iteration to the pose handed over.
        Closing = "closing",
    }
}

/// The cost of a phase for scans of an octave of rays.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CostEntry {
    /// `setup`, `iteration` or `closing`.
    pub phase: String,
    /// Number of rays.
    pub rays: u32,
    /// Samples it is known from.
    pub samples: u32,
    /// Half of them took at most this, us.
    pub median_us: f64,
    /// The share of the contract's confidence took at most this, us.
    pub quantile_us: f64,
}

/// The costs of all phases.
#[derive(Clone, Debug)]
pub struct CostModel {
    confidence: f64,
    phases: [[Octave; OCTAVES]; 3],
    preemptions: Preemptions,
    scratch: Vec<f32>,
}

impl CostModel {
    /// Knows nothing yet. `confidence`: the quantile that stands for the cost of what is ahead.
    pub fn new(confidence: f64) -> Self {
        let preemptions = Preemptions::new(1.0 - confidence);
        Self { confidence, phases: Default::default(), preemptions, scratch: Vec::with_capacity(WINDOW) }
    }

    /// Takes note of a cost. [`Self::learn`] draws the conclusions.
    pub fn observe(&mut self, phase: Phase, rays: usize, cost: Duration) {
        if rays > 0 {
            if phase == Phase::Iteration
                && let usual = self.typical(phase, rays)
                && !usual.is_zero()
            {
                self.preemptions.observe(usual, cost);
            }
            self.phases[phase as usize][octave(rays)].push(nanoseconds(cost) / rays as f32);
        }
    }

    /// Draws conclusions from what was observed; to be called when no answer is waited for.
    pub fn learn(&mut self) {
        for octave in self.phases.iter_mut().flatten() {
            octave.learn(self.confidence, &mut self.scratch);
        }
        self.preemptions.learn();
    }

    /// The cost that is not exceeded with the contract's confidence; zero while nothing is known.
    pub fn guarded(&self, phase: Phase, rays: usize) -> Duration {
        self.cost(phase, rays, |octave| octave.quantile)
    }

    /// The cost that is as likely exceeded as not; zero while nothing is known.
    pub fn typical(&self, phase: Phase, rays: usize) -> Duration {
        self.cost(phase, rays, |octave| octave.median)
    }

    /// Time to keep back for preemptions.
    pub fn reserve(&self) -> Duration {
        self.preemptions.reserve()
    }

    /// The cost of several pieces of work, one of which may be slow or preempted for as long as there is a `reserve`; that two are is as
    /// good as out of the question.
    pub fn guarded_sum(&self, pieces: &[(Phase, usize)], reserve: Duration) -> Duration {
        let usual: Duration = pieces.iter().map(|&(phase, rays)| self.typical(phase, rays)).sum();
        let slow = |&(phase, rays): &(Phase, usize)| self.guarded(phase, rays).saturating_sub(self.typical(phase, rays));
        usual + pieces.iter().map(slow).fold(reserve, Duration::max)
    }

    /// An octave without samples is given the nearest one's cost, rather a lower one's, per ray: where there are few of them a ray
    /// costs more. Of a higher one, the cost of its least rays.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // nanoseconds
    fn cost(&self, phase: Phase, rays: usize, quantity: fn(&Octave) -> f32) -> Duration {
        let asked = octave(rays.max(1));
        let nearest = (0..=asked).rev().chain(asked + 1..OCTAVES).find(|&octave| self.phases[phase as usize][octave].is_known());
        let per_ray = nearest.map_or(0.0, |octave| quantity(&self.phases[phase as usize][octave]));
        let least_rays = nearest.map_or(0, |octave| 1 << octave);
        Duration::from_nanos((f64::from(per_ray) * rays.max(least_rays) as f64).ceil() as u64)
    }

    /// Everything that is known, for a file.
    pub fn entries(&self) -> Vec<CostEntry> {
        let mut entries = Vec::new();
        for &phase in Phase::ALL {
            for (octave, known) in self.phases[phase as usize].iter().enumerate().filter(|(_, octave)| octave.is_known()) {
                let rays = 1 << octave;
                let microseconds = |per_ray: f32| f64::from(per_ray) * f64::from(rays) * 1e-3;
                entries.push(CostEntry {
                    phase: phase.name().into(),
                    rays,
                    samples: known.samples.len().try_into().unwrap_or(u32::MAX),
                    median_us: microseconds(known.median),
                    quantile_us: microseconds(known.quantile),
                });
            }
        }
        entries
    }

    /// Starts from what was known at another time; new samples replace it as they come. Entries that make no sense are left out.
    #[allow(clippy::cast_possible_truncation)] // seven digits are plenty
    pub fn recall(&mut self, entries: &[CostEntry]) {
        for entry in entries {
            let Some(phase) = Phase::ALL.iter().find(|phase| phase.name() == entry.phase) else { continue };
            let per_ray = |microseconds: f64| (microseconds * 1e3 / f64::from(entry.rays)) as f32;
            let (median, quantile) = (per_ray(entry.median_us), per_ray(entry.quantile_us));
            if entry.rays > 0 && median.is_finite() && median >= 0.0 && quantile.is_finite() && quantile >= median {
                self.phases[*phase as usize][octave(entry.rays as usize)].recall(median, quantile);
            }
        }
    }
}

fn octave(rays: usize) -> usize {
    (rays.ilog2() as usize).min(OCTAVES - 1)
}

#[allow(clippy::cast_possible_truncation)] // seven digits are plenty
fn nanoseconds(cost: Duration) -> f32 {
    (cost.as_secs_f64() * 1e9) as f32
}

/// The costs of one phase for one octave of rays, ns per ray.
#[derive(Clone, Debug, Default)]
struct Octave {
    samples: Vec<f32>,
    next: usize,
    unlearned: usize,
    median: f32,
    quantile: f32,
}

impl Octave {
    fn is_known(&self) -> bool {
        self.quantile > 0.0
    }

    fn push(&mut self, cost: f32) {
        if self.samples.len() < WINDOW {
            self.samples.reserve_exact(WINDOW - self.samples.len());
            self.samples.push(cost);
        } else {
            self.samples[self.next] = cost;
        }
        self.next = (self.next + 1) % WINDOW;
        self.unlearned += 1;
    }

    /// Again only once the samples have changed noticeably.
    fn learn(&mut self, confidence: f64, scratch: &mut Vec<f32>) {
        if self.unlearned == 0 || self.unlearned < self.samples.len() / 16 {
            return;
        }
        self.unlearned = 0;
        scratch.clear();
        scratch.extend_from_slice(&self.samples);
        let mut cost_at = |share: f64| quantile(scratch, share, f32::total_cmp);
        if let (Some(median), Some(quantile)) = (cost_at(0.5), cost_at(confidence)) {
            (self.median, self.quantile) = (median, quantile.min(PREEMPTED * median));
        }
    }

    fn recall(&mut self, median: f32, quantile: f32) {
        (self.median, self.quantile) = (median, quantile);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn us(cost: u64) -> Duration {
        Duration::from_micros(cost)
    }

    #[test]
    fn quantiles_are_those_of_the_samples_and_scale_with_the_rays() {
        let mut model = CostModel::new(0.99);
        assert_eq!(model.guarded(Phase::Iteration, 100), Duration::ZERO);
        for cost in 1..=100 {
            model.observe(Phase::Iteration, 100, us(cost));
        }
        model.learn();
        let near = |cost: Duration, expected: u64| assert!(cost.abs_diff(us(expected)) < Duration::from_nanos(500), "{cost:?}");
        near(model.typical(Phase::Iteration, 100), 50);
        near(model.guarded(Phase::Iteration, 100), 99);
        near(model.guarded(Phase::Iteration, 200), 198);
        near(model.guarded(Phase::Iteration, 32), 63); // as much as 64 rays
        assert_eq!(model.guarded(Phase::Closing, 100), Duration::ZERO);
    }

    #[test]
    fn interruptions_are_not_reckoned_with() {
        let mut model = CostModel::new(0.99);
        for i in 0..50 {
            model.observe(Phase::Closing, 64, us(if i == 10 { 4000 } else { 20 }));
        }
        model.learn();
        assert!(model.guarded(Phase::Closing, 64) <= us(101));
    }

    #[test]
    fn what_is_long_ago_is_forgotten() {
        let mut model = CostModel::new(0.9);
        for cost in [1000, 10] {
            for _ in 0..WINDOW {
                model.observe(Phase::Setup, 64, us(cost));
            }
        }
        model.learn();
        assert!(model.guarded(Phase::Setup, 64) <= us(11));
    }

    #[test]
    fn it_comes_back_as_it_was_stored_and_learns_on() {
        let mut model = CostModel::new(0.99);
        for rays in [64, 1024] {
            (0..100).for_each(|i| model.observe(Phase::Iteration, rays, us(rays as u64 + i)));
        }
        model.learn();
        let mut other = CostModel::new(0.99);
        other.recall(&model.entries());
        for rays in [64, 100, 1024, 5000] {
            let (cost, again) = (model.guarded(Phase::Iteration, rays), other.guarded(Phase::Iteration, rays));
            assert!(cost.abs_diff(again) < Duration::from_nanos(50), "{cost:?} {again:?}");
        }
        (0..10).for_each(|_| other.observe(Phase::Iteration, 64, us(1)));
        other.learn();
        assert!(other.guarded(Phase::Iteration, 64) <= us(2));
        let broken = CostEntry { phase: "iteration".into(), rays: 0, samples: 1, median_us: f64::NAN, quantile_us: -1.0 };
        other.recall(&[broken]);
        assert!(other.guarded(Phase::Iteration, 64) <= us(2));
    }
}
