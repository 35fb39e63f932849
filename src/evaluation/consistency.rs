//! Whether covariances hold: errors against the truth, in units of what the estimate claims of them (Bar-Shalom, Li and Kirubarajan:
//! Estimation with Applications to Tracking and Navigation, 2001, section 5.4).

use std::fmt;

use nalgebra::Vector3;
use serde::Serialize;

use super::association::true_pose;
use super::trajectory::{StampedPose, Trajectory};
use crate::geometry::{Pose2, PoseCovariance, wrap_angle};

/// Square of the distance, in standard deviations, that a position in the plane keeps within as seldom as one coordinate keeps within
/// three: chi-squared of 2 degrees of freedom at 99.73 %.
const THREE_SIGMA_IN_THE_PLANE: f64 = 11.83;
/// The same for one coordinate.
const THREE_SIGMA: f64 = 9.0;
/// An error that a controller minds, m ...
const GROSS: f64 = 0.1;
/// ... and deg.
const GROSS_TURN: f64 = 2.0;

/// A pose and what its estimator says of its error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Claim {
    /// Pose of the base, in a frame that does not jump.
    pub pose: StampedPose,
    /// Covariance of it, in that frame.
    pub covariance: PoseCovariance,
    /// Whether the pose is said to be relied on.
    pub is_ok: bool,
}

/// How well the claims of a drive hold. Errors are those of the pose seen from the first one that has a true pose.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Consistency {
    /// Poses that were compared.
    pub poses: usize,
    /// Share of the positions that are within three sigma; 0.9973 where covariances are right.
    pub positions_within: f64,
    /// Share of the headings that are.
    pub headings_within: f64,
    /// Normalised estimation error squared, mean; 3 where covariances are right, less where they are cautious.
    pub nees: f64,
    /// Poses that are off by more than 10 cm or 2 degrees, beyond three sigma, and yet said to be relied on.
    pub confidently_wrong: usize,
}

impl Consistency {
    /// Of poses, each with its covariance and the truth in one frame; `None` where no covariance can be inverted.
    pub fn of<'a>(poses: impl IntoIterator<Item = (&'a Pose2, &'a PoseCovariance, &'a Pose2)>) -> Option<Self> {
        let mut sums = Sums::default();
        for (pose, covariance, truth) in poses {
            sums.add(pose, covariance, truth, true);
        }
        sums.consistency()
    }

    /// Compares claims, in any order, with the truth within `max_dt` seconds; `None` where no claim has a covariance and a true pose.
    pub fn new(claims: &[Claim], truth: &Trajectory, max_dt: f64) -> Option<Self> {
        let mut sums = Sums::default();
        let mut claims = claims.iter().filter_map(|claim| Some((claim, true_pose(truth, claim.pose.stamp, max_dt)?)));
        let (start, true_start) = claims.next()?;
        for (Claim { pose, covariance, is_ok }, truth) in claims {
            let truth = start.pose.pose * true_start.between(&truth);
            sums.add(&pose.pose, covariance, &truth, *is_ok);
        }
        sums.consistency()
    }
}

/// A line for people.
impl fmt::Display for Consistency {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [positions, headings] = [self.positions_within, self.headings_within].map(|share| 100.0 * share);
        write!(f, "within 3 sigma: {positions:.1} % of positions, {headings:.1} % of headings (odom frame); ")?;
        write!(f, "off by over 10 cm or 2 deg and beyond: {} poses", self.confidently_wrong)
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
    /// A pose without covariance, as of the first scan, says nothing of its error.
    fn add(&mut self, pose: &Pose2, covariance: &PoseCovariance, truth: &Pose2, is_ok: bool) {
        let Some(known) = covariance.cholesky() else { return };
        let turn = wrap_angle(pose.theta - truth.theta);
        let error = Vector3::new(pose.x - truth.x, pose.y - truth.y, turn);
        let position = error.fixed_rows::<2>(0).into_owned();
        let squared =
            covariance.fixed_view::<2, 2>(0, 0).into_owned().cholesky().map(|known| position.dot(&known.solve(&position)));
        let is_position_within = squared.is_some_and(|squared| squared <= THREE_SIGMA_IN_THE_PLANE);
        let is_heading_within = turn * turn <= THREE_SIGMA * covariance.m33;
        let is_gross =
            (position.norm() > GROSS && !is_position_within) || (turn.to_degrees().abs() > GROSS_TURN && !is_heading_within);
        self.poses += 1;
        self.positions_within += usize::from(is_position_within);
        self.headings_within += usize::from(is_heading_within);
        self.nees += error.dot(&known.solve(&error));
        self.confidently_wrong += usize::from(is_ok && is_gross);
    }

    fn consistency(&self) -> Option<Consistency> {
        let share = |count: usize| count as f64 / self.poses as f64;
        (self.poses > 0).then(|| Consistency {
            poses: self.poses,
            positions_within: share(self.positions_within),
            headings_within: share(self.headings_within),
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

    fn claim(seconds: f64, x: f64, theta: f64) -> Claim {
        let pose = StampedPose { stamp: Stamp::from_seconds(seconds), pose: Pose2::new(x, 0.0, theta) };
        let variance = if seconds == 0.0 { 0.0 } else { SIGMA * SIGMA };
        Claim { pose, covariance: PoseCovariance::from_diagonal_element(variance), is_ok: true }
    }

    /// The truth is a drive along y at 1 m/s that begins at (5, 5); the estimate calls that direction x.
    fn compared(claims: &[Claim]) -> Option<Consistency> {
        let at = |seconds: f64| StampedPose {
            stamp: Stamp::from_seconds(seconds),
            pose: Pose2::new(5.0, 5.0 + seconds, std::f64::consts::FRAC_PI_2),
        };
        let truth = Trajectory::new((0..10).map(|i| at(f64::from(i))).collect()).unwrap();
        Consistency::new(claims, &truth, 0.1)
    }

    #[test]
    fn errors_are_seen_from_the_start_in_units_of_sigma() {
        let found = compared(&[claim(0.0, 0.0, 0.0), claim(1.0, 1.1, 0.1), claim(2.0, 2.0, 0.0)]).unwrap();
        assert_eq!((found.poses, found.confidently_wrong), (2, 0), "the start says nothing of itself");
        assert!((found.nees - 1.0).abs() < 1e-9 && found.positions_within > 0.99 && found.headings_within > 0.99, "{found:?}");
    }

    #[test]
    fn scans_out_of_order_count_too() {
        let claims = [0.0, 1.0, 3.0, 2.0, 4.0].map(|seconds| claim(seconds, seconds, 0.0));
        assert_eq!(compared(&claims).unwrap().poses, 4);
    }

    #[test]
    fn what_is_beyond_three_sigma_and_large_is_confidently_wrong() {
        let found = compared(&[claim(0.0, 0.0, 0.0), claim(1.0, 1.5, 0.0), claim(2.0, 2.0, 0.5)]).unwrap();
        assert_eq!((found.positions_within, found.headings_within, found.confidently_wrong), (0.5, 0.5, 2));
        let doubtful = Claim { is_ok: false, ..claim(1.0, 1.5, 0.0) };
        assert_eq!(compared(&[claim(0.0, 0.0, 0.0), doubtful]).unwrap().confidently_wrong, 0);
    }

    #[test]
    fn errors_that_their_covariances_predict_are_consistent() {
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
        let of = |claimed: PoseCovariance| Consistency::of(estimates.iter().map(|pose| (pose, &claimed, &truth))).unwrap();
        let (right, bold) = (of(covariance), of(covariance / 9.0));
        assert!((right.nees - 3.0).abs() < 0.1 && (right.positions_within - 0.9973).abs() < 0.002, "{right:?}");
        assert!((bold.nees - 27.0).abs() < 1.0 && (bold.positions_within - 0.48).abs() < 0.02, "{bold:?}");
    }

    #[test]
    fn without_covariances_nothing_is_said() {
        assert_eq!(
            compared(&[claim(0.0, 0.0, 0.0), Claim { covariance: PoseCovariance::zeros(), ..claim(1.0, 1.0, 0.0) }]),
            None
        );
    }
}
