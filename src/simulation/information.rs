//! What a scan can tell of the pose it was taken at: the Fisher information, hence the least covariance that any matcher can reach
//! (Cramer and Rao).

use nalgebra::{Matrix3, Vector3};

use crate::geometry::{Point, Pose2, PoseCovariance, perpendicular};
use crate::scan::BeamGeometry;

use super::world::World;

/// Beams are turned by this much to see how their ranges change, rad.
const TURN: f64 = 1e-6;
/// Where the change of range differs by more than this part from one side to the other, the beam meets an edge and says nothing.
const EDGE: f64 = 1e-2;
/// A direction of which this part of the best known one's information is known is not known at all: it is rounding.
const NOTHING: f64 = 1e-12;

/// The information about the pose `map_from_laser` in one scan of a known world; order x, y, heading, in the frame of the map.
/// `noise` is the standard deviation of the ranges and `max` the farthest one, m.
pub fn of_scan(world: &dyn World, map_from_laser: &Pose2, beams: &BeamGeometry, noise: f64, max: f64) -> Matrix3<f64> {
    let laser = map_from_laser.transform();
    let origin = map_from_laser.translation();
    let derivatives = beams.directions().iter().filter_map(|&beam| by_pose(world, origin, laser.rotate(beam), max));
    derivatives.map(|derivative| derivative * derivative.transpose()).sum::<Matrix3<f64>>() / (noise * noise)
}

/// The derivative of a beam's range by the pose. With k the relative change of range by angle, a wall seen along v has the normal
/// v - k perp(v), scaled so that its product with v is 1.
fn by_pose(world: &dyn World, origin: Point, v: Point, max: f64) -> Option<Vector3<f64>> {
    let turned = |angle: f64| world.range(origin, v + perpendicular(v) * angle, max);
    let (before, range, after) = (turned(-TURN)?, turned(0.0)?, turned(TURN)?);
    let (left, right) = ((after - range) / (TURN * range), (range - before) / (TURN * range));
    let k = 0.5 * (left + right);
    let normal = v - perpendicular(v) * k;
    ((left - right).abs() <= EDGE * (1.0 + k.abs())).then(|| Vector3::new(-normal.x, -normal.y, k * range))
}

/// The least covariance of the pose between two scans of the same information, neither of which knows the world but by the other;
/// `None` where they leave a direction open.
pub fn bound_of_pair(information: &Matrix3<f64>) -> Option<PoseCovariance> {
    let eigenvalues = information.symmetric_eigenvalues();
    let determined = eigenvalues.min() > NOTHING * eigenvalues.max();
    determined.then(|| information.try_inverse()).flatten().map(|inverse| inverse * 2.0)
}
