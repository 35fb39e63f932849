//! Covariance of a match from the range noise of both scans (Censi 2007: the implicit function theorem at the minimum).

use nalgebra::{Matrix3, Vector3};

use super::ClosestPoint;
use crate::geometry::{Point, Pose2, PoseCovariance, perpendicular};
use crate::matching::solver::Metric;
use crate::matching::uncertainty::{Uncertainty, condition_number};

impl ClosestPoint {
    /// Uncertainty of `pose`, the solution for the current correspondences. `range_noise`: standard deviation of every range, m.
    pub(super) fn uncertainty_of(&mut self, pose: &Pose2, range_noise: f64) -> Uncertainty {
        let reference = &self.reference;
        let transform = pose.transform();
        self.by_reference_range.clear();
        self.by_reference_range.resize(reference.len(), Vector3::zeros());
        let mut sums = Sums::default();
        for pair in &self.pairs {
            let p = self.sensed[pair.sensed as usize];
            let (first, second) = reference.segment_rays(pair.segment as usize);
            let (j, k) = if pair.ray as usize == first { (first, second) } else { (second, first) };
            let (points, rays) = (reference.points(), reference.rays());
            let (rotated, range) = (transform.rotate(p), p.norm());
            sums.distance += range;
            let mut by_sensed_range = Vector3::zeros();
            let mut add = |normal: Point, is_segment: bool| {
                // Any point on the line of the segment serves as q: take that of the nearest ray.
                let term = Term::new(normal, transform.apply(p) - points[j], rotated);
                sums.add(&term);
                by_sensed_range += term.gradient_by_sensed_range(&(rotated / range));
                self.by_reference_range[j] -= term.gradient_by_offset(&rays[j].direction);
                if is_segment {
                    let d = points[j] - points[k];
                    let rotation = |v: &Point| d.perp(v) / d.norm_squared();
                    self.by_reference_range[j] += term.gradient_by_rotation(rotation(&rays[j].direction));
                    self.by_reference_range[k] -= term.gradient_by_rotation(rotation(&rays[k].direction));
                }
            };
            match self.metric {
                Metric::PointToLine => add(reference.segment(pair.segment as usize).normal, true),
                Metric::PointToPoint => [Point::x(), Point::y()].into_iter().for_each(|axis| add(axis, false)),
            }
            add_outer(&mut sums.spread, &by_sensed_range);
        }
        for by_range in &self.by_reference_range {
            add_outer(&mut sums.spread, by_range);
        }
        let covariance = sums.covariance(range_noise);
        Uncertainty {
            covariance,
            information: covariance.and_then(Matrix3::try_inverse),
            condition_number: condition_number(&symmetric(&sums.information), sums.distance / self.pairs.len().max(1) as f64),
            free_direction: None,
        }
    }
}

/// One term `e^2` of the minimised sum, with `e = n . (R p + t - q)`, half its gradient `e a`, and its derivatives.
struct Term {
    normal: Point,
    /// `R p + t - q`.
    offset: Point,
    /// `R p`.
    rotated: Point,
    /// `e`.
    error: f64,
    /// `a = (n, n . J R p)`: derivative of `e` by the pose.
    by_pose: Vector3<f64>,
}

impl Term {
    #[inline]
    fn new(normal: Point, offset: Point, rotated: Point) -> Self {
        let by_pose = Vector3::new(normal.x, normal.y, normal.dot(&perpendicular(rotated)));
        Self { normal, offset, rotated, error: normal.dot(&offset), by_pose }
    }

    /// Derivative of the half gradient by the range of the sensed point, whose ray points along `v`.
    #[inline]
    fn gradient_by_sensed_range(&self, v: &Point) -> Vector3<f64> {
        self.by_pose * self.normal.dot(v) + Vector3::new(0.0, 0.0, self.error * self.normal.dot(&perpendicular(*v)))
    }

    /// Derivative of the half gradient by a displacement of the sensed point along `v` relative to the reference.
    #[inline]
    fn gradient_by_offset(&self, v: &Point) -> Vector3<f64> {
        self.by_pose * self.normal.dot(v)
    }

    /// Derivative of the half gradient by a range that rotates the normal by `rotation` rad per metre.
    #[inline]
    fn gradient_by_rotation(&self, rotation: f64) -> Vector3<f64> {
        let dn = perpendicular(self.normal) * rotation;
        let change = Vector3::new(dn.x, dn.y, dn.dot(&perpendicular(self.rotated)));
        self.by_pose * dn.dot(&self.offset) + change * self.error
    }
}

/// Sums over all terms. Only the upper triangles of the symmetric matrices are filled.
#[derive(Default)]
struct Sums {
    /// Sum of `a a'`: the Gauss-Newton matrix.
    information: Matrix3<f64>,
    /// Heading entry of the Hessian beyond the Gauss-Newton matrix; its other entries are zero.
    curvature: f64,
    /// Sum of the outer products of the derivatives of the half gradient by the ranges.
    spread: Matrix3<f64>,
    /// Sum of the distances of the points from the sensed laser, m.
    distance: f64,
}

#[inline]
fn add_outer(upper: &mut Matrix3<f64>, v: &Vector3<f64>) {
    for column in 0..3 {
        for row in 0..=column {
            upper[(row, column)] += v[row] * v[column];
        }
    }
}

fn symmetric(upper: &Matrix3<f64>) -> Matrix3<f64> {
    let mut full = *upper;
    full.fill_lower_triangle_with_upper_triangle();
    full
}

impl Sums {
    #[inline]
    fn add(&mut self, term: &Term) {
        add_outer(&mut self.information, &term.by_pose);
        self.curvature -= term.error * term.normal.dot(&term.rotated);
    }

    fn covariance(&self, range_noise: f64) -> Option<PoseCovariance> {
        let mut hessian = symmetric(&self.information);
        hessian.m33 += self.curvature;
        let inverse = hessian.try_inverse()?;
        let covariance = inverse * symmetric(&self.spread) * inverse * (range_noise * range_noise);
        covariance.iter().all(|v| v.is_finite()).then_some(covariance)
    }
}
