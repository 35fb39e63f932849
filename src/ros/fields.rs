//! What many messages have in common, made of values of the plane.

use crate::ros::generated::geometry_msgs::{Point, Pose, Quaternion, Transform, TransformStamped, Twist, Vector3};
use crate::ros::generated::std_msgs::Header;
use nalgebra::Matrix3;

use crate::geometry::{Pose2, PoseCovariance, Twist2};
use crate::time::Stamp;

/// Variance of what a scan in the plane says nothing about: height, roll and pitch, in m^2 and rad^2.
const UNOBSERVED: f64 = 1e6;
/// Filters refuse a covariance of zero, and no estimate is that good, m^2 and rad^2.
const LEAST_VARIANCE: f64 = 1e-9;

pub(super) fn header(number: u32, stamp: Stamp, frame: &str) -> Header {
    let (sec, nsec) = stamp.to_ros();
    Header { seq: number, stamp: rosrust::Time { sec, nsec }, frame_id: frame.into() }
}

pub(super) fn pose(pose: &Pose2) -> Pose {
    let (z, w) = (0.5 * pose.theta).sin_cos();
    Pose { position: Point { x: pose.x, y: pose.y, z: 0.0 }, orientation: Quaternion { x: 0.0, y: 0.0, z, w } }
}

/// Where `child` is, in the frame of the header.
pub(super) fn transform(header: Header, child: &str, parent_from_child: &Pose2) -> TransformStamped {
    let Pose { position, orientation } = pose(parent_from_child);
    let translation = Vector3 { x: position.x, y: position.y, z: position.z };
    TransformStamped { header, child_frame_id: child.into(), transform: Transform { translation, rotation: orientation } }
}

pub(super) fn twist(twist: &Twist2) -> Twist {
    Twist { linear: Vector3 { x: twist.vx, y: twist.vy, z: 0.0 }, angular: Vector3 { x: 0.0, y: 0.0, z: twist.omega } }
}

/// Order x, y, z, roll, pitch, yaw, row by row.
pub(super) fn covariance(planar: &PoseCovariance) -> [f64; 36] {
    const PLACES: [usize; 3] = [0, 1, 5];
    let mut full = [0.0; 36];
    for unobserved in [2, 3, 4] {
        full[7 * unobserved] = UNOBSERVED;
    }
    let planar = if planar.iter().all(|v| v.is_finite()) { *planar } else { Matrix3::from_diagonal_element(UNOBSERVED) };
    for (i, row) in PLACES.into_iter().enumerate() {
        for (j, column) in PLACES.into_iter().enumerate() {
            let least = if i == j { LEAST_VARIANCE } else { f64::NEG_INFINITY };
            full[6 * row + column] = planar[(i, j)].max(least);
        }
    }
    full
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_planar_covariance_takes_its_places_among_six() {
        let planar = Matrix3::new(1.0, 2.0, 3.0, 2.0, 5.0, 6.0, 3.0, 6.0, 0.0);
        let full = covariance(&planar);
        let holds = |places: [usize; 3], values: [f64; 3]| {
            assert_eq!(places.map(|place| full[place].to_bits()), values.map(f64::to_bits), "{places:?}");
        };
        holds([0, 1, 5], [1.0, 2.0, 3.0]);
        holds([6, 7, 11], [2.0, 5.0, 6.0]);
        holds([30, 31, 35], [3.0, 6.0, LEAST_VARIANCE]);
        holds([14, 21, 28], [UNOBSERVED; 3]);
        assert!(covariance(&Matrix3::from_element(f64::NAN)).iter().all(|v| v.is_finite()));
    }

    #[test]
    fn a_heading_becomes_a_unit_quaternion() {
        let q = pose(&Pose2::new(0.0, 0.0, 1.2)).orientation;
        assert!((2.0 * q.z.atan2(q.w) - 1.2).abs() < 1e-12 && (q.z.hypot(q.w) - 1.0).abs() < 1e-12);
    }
}
