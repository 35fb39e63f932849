//! Learns at run time what an answer costs on this machine, as quantiles that are checked before every step.
//!
//! Costs are kept per phase and per octave of rays (64 to 127, 128 to 255, ...), as time per ray in a window of the latest
//! samples. (The particle filter counts particles, or beams cast from all of them, instead of rays.) The quantile of the
//! contract's confidence guards the deadline, the median is used for planning. No distribution is assumed, except that a step of
//! many times the typical cost was preempted; that time is not part of the step's cost but covered by a separate reserve.

use std::time::Duration;

use serde::{Deserialize, Serialize};

use super::preemption::Preemptions;
use crate::quantile::quantile;

/// Number of samples kept per octave.
const WINDOW: usize = 2048;
/// Number of octaves: up to 2^26 rays, as many as a hundred thousand particles can cast.
const OCTAVES: usize = 26;

/// A cost of more than this many medians is due to preemption.
const PREEMPTION_RATIO: f32 = 5.0;

crate::choices! {
    /// A phase of the work on a scan, in their order.
    pub enum Phase {
        /// From the start of processing to the first iteration.
        Setup = "setup",
        /// One iteration.
        Iteration = "iteration",
        /// From the last iteration to the published pose.
        Closing = "closing",
    }
}

/// Cost of a phase for an octave of rays.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CostEntry {
    /// `setup`, `iteration` or `closing`.
    pub phase: String,
    /// Number of rays.
    pub rays: u32,
    /// Number of samples.
    pub samples: u32,
    /// Median of the cost, us.
    pub median_us: f64,
    /// Quantile of the cost at the contract's confidence, us.
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
    /// An empty model. `confidence` is the quantile used as the upper bound of a cost.
    pub fn new(confidence: f64) -> Self {
        let preemptions = Preemptions::new(1.0 - confidence);
        Self { confidence, phases: Default::default(), preemptions, scratch: Vec::with_capacity(WINDOW) }
    }

    /// Records a cost. [`Self::learn`] evaluates it.
    pub fn observe(&mut self, phase: Phase, rays: usize, cost: Duration) {
        if rays > 0 {
            if phase == Phase::Iteration
                && let typical = self.typical(phase, rays)
                && !typical.is_zero()
            {
                self.preemptions.observe(typical, cost);
            }
            self.phases[phase as usize][octave(rays)].push(nanoseconds(cost) / rays as f32);
        }
    }

    /// Evaluates the recorded costs; call it when no answer is pending.
    pub fn learn(&mut self) {
        for octave in self.phases.iter_mut().flatten() {
            octave.learn(self.confidence, &mut self.scratch);
        }
        self.preemptions.learn();
    }

    /// The cost that is not exceeded with the contract's confidence; zero if unknown.
    pub fn upper_bound(&self, phase: Phase, rays: usize) -> Duration {
        self.cost(phase, rays, |octave| octave.quantile)
    }

    /// The median cost; zero if unknown.
    pub fn typical(&self, phase: Phase, rays: usize) -> Duration {
        self.cost(phase, rays, |octave| octave.median)
    }

    /// Time to reserve for preemption.
    pub fn reserve(&self) -> Duration {
        self.preemptions.reserve()
    }

    /// Upper bound for the cost of several pieces of work, of which one may be slow or preempted for `reserve`. Two at once are
    /// too unlikely to matter.
    pub fn upper_bound_sum(&self, pieces: &[(Phase, usize)], reserve: Duration) -> Duration {
        let typical: Duration = pieces.iter().map(|&(phase, rays)| self.typical(phase, rays)).sum();
        let slow = |&(phase, rays): &(Phase, usize)| self.upper_bound(phase, rays).saturating_sub(self.typical(phase, rays));
        typical + pieces.iter().map(slow).fold(reserve, Duration::max)
    }

    /// An octave without samples gets the cost per ray of the nearest octave, preferably a smaller one, since a ray costs more if
    /// there are few. From a larger octave it gets the cost of that octave's minimum number of rays.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // nanoseconds
    fn cost(&self, phase: Phase, rays: usize, quantity: fn(&Octave) -> f32) -> Duration {
        let wanted = octave(rays.max(1));
        let nearest =
            (0..=wanted).rev().chain(wanted + 1..OCTAVES).find(|&octave| self.phases[phase as usize][octave].is_known());
        let per_ray = nearest.map_or(0.0, |octave| quantity(&self.phases[phase as usize][octave]));
        let min_rays = nearest.map_or(0, |octave| 1 << octave);
        Duration::from_nanos((f64::from(per_ray) * rays.max(min_rays) as f64).ceil() as u64)
    }

    /// All learned costs, for a file.
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

    /// Starts from stored costs, which new samples gradually replace. Invalid entries are skipped.
    #[allow(clippy::cast_possible_truncation)] // seven digits are plenty
    pub fn restore(&mut self, entries: &[CostEntry]) {
        for entry in entries {
            let Some(phase) = Phase::ALL.iter().find(|phase| phase.name() == entry.phase) else { continue };
            let per_ray = |microseconds: f64| (microseconds * 1e3 / f64::from(entry.rays)) as f32;
            let (median, quantile) = (per_ray(entry.median_us), per_ray(entry.quantile_us));
            if entry.rays > 0 && median.is_finite() && median >= 0.0 && quantile.is_finite() && quantile >= median {
                self.phases[*phase as usize][octave(entry.rays as usize)].restore(median, quantile);
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

/// Costs of one phase for one octave of rays, ns per ray.
#[derive(Clone, Debug, Default)]
struct Octave {
    samples: Vec<f32>,
    next: usize,
    new_samples: usize,
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
        self.new_samples += 1;
    }

    /// Re-evaluates the quantiles once enough samples are new.
    fn learn(&mut self, confidence: f64, scratch: &mut Vec<f32>) {
        if self.new_samples == 0 || self.new_samples < self.samples.len() / 16 {
            return;
        }
        self.new_samples = 0;
        scratch.clear();
        scratch.extend_from_slice(&self.samples);
        let mut cost_at = |share: f64| quantile(scratch, share, f32::total_cmp);
        if let (Some(median), Some(quantile)) = (cost_at(0.5), cost_at(confidence)) {
            (self.median, self.quantile) = (median, quantile.min(PREEMPTION_RATIO * median));
        }
    }

    fn restore(&mut self, median: f32, quantile: f32) {
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
        assert_eq!(model.upper_bound(Phase::Iteration, 100), Duration::ZERO);
        for cost in 1..=100 {
            model.observe(Phase::Iteration, 100, us(cost));
        }
        model.learn();
        let near = |cost: Duration, expected: u64| assert!(cost.abs_diff(us(expected)) < Duration::from_nanos(500), "{cost:?}");
        near(model.typical(Phase::Iteration, 100), 50);
        near(model.upper_bound(Phase::Iteration, 100), 99);
        near(model.upper_bound(Phase::Iteration, 200), 198);
        near(model.upper_bound(Phase::Iteration, 32), 63); // as much as 64 rays
        assert_eq!(model.upper_bound(Phase::Closing, 100), Duration::ZERO);
    }

    #[test]
    fn preemptions_are_not_part_of_the_cost() {
        let mut model = CostModel::new(0.99);
        for i in 0..50 {
            model.observe(Phase::Closing, 64, us(if i == 10 { 4000 } else { 20 }));
        }
        model.learn();
        assert!(model.upper_bound(Phase::Closing, 64) <= us(101));
    }

    #[test]
    fn old_samples_are_forgotten() {
        let mut model = CostModel::new(0.9);
        for cost in [1000, 10] {
            for _ in 0..WINDOW {
                model.observe(Phase::Setup, 64, us(cost));
            }
        }
        model.learn();
        assert!(model.upper_bound(Phase::Setup, 64) <= us(11));
    }

    #[test]
    fn stored_costs_are_restored_and_updated() {
        let mut model = CostModel::new(0.99);
        for rays in [64, 1024] {
            (0..100).for_each(|i| model.observe(Phase::Iteration, rays, us(rays as u64 + i)));
        }
        model.learn();
        let mut other = CostModel::new(0.99);
        other.restore(&model.entries());
        for rays in [64, 100, 1024, 5000] {
            let (cost, again) = (model.upper_bound(Phase::Iteration, rays), other.upper_bound(Phase::Iteration, rays));
            assert!(cost.abs_diff(again) < Duration::from_nanos(50), "{cost:?} {again:?}");
        }
        (0..10).for_each(|_| other.observe(Phase::Iteration, 64, us(1)));
        other.learn();
        assert!(other.upper_bound(Phase::Iteration, 64) <= us(2));
        let broken = CostEntry { phase: "iteration".into(), rays: 0, samples: 1, median_us: f64::NAN, quantile_us: -1.0 };
        other.restore(&[broken]);
        assert!(other.upper_bound(Phase::Iteration, 64) <= us(2));
    }
}
