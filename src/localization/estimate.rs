//! What the particles lead to believe: one pose out of many, the mean of the heaviest cluster.

use std::collections::HashMap;

use super::agreement::LEAST;
use super::model::Model;
use super::particles::{Particles, effective_number};
use crate::anytime::mode::Conditions;
use crate::geometry::{Pose2, PoseCovariance, wrap_angle};

/// Standard deviation of the position within which the robot knows where it is, m,
const LOCALIZED: f64 = 0.3;
/// if the cluster has this part of the weight.
const LOCALIZED_SHARE: f64 = 0.9;
/// A cloud wider than this (standard deviation, m) may be several.
const COMPACT: f64 = 0.5;
/// Side of the bins in which the heaviest cluster is looked for: m, rad.
const BIN: (f32, f32) = (0.5, 0.35);
/// Particles this near belong to it: m, rad.
const CLUSTER: (f32, f32) = (1.0, 0.6);

/// What the filter believes.
#[derive(Clone, Debug, PartialEq)]
pub struct Belief {
    /// Where the robot is.
    pub map_from_base: Pose2,
    /// How sure that is, in the map frame.
    pub covariance: PoseCovariance,
    /// Part of the weight that agrees with it.
    pub share: f64,
    /// Number of particles.
    pub particles: usize,
    /// How many particles of equal weight would say as much.
    pub effective: f64,
    /// Beams of the last scan that have been taken in.
    pub beams: usize,
    /// Likelihood of these, per beam.
    pub fit: f64,
    /// Part of the beams that the map explains at this pose.
    pub explained: f64,
    /// Whether the robot is still looked for: it may be elsewhere.
    pub is_sought: bool,
}

impl Belief {
    /// The least mean of [`Self::explained`] with which a map can be the right one.
    pub const LEAST_EXPLAINED: f64 = LEAST;

    /// What the last scan was like.
    pub fn conditions(&self) -> Conditions {
        let agreement = if self.beams > 0 { self.explained } else { f64::NAN };
        Conditions { agreement, rays: f64::NAN, condition_number: f64::NAN }
    }

    /// Whether the robot knows where it is.
    pub fn is_localized(&self) -> bool {
        !self.is_sought && self.share > LOCALIZED_SHARE && self.is_compact()
    }

    /// Whether the pose is one place.
    pub(super) fn is_compact(&self) -> bool {
        (self.covariance.m11 + self.covariance.m22).sqrt() < LOCALIZED
    }
}

/// The estimate in the grid: cells and rad.
struct Mean {
    pose: Pose2,
    /// Of x, y and heading: m^2, m rad, rad^2, along the grid.
    covariance: PoseCovariance,
    /// Part of the weight it stands for.
    share: f64,
}

/// What weighted particles lead to believe; of the scan nothing is said yet.
pub(super) fn belief(model: &Model, particles: &Particles, weights: &[f32]) -> Belief {
    let mean = mean(particles, weights, model.grid.resolution());
    let (sin, cos) = model.grid.pose_in_map(&Pose2::IDENTITY).theta.sin_cos();
    let turn = nalgebra::Matrix3::new(cos, -sin, 0.0, sin, cos, 0.0, 0.0, 0.0, 1.0);
    Belief {
        map_from_base: model.grid.pose_in_map(&mean.pose),
        covariance: turn * mean.covariance * turn.transpose(),
        share: mean.share,
        particles: particles.len(),
        effective: effective_number(weights),
        beams: 0,
        fit: 0.0,
        explained: 0.0,
        is_sought: false,
    }
}

/// The mean of all particles while they are together, else of the heaviest cluster.
fn mean(particles: &Particles, weights: &[f32], resolution: f64) -> Mean {
    let all = mean_of(particles, weights, resolution, |_| true);
    if all.covariance.m11 + all.covariance.m22 < COMPACT * COMPACT {
        return all;
    }
    let per_cell = resolution as f32;
    let mut bins: HashMap<(i32, i32, i32), f64> = HashMap::new();
    let bin_of = |[x, y, theta]: [f32; 3]| {
        let bin = |value: f32, size: f32| (value / size).floor() as i32;
        (bin(x * per_cell, BIN.0), bin(y * per_cell, BIN.0), bin(theta, BIN.1))
    };
    for (index, &weight) in weights.iter().enumerate() {
        *bins.entry(bin_of(particles.pose(index))).or_default() += f64::from(weight);
    }
    // Of equals the first in order, not in the map's order.
    let heaviest = bins.iter().max_by(|a, b| a.1.total_cmp(b.1).then_with(|| b.0.cmp(a.0))).map(|(bin, _)| *bin);
    let seed = mean_of(particles, weights, resolution, |pose| Some(bin_of(pose)) == heaviest).pose;
    mean_of(particles, weights, resolution, |[x, y, theta]| {
        let near = (x - seed.x as f32).hypot(y - seed.y as f32) * per_cell < CLUSTER.0;
        near && wrap_angle(f64::from(theta) - seed.theta).abs() < CLUSTER.1.into()
    })
}

fn mean_of(particles: &Particles, weights: &[f32], resolution: f64, belongs: impl Fn([f32; 3]) -> bool) -> Mean {
    let total: f64 = weights.iter().map(|&weight| f64::from(weight)).sum();
    let members = || {
        let all = weights.iter().enumerate().map(|(index, &weight)| (f64::from(weight), particles.pose(index)));
        all.filter(|(weight, pose)| *weight > 1e-6 && belongs(*pose))
    };
    let (mut mass, mut sums) = (0.0, [0.0; 4]);
    for (weight, [x, y, theta]) in members() {
        let (sin, cos) = f64::from(theta).sin_cos();
        mass += weight;
        for (sum, value) in sums.iter_mut().zip([f64::from(x), f64::from(y), cos, sin]) {
            *sum += weight * value;
        }
    }
    let pose = Pose2::new(sums[0] / mass, sums[1] / mass, sums[3].atan2(sums[2]));
    let mut covariance = PoseCovariance::zeros();
    for (weight, [x, y, theta]) in members() {
        let (dx, dy) = ((f64::from(x) - pose.x) * resolution, (f64::from(y) - pose.y) * resolution);
        let off = nalgebra::Vector3::new(dx, dy, wrap_angle(f64::from(theta) - pose.theta));
        covariance += (weight / mass) * off * off.transpose();
    }
    Mean { pose, covariance, share: mass / total }
}
