//! The particles as a structure of arrays: each step reads only the arrays that it needs.

use crate::geometry::{Pose2, wrap_angle};

/// Maximum distance of two poses of the same hypothesis, m and rad.
pub(super) const SAME_HYPOTHESIS: (f64, f64) = (1.0, 0.6);

/// Poses of the base in grid coordinates, with their weights.
#[derive(Clone, Debug, Default)]
pub(super) struct Particles {
    /// Columns, with fractions.
    pub(super) x: Vec<f32>,
    /// Rows, with fractions.
    pub(super) y: Vec<f32>,
    /// Headings, rad.
    pub(super) theta: Vec<f32>,
    /// Relative errors of odometry's distances: true distances are longer by this fraction.
    pub(super) scale: Vec<f32>,
    /// Logarithms of the weights, up to a constant.
    pub(super) log_weight: Vec<f32>,
}

impl Particles {
    pub(super) fn len(&self) -> usize {
        self.x.len()
    }

    pub(super) fn push(&mut self, [x, y, theta]: [f32; 3], scale: f32, log_weight: f32) {
        self.x.push(x);
        self.y.push(y);
        self.theta.push(theta);
        self.scale.push(scale);
        self.log_weight.push(log_weight);
    }

    pub(super) fn clear(&mut self) {
        self.x.clear();
        self.y.clear();
        self.theta.clear();
        self.scale.clear();
        self.log_weight.clear();
    }

    pub(super) fn is_empty(&self) -> bool {
        self.x.is_empty()
    }

    pub(super) fn pose(&self, index: usize) -> [f32; 3] {
        [self.x[index], self.y[index], self.theta[index]]
    }
}

/// The bin that contains a pose of the grid, for bins of this size: m, rad. `resolution`: size of a cell, m.
pub(super) fn bin_of([x, y, theta]: [f32; 3], resolution: f32, size: (f32, f32)) -> (i32, i32, i32) {
    let bin = |value: f32, size: f32| (value / size).floor() as i32;
    (bin(x * resolution, size.0), bin(y * resolution, size.0), bin(theta, size.1))
}

/// Whether a pose of the grid belongs to the hypothesis at `centre`, in cells. `resolution`: size of a cell, m.
pub(super) fn is_near([x, y, theta]: [f32; 3], centre: &Pose2, resolution: f32) -> bool {
    let distance = (x - centre.x as f32).hypot(y - centre.y as f32) * resolution;
    f64::from(distance) < SAME_HYPOTHESIS.0 && wrap_angle(f64::from(theta) - centre.theta).abs() < SAME_HYPOTHESIS.1
}

/// Converts log-weights to weights, scaled so that the largest is 1.
pub(super) fn relative(log_weights: &[f32]) -> Vec<f32> {
    let largest = log_weights.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    log_weights.iter().map(|log_weight| (log_weight - largest).exp()).collect()
}

/// Effective number of particles (Kish).
pub(super) fn effective_number(weights: &[f32]) -> f64 {
    let (sum, squares) =
        weights.iter().map(|&weight| f64::from(weight)).fold((0.0, 0.0), |(sum, squares), w| (sum + w, squares + w * w));
    if squares > 0.0 { sum * sum / squares } else { 0.0 }
}
