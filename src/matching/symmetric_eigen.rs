//! Symmetric 2x2 matrices by their axes, as exact as their entries are.

use nalgebra::Matrix2;

use crate::geometry::{Point, perpendicular};

/// Eigenvalues (smaller first) and unit eigenvectors of a symmetric 2x2 matrix.
pub(super) struct SymmetricEigen {
    pub(super) values: Point,
    pub(super) minor: Point,
    pub(super) major: Point,
}

impl SymmetricEigen {
    pub(super) fn of(matrix: &Matrix2<f64>) -> Self {
        let half_difference = 0.5 * (matrix.m11 - matrix.m22);
        let mean = 0.5 * (matrix.m11 + matrix.m22);
        let radius = half_difference.hypot(matrix.m12);
        let major = half_angle(half_difference, matrix.m12, radius);
        let larger = mean + radius;
        // The smaller one from the determinant: mean - radius would be rounding for near-singular matrices.
        let smaller = if larger == 0.0 { 0.0 } else { matrix.determinant() / larger };
        let smaller = if mean >= 0.0 { smaller } else { mean - radius };
        Self { values: Point::new(smaller, larger), minor: perpendicular(major), major }
    }
}

/// The unit vector in the direction of half the angle of (x, y), of length `length`: by the larger of its cosine and its sine.
fn half_angle(x: f64, y: f64, length: f64) -> Point {
    let larger = (0.5 * (1.0 + x.abs() / length)).sqrt();
    let smaller = 0.5 * y.abs() / (length * larger);
    if length == 0.0 {
        Point::x()
    } else if x >= 0.0 {
        Point::new(larger, smaller.copysign(y))
    } else {
        Point::new(smaller, larger.copysign(y))
    }
}
