//! Consistency check of covariances: compares the errors against the truth with the covariances that the estimator reports (Bar-Shalom,
//! Li and Kirubarajan: Estimation with Applications to Tracking and Navigation, 2001, section 5.4).

use std::fmt;

use nalgebra::Vector3;
use serde::Serialize;

use super::association::true_pose;
use super::trajectory::{StampedPose, Trajectory};
use crate::geometry::{Pose2, PoseCovariance, wrap_angle};

/// Squared Mahalanobis distance that a position in the plane exceeds as rarely as one coordinate exceeds three standard deviations:
/// chi-squared of 2 degrees of freedom at 99.73 %.
const THREE_SIGMA_IN_THE_PLANE: f64 = 11.83;
/// The same for one coordinate: the square of three standard deviations.
const THREE_SIGMA: f64 = 9.0;
/// Smallest position error that matters to a controller, m.
const GROSS_ERROR: f64 = 0.1;
/// Smallest heading error that matters to a controller, deg.
const GROSS_ROTATION: f64 = 2.0;

/// A pose with the covariance that its estimator reports.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UncertainPose {
    /// Pose of the base, in a frame without jumps.
    pub pose: StampedPose,
    /// Covariance of the pose, in that frame.
    pub covariance: PoseCovariance,
    /// Whether the estimator reports the pose as reliable.
    pub is_ok: bool,
}

/// Consistency of the covariances of a drive. Errors are relative to the first pose that has a true pose.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Consistency {
    /// Number of poses compared.
    pub poses: usize,
    /// Fraction of the positions within three sigma; 0.9973 if the covariances are right.
    pub positions_within: f64,
    /// Fraction of the headings within three sigma; 0.9973 if the covariances are right.
    pub headings_within: f64,
    /// Mean normalised estimation error squared (NEES); 3 if the covariances are right, less if they are conservative.
    pub nees: f64,
    /// Number of poses that are off by more than 10 cm or 2 degrees, and by more than three sigma, but reported as reliable.
    pub confidently_wrong: usize,
}

impl Consistency {
    /// Evaluates poses, each with its covariance and true pose in a common frame; `None` if no covariance is invertible.
    pub fn of<'a>(poses: impl IntoIterator<Item = (&'a Pose2, &'a PoseCovariance, &'a Pose2)>) -> Option<Self> {
        let mut sums = Sums::default();
        for (pose, covariance, truth) in poses {
            sums.add(pose, covariance, truth, true);
        }
        sums.consistency()
    }

    /// Compares poses, in any order, with the truth within `max_dt` seconds; `None` if no pose has both a covariance and a true pose.
    pub fn new(poses: &[UncertainPose], truth: &Trajectory, max_dt: f64) -> Option<Self> {
        let mut sums = Sums::default();
        let mut poses = poses
            .iter()
            .filter_map(|uncertain_pose| Some((uncertain_pose, true_pose(truth, uncertain_pose.pose.stamp, max_dt)?)));
        let (start, true_start) = poses.next()?;
        for (UncertainPose { pose, covariance, is_ok }, truth) in poses {
            let truth = start.pose.pose * true_start.between(&truth);
            sums.add(&pose.pose, covariance, &truth, *is_ok);
        }
        sums.consistency()
    }
}

/// One line of text.
impl fmt::Display for Consistency {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [positions, headings] = [self.positions_within, self.headings_within].map(|fraction| 100.0 * fraction);
        write!(f, "within 3 sigma: {positions:.1} % of positions, {headings:.1} % of headings (odom frame); ")?;
        write!(f, "confidently wrong (off by over 10 cm or 2 deg, and over 3 sigma): {} poses", self.confidently_wrong)
    }
}

#[derive(Default)]
struct Sums {
    poses: usize,
    positions_within: usize,
    headings_within: usize,
    nees: f64,
    confidently_wrong: usize,
}

impl Sums {
    /// Adds a pose. One without an invertible covariance, like that of the first scan, is ignored.
    fn add(&mut self, pose: &Pose2, covariance: &PoseCovariance, truth: &Pose2, is_ok: bool) {
        let Some(known) = covariance.cholesky() else { return };
        let rotation = wrap_angle(pose.theta - truth.theta);
        let error = Vector3::new(pose.x - truth.x, pose.y - truth.y, rotation);
        let position = error.fixed_rows::<2>(0).into_owned();
        let squared =
            covariance.fixed_view::<2, 2>(0, 0).into_owned().cholesky().map(|known| position.dot(&known.solve(&position)));
        let is_position_within = squared.is_some_and(|squared| squared <= THREE_SIGMA_IN_THE_PLANE);
        let is_heading_within = rotation * rotation <= THREE_SIGMA * covariance.m33;
        let is_gross = (position.norm() > GROSS_ERROR && !is_position_within)
            || (rotation.to_degrees().abs() > GROSS_ROTATION && !is_heading_within);
        self.poses += 1;
        self.positions_within += usize::from(is_position_within);
        self.headings_within += usize::from(is_heading_within);
        self.nees += error.dot(&known.solve(&error));
        self.confidently_wrong += usize::from(is_ok && is_gross);
    }

    fn consistency(&self) -> Option<Consistency> {
        let fraction = |count: usize| count as f64 / self.poses as f64;
        (self.poses > 0).then(|| Consistency {
            poses: self.poses,
            positions_within: fraction(self.positions_within),
            headings_within: fraction(self.headings_within),
            nees: self.nees / self.poses as f64,
            confidently_wrong: self.confidently_wrong,
        })
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use rand::SeedableRng as _;
    use rand_distr::{Distribution as _, StandardNormal};
    use rand_pcg::Pcg64;

    use super::*;
    use crate::time::Stamp;

    const SIGMA: f64 = 0.1;

    fn uncertain_pose(seconds: f64, x: f64, theta: f64) -> UncertainPose {
        let pose = StampedPose { stamp: Stamp::from_seconds(seconds), pose: Pose2::new(x, 0.0, theta) };
        let variance = if seconds == 0.0 { 0.0 } else { SIGMA * SIGMA };
        UncertainPose { pose, covariance: PoseCovariance::from_diagonal_element(variance), is_ok: true }
    }

    /// The true drive starts at (5, 5) and goes along y at 1 m/s, which is x in the frame of the estimate.
    fn consistency_of(poses: &[UncertainPose]) -> Option<Consistency> {
        let at = |seconds: f64| StampedPose {
            stamp: Stamp::from_seconds(seconds),
            pose: Pose2::new(5.0, 5.0 + seconds, std::f64::consts::FRAC_PI_2),
        };
        let truth = Trajectory::new((0..10).map(|i| at(f64::from(i))).collect()).unwrap();
        Consistency::new(poses, &truth, 0.1)
    }

    #[test]
    fn errors_are_relative_to_the_start_in_units_of_sigma() {
        let found =
            consistency_of(&[uncertain_pose(0.0, 0.0, 0.0), uncertain_pose(1.0, 1.1, 0.1), uncertain_pose(2.0, 2.0, 0.0)])
                .unwrap();
        assert_eq!((found.poses, found.confidently_wrong), (2, 0), "the start itself does not count");
        assert!((found.nees - 1.0).abs() < 1e-9 && found.positions_within > 0.99 && found.headings_within > 0.99, "{found:?}");
    }

    #[test]
    fn scans_out_of_order_count_too() {
        let poses = [0.0, 1.0, 3.0, 2.0, 4.0].map(|seconds| uncertain_pose(seconds, seconds, 0.0));
        assert_eq!(consistency_of(&poses).unwrap().poses, 4);
    }

    #[test]
    fn large_errors_beyond_three_sigma_are_confidently_wrong() {
        let found =
            consistency_of(&[uncertain_pose(0.0, 0.0, 0.0), uncertain_pose(1.0, 1.5, 0.0), uncertain_pose(2.0, 2.0, 0.5)])
                .unwrap();
        assert_eq!((found.positions_within, found.headings_within, found.confidently_wrong), (0.5, 0.5, 2));
        let unreliable = UncertainPose { is_ok: false, ..uncertain_pose(1.0, 1.5, 0.0) };
        assert_eq!(consistency_of(&[uncertain_pose(0.0, 0.0, 0.0), unreliable]).unwrap().confidently_wrong, 0);
    }

    #[test]
    fn errors_drawn_from_their_covariance_are_consistent() {
        let mut random = Pcg64::seed_from_u64(1);
        let covariance = PoseCovariance::new(4e-4, 1e-4, 1e-5, 1e-4, 1e-4, 0.0, 1e-5, 0.0, 1e-5);
        let root = covariance.cholesky().unwrap().l();
        let truth = Pose2::new(3.0, -2.0, 3.1);
        let estimates: Vec<Pose2> = (0..10_000)
            .map(|_| {
                let off = root * Vector3::from_fn(|_, _| StandardNormal.sample(&mut random));
                Pose2::new(truth.x + off.x, truth.y + off.y, wrap_angle(truth.theta + off.z))
            })
            .collect();
        let of = |reported: PoseCovariance| Consistency::of(estimates.iter().map(|pose| (pose, &reported, &truth))).unwrap();
        let (right, overconfident) = (of(covariance), of(covariance / 9.0));
        assert!((right.nees - 3.0).abs() < 0.1 && (right.positions_within - 0.9973).abs() < 0.002, "{right:?}");
        assert!(
            (overconfident.nees - 27.0).abs() < 1.0 && (overconfident.positions_within - 0.48).abs() < 0.02,
            "{overconfident:?}"
        );
    }

    #[test]
    fn without_covariances_there_is_no_result() {
        assert_eq!(
            consistency_of(&[
                uncertain_pose(0.0, 0.0, 0.0),
                UncertainPose { covariance: PoseCovariance::zeros(), ..uncertain_pose(1.0, 1.0, 0.0) }
            ]),
            None
        );
    }
}
