//! Eigendecomposition of symmetric 2x2 matrices, accurate even for nearly singular ones.

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
        // The smaller eigenvalue comes from the determinant: for nearly singular matrices, mean - radius would be rounding error
        // only.
        let smaller = if larger == 0.0 { 0.0 } else { matrix.determinant() / larger };
        let smaller = if mean >= 0.0 { smaller } else { mean - radius };
        Self { values: Point::new(smaller, larger), minor: perpendicular(major), major }
    }
}

/// The unit vector at half the angle of the vector (x, y) of length `length`. The larger of its cosine and sine is computed
/// first, which avoids cancellation.
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
