//! Fisher information of a scan about the pose it was taken at. Its inverse is the Cramer-Rao bound: the smallest covariance that
//! any matcher can reach.

use nalgebra::{Matrix3, Vector3};

use crate::geometry::{Point, Pose2, PoseCovariance, perpendicular};
use crate::scan::BeamGeometry;

use super::world::World;

/// Rotation of the beams for the numerical derivatives of their ranges, rad.
const ANGLE_STEP: f64 = 1e-6;
/// Maximum relative difference between the left and the right derivative: beyond it the beam hits an edge and is ignored.
const EDGE_TOLERANCE: f64 = 1e-2;
/// Minimum ratio of the smallest to the largest eigenvalue of the information: below it a direction is unconstrained except for
/// rounding errors.
const MIN_EIGENVALUE_RATIO: f64 = 1e-12;

/// Fisher information of one scan in a known world about the pose `map_from_laser`; order x, y, heading, in the frame of the map.
/// `noise` is the standard deviation of the ranges, m, and `max` the maximum range, m.
pub fn scan_information(world: &dyn World, map_from_laser: &Pose2, beams: &BeamGeometry, noise: f64, max: f64) -> Matrix3<f64> {
    let laser = map_from_laser.transform();
    let origin = map_from_laser.translation();
    let derivatives = beams.directions().iter().filter_map(|&beam| range_derivative(world, origin, laser.rotate(beam), max));
    derivatives.map(|derivative| derivative * derivative.transpose()).sum::<Matrix3<f64>>() / (noise * noise)
}

/// Derivative of a beam's range with respect to the pose; `None` without a hit or at an edge. With k the relative change of range
/// by angle, a wall seen along v has the normal v - k perp(v), scaled so that its dot product with v is 1.
fn range_derivative(world: &dyn World, origin: Point, v: Point, max: f64) -> Option<Vector3<f64>> {
    let range_at = |angle: f64| world.range(origin, v + perpendicular(v) * angle, max);
    let (before, range, after) = (range_at(-ANGLE_STEP)?, range_at(0.0)?, range_at(ANGLE_STEP)?);
    let (left, right) = ((after - range) / (ANGLE_STEP * range), (range - before) / (ANGLE_STEP * range));
    let k = 0.5 * (left + right);
    let normal = v - perpendicular(v) * k;
    ((left - right).abs() <= EDGE_TOLERANCE * (1.0 + k.abs())).then(|| Vector3::new(-normal.x, -normal.y, k * range))
}

/// Lower bound of the covariance of the relative pose of two scans with the same information, when the world is only known from
/// these scans; `None` if a direction is unconstrained.
pub fn pair_covariance_bound(information: &Matrix3<f64>) -> Option<PoseCovariance> {
    let eigenvalues = information.symmetric_eigenvalues();
    let is_constrained = eigenvalues.min() > MIN_EIGENVALUE_RATIO * eigenvalues.max();
    is_constrained.then(|| information.try_inverse()).flatten().map(|inverse| inverse * 2.0)
}
