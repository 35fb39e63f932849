//! Closed-form minimum of the point-to-line error with a Lagrange multiplier (Censi 2008, section III).
//!
//! Minimise `x' M x + g' x` over `x = (t, u)` with `|u| = 1`. With `2M = [A B; B' D]`, the translation is `t = -A^-1 (g1 + B u)`.
//! Eliminating it leaves, with `S = D - B' A^-1 B`, `h = g2 - B' A^-1 g1` and the multiplier s:
//!
//! `(S + s I) u = -h`, and `|u| = 1` is a quartic in s.
//!
//! The global minimum belongs to the *largest* real root, the one that makes `S + s I` positive semidefinite. In the eigenbasis
//! of S the quartic is `sum h_i^2 / (mu_i + s)^2 = 1`. This form is solved here: in nearly degenerate problems, the expanded
//! polynomial loses its digits.

use nalgebra::Matrix2;

use super::QuadraticForm;
use crate::geometry::{Point, Pose2};
use crate::matching::symmetric_eigen::SymmetricEigen;

/// If the ratio of the eigenvalues is below this, the direction counts as unconstrained: the smaller one is rounding error only.
const RANK_TOLERANCE: f64 = 1e-13;

/// Maximum number of Newton steps; thousands of random problems needed at most 10.
const MAX_NEWTON_STEPS: usize = 30;

pub(super) fn solve(form: &QuadraticForm, prior: &Pose2) -> Option<Pose2> {
    let ([a, b, d], [g1, g2]) = form.blocks();
    let (a_inverse, null_space) = pseudo_inverse(&a)?;
    let s = d - b.transpose() * a_inverse * b;
    let h = g2 - b.transpose() * a_inverse * g1;
    let (sin, cos) = prior.theta.sin_cos();
    let u = unit_minimizer(&s, h, Point::new(cos, sin))?;
    let t = -(a_inverse * (g1 + b * u)) + null_space * prior.translation();
    Some(Pose2::new(t.x, t.y, u.y.atan2(u.x)))
}

/// Pseudo-inverse of a symmetric positive semidefinite matrix, and the projection onto its null space.
fn pseudo_inverse(matrix: &Matrix2<f64>) -> Option<(Matrix2<f64>, Matrix2<f64>)> {
    let eigen = SymmetricEigen::of(matrix);
    let largest = eigen.values.y;
    if !(largest.is_finite() && largest > 0.0) {
        return None;
    }
    let major = eigen.major * eigen.major.transpose() / largest;
    let minor = eigen.minor * eigen.minor.transpose();
    let is_regular = eigen.values.x > RANK_TOLERANCE * largest;
    Some(if is_regular { (major + minor / eigen.values.x, Matrix2::zeros()) } else { (major, minor) })
}

/// The unit vector u that minimises `u' S u / 2 + h' u`. If there are several minima, the one nearest to `prior`.
fn unit_minimizer(s: &Matrix2<f64>, h: Point, prior: Point) -> Option<Point> {
    let eigen = SymmetricEigen::of(s);
    let (mu, h_minor, h_major) = (eigen.values, h.dot(&eigen.minor), h.dot(&eigen.major));
    let scale = mu.x.abs().max(mu.y.abs()).max(h.norm());
    if !scale.is_finite() {
        return None;
    }
    let from_eigenbasis = |minor: f64, major: f64| eigen.minor * minor + eigen.major * major;
    if h.norm() <= RANK_TOLERANCE * scale && mu.y - mu.x <= RANK_TOLERANCE * scale {
        return Some(prior);
    }
    if h_minor.abs() <= RANK_TOLERANCE * scale {
        let major = -h_major / (mu.y - mu.x);
        if major.abs() < 1.0 {
            // The multiplier is at the pole -mu_min: there are two equal minima.
            let minor = (1.0 - major * major).sqrt();
            let (one, other) = (from_eigenbasis(minor, major), from_eigenbasis(-minor, major));
            return Some(if one.dot(&prior) >= other.dot(&prior) { one } else { other });
        }
    }
    let multiplier = largest_root(mu, Point::new(h_minor, h_major));
    let u = from_eigenbasis(-ratio(h_minor, mu.x + multiplier), -ratio(h_major, mu.y + multiplier));
    u.try_normalize(0.0)
}

/// The largest s with `sum h_i^2 / (mu_i + s)^2 = 1`, where `mu.x <= mu.y`, by Newton steps on `(sum)^(-1/2) - 1`, which is
/// nearly linear in s.
fn largest_root(mu: Point, h: Point) -> f64 {
    let low = (h.x.abs() - mu.x).max(h.y.abs() - mu.y);
    let high = h.norm() - mu.x;
    let mut s = low;
    for _ in 0..MAX_NEWTON_STEPS {
        let (r1, r2) = (ratio(h.x, mu.x + s), ratio(h.y, mu.y + s));
        let sum = r1 * r1 + r2 * r2;
        let slope = ratio(r1 * r1, mu.x + s) + ratio(r2 * r2, mu.y + s);
        let step = sum * (sum.sqrt() - 1.0) / slope;
        let next = (s + step).clamp(low, high);
        if (next - s).abs() <= f64::EPSILON * (s.abs() + mu.y.abs()) {
            return next;
        }
        s = next;
    }
    s
}

/// A component with zero gradient contributes nothing, even at its pole.
fn ratio(numerator: f64, denominator: f64) -> f64 {
    if numerator == 0.0 { 0.0 } else { numerator / denominator }
}
