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
        let rows = model.rows(&self.observation.ranges[beams.clone()]);
        let tasks = self.views.chunks(CHUNK).zip(self.log_likelihoods.chunks_mut(CHUNK));
        workers.share(tasks, |_, (views, log_likelihoods)| {
            let mut lengths = vec![0.0; fan.len() * views.len()];
            caster.cast(views, &fan, &mut lengths);
            for (row, lengths) in rows.iter().zip(lengths.chunks_exact(views.len())) {
                model.add_log_likelihoods(row, lengths, log_likelihoods);
            }
        });
        self.weighed = beams.end;
    }

    /// The logarithms of the weights after what is known so far, and the power to which the likelihood of the scan has been taken for
    /// that: at most `power`, and less where more would leave less than `least` particles effective.
    pub(super) fn posterior(&self, particles: &Particles, power: f64, least: f64) -> (Vec<f32>, f64) {
        let of_power = |power: f32| -> Vec<f32> {
            let pairs = particles.log_weight.iter().zip(&self.log_likelihoods);
            pairs.map(|(before, likelihood)| before + power * likelihood).collect()
        };
        let is_enough = |log_weights: &[f32]| effective_number(&relative(log_weights)) >= least;
        let full = of_power(power as f32);
        if is_enough(&full) {
            return (full, power);
        }
        let (mut low, mut high) = (0.0, power as f32);
        for _ in 0..HALVINGS {
            let power = 0.5 * (low + high);
            *(if is_enough(&of_power(power)) { &mut low } else { &mut high }) = power;
        }
        (of_power(low), low.into())
    }

    /// Likelihood of the scan, as far as it is taken in, per beam; `None` before the first one. `squash` is that of the model.
    pub(super) fn fit(&self, particles: &Particles, squash: f64) -> Option<f64> {
        let log_sum = |log_weights: &mut dyn Iterator<Item = f64>| {
            let log_weights: Vec<f64> = log_weights.collect();
            let largest = log_weights.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            largest + log_weights.iter().map(|weight| (weight - largest).exp()).sum::<f64>().ln()
        };
        let before = &particles.log_weight;
        let log_mean = log_sum(&mut before.iter().zip(&self.log_likelihoods).map(|(before, more)| f64::from(before + more)))
            - log_sum(&mut before.iter().map(|&before| f64::from(before)));
        (self.weighed > 0).then(|| (log_mean * squash / self.weighed as f64).exp())
    }
}
