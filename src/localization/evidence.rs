//! The likelihood of a scan for every particle, processed a few beams at a time.

use std::ops::Range;

use super::model::Model;
use super::observation::Observation;
use super::particles::{Particles, effective_number, relative};
use super::streams::CHUNK;
use crate::raycasting::Viewpoint;

/// Maximum number of rays (over all particles) cast before the clock is read again: a fraction of a millisecond of work.
const RAYS_PER_STEP: usize = 8192;
/// Minimum number of steps for a scan.
const MIN_STEPS: usize = 8;
/// Maximum number of particles sampled to estimate the effective fraction.
const MAX_SAMPLE: usize = 16_384;
/// Bisection steps for the exponent that tempers the likelihood of a scan.
const BISECTIONS: usize = 12;

/// The scan being processed, and its likelihoods so far.
#[derive(Default)]
pub(super) struct Evidence {
    observation: Observation,
    /// Pose of the laser for each particle.
    views: Vec<Viewpoint>,
    /// Number of beams processed so far.
    processed: usize,
    /// Log-likelihood of these beams for each particle.
    log_likelihoods: Vec<f32>,
}

impl Evidence {
    /// Starts a new scan, with the laser at these poses.
    pub(super) fn begin(&mut self, observation: Observation, views: impl Iterator<Item = Viewpoint>) {
        self.observation = observation;
        self.views.clear();
        self.views.extend(views);
        self.processed = 0;
        self.log_likelihoods.clear();
        self.log_likelihoods.resize(self.views.len(), 0.0);
    }

    /// Number of beams processed so far.
    pub(super) fn processed(&self) -> usize {
        self.processed
    }

    /// The beams of the next step; empty when all are processed.
    pub(super) fn next_beams(&self) -> Range<usize> {
        let limit = self.observation.len().div_ceil(MIN_STEPS);
        let count = (RAYS_PER_STEP / self.views.len().max(1)).min(limit).max(1);
        self.processed..(self.processed + count).min(self.observation.len())
    }

    /// Processes the beams of the next step.
    pub(super) fn process_next(&mut self, model: &Model) {
        let beams = self.next_beams();
        self.processed = beams.end;
        let scan = self.observation.subset(beams);
        let tasks = self.views.chunks(CHUNK).zip(self.log_likelihoods.chunks_mut(CHUNK));
        model.workers.for_each(tasks, |_, (views, sums)| model.add_log_likelihoods(&model.beams, &scan, views, sums));
    }

    /// Computes the log-weights after the beams so far, and the exponent of the scan's likelihood in them. The exponent is at
    /// most `power`; it is smaller if otherwise less than the fraction `min_effective` of the particles would be effective.
    pub(super) fn posterior(&self, particles: &Particles, power: f64, min_effective: f64) -> (Vec<f32>, f64) {
        posterior(&particles.log_weight, &self.log_likelihoods, power, min_effective)
    }

    /// Likelihood per beam of the beams so far; `None` before the first one. `squash` is the root order of the beam model.
    pub(super) fn fit(&self, particles: &Particles, squash: f64) -> Option<f64> {
        (self.processed > 0).then(|| fit(&particles.log_weight, &self.log_likelihoods, squash, self.processed))
    }

    /// The whole scan.
    pub(super) fn observation(&self) -> &Observation {
        &self.observation
    }
}

/// See [`Evidence::posterior`].
pub(super) fn posterior(before: &[f32], log_likelihoods: &[f32], power: f64, min_effective: f64) -> (Vec<f32>, f64) {
    // A sample of the particles suffices to estimate the effective fraction.
    let stride = before.len().div_ceil(MAX_SAMPLE).max(1);
    let of_power = |power: f32, stride: usize| -> Vec<f32> {
        let pairs = before.iter().zip(log_likelihoods).step_by(stride);
        pairs.map(|(before, likelihood)| before + power * likelihood).collect()
    };
    let is_enough = |power: f32| {
        let log_weights = of_power(power, stride);
        effective_number(&relative(&log_weights)) >= min_effective * log_weights.len() as f64
    };
    if is_enough(power as f32) {
        return (of_power(power as f32, 1), power);
    }
    let (mut low, mut high) = (0.0, power as f32);
    for _ in 0..BISECTIONS {
        let power = 0.5 * (low + high);
        *(if is_enough(power) { &mut low } else { &mut high }) = power;
    }
    (of_power(low, 1), low.into())
}

/// Likelihood per beam of this many beams.
pub(super) fn fit(before: &[f32], log_likelihoods: &[f32], squash: f64, beams: usize) -> f64 {
    let log_sum = |log_weights: &dyn Fn(usize) -> f64| {
        let largest = (0..before.len()).map(log_weights).fold(f64::NEG_INFINITY, f64::max);
        largest + (0..before.len()).map(|index| (log_weights(index) - largest).exp()).sum::<f64>().ln()
    };
    let log_mean =
        log_sum(&|index| f64::from(before[index] + log_likelihoods[index])) - log_sum(&|index| f64::from(before[index]));
    (log_mean * squash / beams.max(1) as f64).exp()
}
