//! Covariance of a match from the noise of both scans' ranges (Censi 2007: the implicit function theorem on the minimum).

use nalgebra::{Matrix3, Vector3};

use super::reference::Reference;
use super::rejection::Pair;
use super::solver::Metric;
use crate::geometry::{Point, Pose2, PoseCovariance, perpendicular};

/// Derivatives of the gradient by the ranges of the reference rays; kept between calls for its memory.
#[derive(Debug, Default)]
pub(super) struct CovarianceEstimator {
    by_reference_range: Vec<Vector3<f64>>,
}

/// What the covariance is computed from.
pub(super) struct Solution<'a> {
    pub(super) reference: &'a Reference,
    /// Points of the sensed scan, in its own frame.
    pub(super) sensed: &'a [Point],
    pub(super) pairs: &'a [Pair],
    pub(super) pose: Pose2,
    pub(super) metric: Metric,
    /// Standard deviation of every range, m.
    pub(super) range_noise: f64,
}

/// The outer gradient term of a symmetric dyad: `(dn n' + n dn') e`.
fn dyad_change(dn: Point, n: Point, e: Point) -> Point {
    dn * n.dot(&e) + n * dn.dot(&e)
}

impl CovarianceEstimator {
    /// Covariance of the solution's pose and the Hessian of its error; `None` where the Hessian is singular: a direction that the
    /// pairs leave open.
    pub(super) fn estimate(&mut self, solution: &Solution) -> Option<PoseCovariance> {
        let reference = solution.reference;
        let transform = solution.pose.transform();
        self.by_reference_range.clear();
        self.by_reference_range.resize(reference.len(), Vector3::zeros());
        let mut hessian = Matrix3::zeros();
        let mut spread = Matrix3::zeros();
        for pair in solution.pairs {
            let p = solution.sensed[pair.sensed as usize];
            let rotated = transform.rotate(p);
            let (first, second) = reference.segment_rays(pair.segment as usize);
            let (j, k) = if pair.ray as usize == first { (first, second) } else { (second, first) };
            let terms = PairTerms {
                // Whatever point of the segment's line: the nearest ray's.
                error: transform.apply(p) - reference.points()[j],
                rotated,
                normal: reference.segment(pair.segment as usize).normal,
                metric: solution.metric,
            };
            hessian += terms.hessian();
            let by_sensed_range = terms.by_sensed_range(rotated / p.norm());
            spread += by_sensed_range * by_sensed_range.transpose();
            let d = reference.points()[j] - reference.points()[k];
            let (vj, vk) = (reference.rays()[j].direction, reference.rays()[k].direction);
            self.by_reference_range[j] += terms.by_normal(d.perp(&vj) / d.norm_squared()) - terms.by_anchor(vj);
            self.by_reference_range[k] += terms.by_normal(-d.perp(&vk) / d.norm_squared());
        }
        for by_range in &self.by_reference_range {
            spread += by_range * by_range.transpose();
        }
        let inverse = hessian.try_inverse()?;
        let covariance = inverse * spread * inverse * (solution.range_noise * solution.range_noise);
        covariance.iter().all(|v| v.is_finite()).then_some(covariance)
    }
}

/// Derivatives of one pair's squared error `e' C e`, `e = R p + t - q`.
struct PairTerms {
    error: Point,
    rotated: Point,
    normal: Point,
    metric: Metric,
}

impl PairTerms {
    /// `C v`.
    fn weigh(&self, v: Point) -> Point {
        match self.metric {
            Metric::PointToLine => self.normal * self.normal.dot(&v),
            Metric::PointToPoint => v,
        }
    }

    /// Change of the error with the heading.
    fn by_heading(&self) -> Point {
        perpendicular(self.rotated)
    }

    fn hessian(&self) -> Matrix3<f64> {
        let turned = self.weigh(self.by_heading());
        let (cx, cy) = (self.weigh(Point::x()), self.weigh(Point::y()));
        let heading = self.by_heading().dot(&turned) - self.error.dot(&self.weigh(self.rotated));
        2.0 * Matrix3::new(cx.x, cy.x, turned.x, cx.y, cy.y, turned.y, turned.x, turned.y, heading)
    }

    /// Change of the gradient with the range of the sensed ray, which points along `v` (in the reference frame).
    fn by_sensed_range(&self, v: Point) -> Vector3<f64> {
        let weighed = self.weigh(v);
        let heading = self.error.dot(&self.weigh(perpendicular(v))) + weighed.dot(&self.by_heading());
        2.0 * Vector3::new(weighed.x, weighed.y, heading)
    }

    /// Change of the gradient as the segment's anchor point moves along `v`, to be subtracted.
    fn by_anchor(&self, v: Point) -> Vector3<f64> {
        let weighed = self.weigh(v);
        2.0 * Vector3::new(weighed.x, weighed.y, weighed.dot(&self.by_heading()))
    }

    /// Change of the gradient as the segment turns by `turn` rad per metre of range.
    fn by_normal(&self, turn: f64) -> Vector3<f64> {
        if self.metric == Metric::PointToPoint {
            return Vector3::zeros();
        }
        let dn = perpendicular(self.normal) * turn;
        let changed = dyad_change(dn, self.normal, self.error);
        2.0 * Vector3::new(changed.x, changed.y, changed.dot(&self.by_heading()))
    }
}
