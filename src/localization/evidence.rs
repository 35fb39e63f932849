//! What a scan says of every particle, taken in some beams at a time.

use std::ops::Range;

use super::observation::Observation;
use super::particles::{Particles, effective_number, relative};
use super::sensor::BeamTable;
use super::streams::CHUNK;
use crate::parallel::Workers;
use crate::raycasting::{RayCaster, Viewpoint};

/// Beams of all particles together that are cast before the clock is looked at: a fraction of a millisecond's work,
const RAYS_PER_STEP: usize = 8192;
/// and no more than this part of a scan.
const STEPS: usize = 8;
/// Particles by which the effective part of a cloud is told.
const SAMPLE: usize = 16_384;
/// Halvings in the search for the exponent by which a scan is believed less.
const HALVINGS: usize = 12;

/// The scan that is being taken in.
#[derive(Default)]
pub(super) struct Evidence {
    observation: Observation,
    /// Where the laser is for each particle.
    views: Vec<Viewpoint>,
    /// Beams taken in so far.
    weighed: usize,
    /// What they say of each particle.
    log_likelihoods: Vec<f32>,
}

impl Evidence {
    /// Another scan, seen from these places.
    pub(super) fn begin(&mut self, observation: Observation, views: impl Iterator<Item = Viewpoint>) {
        self.observation = observation;
        self.views.clear();
        self.views.extend(views);
        self.weighed = 0;
        self.log_likelihoods.clear();
        self.log_likelihoods.resize(self.views.len(), 0.0);
    }

    /// Beams taken in.
    pub(super) fn weighed(&self) -> usize {
        self.weighed
    }

    /// The beams that come next; none when all are taken in.
    pub(super) fn next_beams(&self) -> Range<usize> {
        let most = self.observation.len().div_ceil(STEPS);
        let count = (RAYS_PER_STEP / self.views.len().max(1)).min(most).max(1);
        self.weighed..(self.weighed + count).min(self.observation.len())
    }

    /// Takes in the next beams.
    pub(super) fn weigh_next(&mut self, model: &BeamTable, caster: &dyn RayCaster, workers: &Workers) {
        let beams = self.next_beams();
        let fan = self.observation.fan.part(beams.clone());
        let reach = self.observation.reach;
        let rows = model.rows(&self.observation.ranges[beams.clone()]);
        let tasks = self.views.chunks(CHUNK).zip(self.log_likelihoods.chunks_mut(CHUNK));
        workers.share(tasks, |_, (views, log_likelihoods)| {
            let mut lengths = vec![0.0; fan.len() * views.len()];
            caster.cast(views, &fan, &mut lengths);
            for (row, lengths) in rows.iter().zip(lengths.chunks_exact(views.len())) {
                model.add_log_likelihoods(row, reach, lengths, log_likelihoods);
            }
        });
        self.weighed = beams.end;
    }

    /// The logarithms of the weights after what is known so far, and the power to which the likelihood of the scan has been taken for
    /// that: at most `power`, and less where more would leave less than the part `least` of the particles effective.
    pub(super) fn posterior(&self, particles: &Particles, power: f64, least: f64) -> (Vec<f32>, f64) {
        posterior(&particles.log_weight, &self.log_likelihoods, power, least)
    }

    /// Likelihood of the scan, as far as it is taken in, per beam; `None` before the first one. `squash` is that of the model.
    pub(super) fn fit(&self, particles: &Particles, squash: f64) -> Option<f64> {
        (self.weighed > 0).then(|| fit(&particles.log_weight, &self.log_likelihoods, squash, self.weighed))
    }

    /// The scan, all of it.
    pub(super) fn observation(&self) -> &Observation {
        &self.observation
    }
}

/// See [`Evidence::posterior`].
pub(super) fn posterior(before: &[f32], log_likelihoods: &[f32], power: f64, least: f64) -> (Vec<f32>, f64) {
    // So many are as good as all of them to tell a part.
    let stride = before.len().div_ceil(SAMPLE).max(1);
    let of_power = |power: f32, stride: usize| -> Vec<f32> {
        let pairs = before.iter().zip(log_likelihoods).step_by(stride);
        pairs.map(|(before, likelihood)| before + power * likelihood).collect()
    };
    let is_enough = |power: f32| {
        let log_weights = of_power(power, stride);
        effective_number(&relative(&log_weights)) >= least * log_weights.len() as f64
    };
    if is_enough(power as f32) {
        return (of_power(power as f32, 1), power);
    }
    let (mut low, mut high) = (0.0, power as f32);
    for _ in 0..HALVINGS {
        let power = 0.5 * (low + high);
        *(if is_enough(power) { &mut low } else { &mut high }) = power;
    }
    (of_power(low, 1), low.into())
}

/// Likelihood of so many beams, per beam.
pub(super) fn fit(before: &[f32], log_likelihoods: &[f32], squash: f64, beams: usize) -> f64 {
    let log_sum = |log_weights: &dyn Fn(usize) -> f64| {
        let largest = (0..before.len()).map(log_weights).fold(f64::NEG_INFINITY, f64::max);
        largest + (0..before.len()).map(|index| (log_weights(index) - largest).exp()).sum::<f64>().ln()
    };
    let log_mean =
        log_sum(&|index| f64::from(before[index] + log_likelihoods[index])) - log_sum(&|index| f64::from(before[index]));
    (log_mean * squash / beams.max(1) as f64).exp()
}
