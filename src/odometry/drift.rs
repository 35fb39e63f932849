//! Corrects a path that has drifted, after a loop closure.
//!
//! Step k of the path has an error `e_k` (x, y, heading) with covariance `C_k`. An error of the heading rotates all that follows,
//! so that the end of the path is off by `d = sum A_k e_k`, with `A_k` the lever arm from step k to the end. The most likely
//! errors that explain `d` are `e_k = C_k A_k' (sum A_j C_j A_j')^-1 d`: least squares over the steps with the loop closure as a
//! constraint, by Lagrange multipliers. A path that has drifted in one bad corner is rotated there, and not bent everywhere. This
//! is the closed form of a pose graph with one path and one certain loop.

use nalgebra::Matrix3;

use super::keyframe_pose::KeyframePose;
use super::uncertainty::pose_jacobian;
use crate::geometry::{Pose2, PoseCovariance};

/// Number of iterations: lever arms rotate with the path. After a drift of a metre and 0.1 rad less than a millimetre is left.
const ITERATIONS: usize = 3;

/// Corrects the poses of a path so that it ends at `end`. The first step leads from a fixed pose to the first pose.
pub(super) fn correct<'a>(path: impl Iterator<Item = &'a mut KeyframePose>, end: &Pose2) {
    let mut path: Vec<_> = path.collect();
    for _ in 0..ITERATIONS {
        distribute_error(&mut path, end);
    }
    // Exactly, because whatever follows the path is moved along with its last pose.
    if let Some(last) = path.last_mut() {
        last.map_from_laser = *end;
    }
}

/// Covariance of the end of a path, from those of its steps.
pub(super) fn end_covariance<'a>(path: impl Iterator<Item = &'a KeyframePose> + Clone) -> PoseCovariance {
    let Some(end) = path.clone().last().map(|pose| pose.map_from_laser) else { return PoseCovariance::zeros() };
    let of_step = |pose: &KeyframePose| {
        let lever_arm = lever_arm(&pose.map_from_laser, &end);
        lever_arm * pose.step_covariance * lever_arm.transpose()
    };
    path.map(of_step).sum()
}

/// Jacobian of the end of the path with respect to an error at `from`.
fn lever_arm(from: &Pose2, end: &Pose2) -> Matrix3<f64> {
    pose_jacobian(end.translation() - from.translation())
}

/// Distributes the difference between the path's last pose and `end` over the steps, with constant lever arms.
fn distribute_error(path: &mut [&mut KeyframePose], end: &Pose2) {
    let Some(last) = path.last().map(|pose| pose.map_from_laser) else { return };
    let Some(information) = end_covariance(path.iter().map(|pose| &**pose)).try_inverse() else { return };
    let multipliers = information * last.difference(end);
    let mut moved = Pose2::IDENTITY;
    for KeyframePose { map_from_laser, step_covariance, .. } in path.iter_mut().map(|pose| &mut **pose) {
        let error = *step_covariance * lever_arm(map_from_laser, &last).transpose() * multipliers;
        let shifted = moved * *map_from_laser;
        let new = Pose2::new(shifted.x + error.x, shifted.y + error.y, shifted.theta + error.z);
        moved = new * map_from_laser.inverse();
        *map_from_laser = new;
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::odometry::scale_error::ScaleJacobian;

    fn keyframe(pose: Pose2, position: f64, heading: f64) -> KeyframePose {
        let step_covariance =
            PoseCovariance::from_diagonal(&[position * position, position * position, heading * heading].into());
        KeyframePose {
            map_from_laser: pose,
            base_from_laser: Pose2::IDENTITY,
            covariance: PoseCovariance::zeros(),
            by_scale: ScaleJacobian::NONE,
            step_covariance,
        }
    }

    /// 20 m along x, around a corner, and 20 m along y. All headings are certain except the one at the corner.
    fn around_a_corner(corner_error: f64) -> Vec<KeyframePose> {
        let there = (1..=20).map(|i| Pose2::new(f64::from(i), 0.0, 0.0));
        let back = (1..=20).map(|i| Pose2::new(20.0, f64::from(i), 1.57));
        let poses = there.chain(back).enumerate();
        poses.map(|(i, pose)| keyframe(pose, 0.01, if i == 20 { corner_error } else { 1e-4 })).collect()
    }

    #[test]
    fn a_bad_corner_is_rotated_and_the_rest_stays() {
        let mut path = around_a_corner(0.1);
        let rotation = 0.05;
        // As if the second leg began at (20, 1) and was 19 m long in another direction.
        let end = Pose2::new(20.0 - 19.0 * f64::sin(rotation), 1.0 + 19.0 * f64::cos(rotation), 1.57 + rotation);
        correct(path.iter_mut(), &end);
        assert!(path[..20].iter().all(|pose| pose.map_from_laser.y.abs() < 0.01), "the first leg stays");
        assert!(
            (path[20].map_from_laser.theta - 1.57 - rotation).abs() < 1e-3
                && (path[30].map_from_laser.theta - 1.57 - rotation).abs() < 1e-3
        );
        assert!((path[30].map_from_laser.x - (20.0 - 10.0 * f64::sin(rotation))).abs() < 0.01);
    }

    #[test]
    fn the_end_covariance_sums_the_steps_through_their_lever_arms() {
        let path: Vec<_> = (1..=2).map(|i| keyframe(Pose2::new(f64::from(i), 0.0, 0.0), 0.1, 0.2)).collect();
        let end = end_covariance(path.iter());
        // The first step's rotation moves the end by a metre per radian, the second one's does not.
        let expected = Matrix3::new(0.02, 0.0, 0.0, 0.0, 0.02 + 0.04, 0.04, 0.0, 0.04, 0.08);
        assert!((end - expected).norm() < 1e-12, "{end}");
        assert_eq!(end_covariance(std::iter::empty()), PoseCovariance::zeros());
    }

    #[test]
    fn equal_steps_share_a_shift() {
        let mut path: Vec<_> = (1..=10).map(|i| keyframe(Pose2::new(f64::from(i), 0.0, 0.0), 0.01, 1e-9)).collect();
        correct(path.iter_mut(), &Pose2::new(10.5, 0.2, 0.0));
        for (i, pose) in path.iter().enumerate() {
            let fraction = (i + 1) as f64 / 10.0;
            let Pose2 { x, y, .. } = pose.map_from_laser;
            assert!((x - 10.5 * fraction).abs() < 1e-6 && (y - 0.2 * fraction).abs() < 1e-6, "{i}: {x} {y}");
        }
    }

    #[test]
    fn if_every_step_is_certain_only_the_end_moves() {
        let mut path: Vec<_> = (1..=3).map(|i| keyframe(Pose2::new(f64::from(i), 0.0, 0.0), 0.0, 0.0)).collect();
        let end = Pose2::new(3.0, 0.1, 0.0);
        correct(path.iter_mut(), &end);
        assert_eq!((path[1].map_from_laser, path[2].map_from_laser), (Pose2::new(2.0, 0.0, 0.0), end));
        correct(std::iter::empty(), &end);
    }

    proptest! {
        #[test]
        fn the_path_converges_to_its_end(x in -1.0..1.0, y in -1.0..1.0, rotation in -0.1..0.1, corner_error in 1e-4..0.1) {
            let mut path = around_a_corner(corner_error);
            let end = Pose2::new(20.0 + x, 20.0 + y, 1.57 + rotation);
            let mut path: Vec<_> = path.iter_mut().collect();
            for _ in 0..ITERATIONS {
                distribute_error(&mut path, &end);
            }
            let left = path[39].map_from_laser.between(&end);
            prop_assert!(left.distance() < 1e-3 && left.theta.abs() < 1e-6, "{left:?}");
        }
    }
}
