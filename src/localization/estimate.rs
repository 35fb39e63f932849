//! The pose estimate of the particles: the mean of the heaviest cluster.

use std::collections::HashMap;

use super::agreement;
use super::model::Model;
use super::particles::{Particles, bin_of, effective_number, is_near};
use crate::anytime::mode::Conditions;
use crate::geometry::{Pose2, PoseCovariance, wrap_angle};

/// Maximum standard deviation of the position of a localized robot, m.
const MAX_LOCALIZED_SIGMA: f64 = 0.3;
/// Minimum fraction of the total weight in the cluster of a localized robot.
const MIN_LOCALIZED_SHARE: f64 = 0.9;
/// Maximum standard deviation of a cloud that is taken as one cluster, m. A wider one may consist of several.
const MAX_COMPACT_SIGMA: f64 = 0.5;
/// Size of the bins for finding the heaviest cluster: m, rad.
const BIN_SIZE: (f32, f32) = (0.5, 0.35);

/// The belief of the filter, summarized as one pose.
#[derive(Clone, Debug, PartialEq)]
pub struct Belief {
    /// Estimated pose of the robot.
    pub map_from_base: Pose2,
    /// Its covariance, in the map frame.
    pub covariance: PoseCovariance,
    /// Fraction of the total weight in the cluster of this pose.
    pub share: f64,
    /// Number of particles.
    pub particles: usize,
    /// Effective number of particles.
    pub effective: f64,
    /// Beams of the last scan that were used.
    pub beams: usize,
    /// Likelihood per beam.
    pub fit: f64,
    /// Fraction of the beams that the map explains at this pose.
    pub explained: f64,
    /// Whether the pose is unconfirmed: it explains the scans badly, or only the global search has found it yet.
    pub is_unconfirmed: bool,
}

impl Belief {
    /// Minimum mean of [`Self::explained`] on the right map.
    pub const MIN_EXPLAINED: f64 = agreement::MIN_EXPLAINED;

    /// The matching conditions of the last scan.
    pub fn conditions(&self) -> Conditions {
        let agreement = if self.beams > 0 { self.explained } else { f64::NAN };
        Conditions { agreement, rays: f64::NAN, condition_number: f64::NAN }
    }

    /// Whether the robot is localized: one compact cluster has nearly all weight.
    pub fn is_localized(&self) -> bool {
        !self.is_unconfirmed && self.share > MIN_LOCALIZED_SHARE && self.is_compact()
    }

    /// Whether the position is certain enough for a localized robot.
    pub(super) fn is_compact(&self) -> bool {
        (self.covariance.m11 + self.covariance.m22).sqrt() < MAX_LOCALIZED_SIGMA
    }
}

/// The estimate in grid coordinates: cells and rad.
struct Mean {
    pose: Pose2,
    /// Covariance of x, y and heading along the grid: m^2, m rad, rad^2.
    covariance: PoseCovariance,
    /// Fraction of the total weight in the cluster.
    share: f64,
}

/// Computes the belief from weighted particles; the fields about the scan are left empty.
pub(super) fn belief(model: &Model, particles: &Particles, weights: &[f32]) -> Belief {
    let mean = mean(particles, weights, model.grid.resolution());
    let (sin, cos) = model.grid.origin().theta.sin_cos();
    let rotation = nalgebra::Matrix3::new(cos, -sin, 0.0, sin, cos, 0.0, 0.0, 0.0, 1.0);
    Belief {
        map_from_base: model.grid.pose_in_map(&mean.pose),
        covariance: rotation * mean.covariance * rotation.transpose(),
        share: mean.share,
        particles: particles.len(),
        effective: effective_number(weights),
        beams: 0,
        fit: 0.0,
        explained: 0.0,
        is_unconfirmed: false,
    }
}

/// The mean of all particles if they form one compact cloud, else of the heaviest cluster.
fn mean(particles: &Particles, weights: &[f32], resolution: f64) -> Mean {
    let all = mean_of(particles, weights, resolution, |_| true);
    if all.covariance.m11 + all.covariance.m22 < MAX_COMPACT_SIGMA * MAX_COMPACT_SIGMA {
        return all;
    }
    let bin = |pose: [f32; 3]| bin_of(pose, resolution as f32, BIN_SIZE);
    let mut bins: HashMap<_, f64> = HashMap::new();
    for (index, &weight) in weights.iter().enumerate() {
        *bins.entry(bin(particles.pose(index))).or_default() += f64::from(weight);
    }
    // Equally heavy bins are ordered by index, so that the result does not depend on the order of the hash map.
    let heaviest = bins.iter().max_by(|a, b| a.1.total_cmp(b.1).then_with(|| b.0.cmp(a.0))).map(|(bin, _)| *bin);
    let seed = mean_of(particles, weights, resolution, |pose| Some(bin(pose)) == heaviest).pose;
    mean_of(particles, weights, resolution, |pose| is_near(pose, &seed, resolution as f32))
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
