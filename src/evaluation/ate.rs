//! Absolute trajectory error (ATE): the error of the estimated poses after the best alignment with the truth.
//!
//! J. Sturm, N. Engelhard, F. Endres, W. Burgard, D. Cremers: A benchmark for the evaluation of RGB-D SLAM systems, IROS 2012.

use super::association::MatchedPose;
use super::statistics::PoseErrors;
use crate::geometry::{Point, Pose2, perpendicular};

/// Absolute trajectory error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ate {
    /// The alignment: transforms the estimate to the frame of the truth.
    pub truth_from_estimate: Pose2,
    /// Errors that remain after the alignment.
    pub errors: PoseErrors,
}

impl Ate {
    /// The error of one pose: the aligned estimate in the frame of the true pose.
    pub fn error(&self, matched: &MatchedPose) -> Pose2 {
        error(self.truth_from_estimate, matched)
    }
}

fn error(truth_from_estimate: Pose2, matched: &MatchedPose) -> Pose2 {
    matched.truth.between(&(truth_from_estimate * matched.estimate))
}

/// Computes the absolute trajectory error of all matched poses; `None` if there are none.
pub fn ate(matched: &[MatchedPose]) -> Option<Ate> {
    let truth_from_estimate = align(matched);
    let errors: Vec<_> = matched.iter().map(|m| error(truth_from_estimate, m)).collect();
    Some(Ate { truth_from_estimate, errors: PoseErrors::of(&errors)? })
}

/// The rigid transform from the estimated to the true positions with the least sum of squared distances.
///
/// S. Umeyama: Least-squares estimation of transformation parameters between two point patterns, PAMI 1991; without the scale,
/// which a laser measures. In the plane the SVD reduces to one arctangent: with both patterns centred at their centroids,
/// sum |q - R(theta) p|^2 = const - 2 (cos(theta) sum p.q + sin(theta) sum p x q). If the robot never
/// moved, the angle is undetermined, and 0 is used.
fn align(matched: &[MatchedPose]) -> Pose2 {
    let count = matched.len() as f64;
    let estimate_centre = matched.iter().map(|m| m.estimate.translation()).sum::<Point>() / count;
    let truth_centre = matched.iter().map(|m| m.truth.translation()).sum::<Point>() / count;
    let (mut dot, mut cross) = (0.0, 0.0);
    for m in matched {
        let p = m.estimate.translation() - estimate_centre;
        let q = m.truth.translation() - truth_centre;
        dot += p.dot(&q);
        cross += perpendicular(p).dot(&q);
    }
    let rotation = Pose2::new(0.0, 0.0, f64::atan2(cross, dot));
    let shift = truth_centre - rotation.transform().rotate(estimate_centre);
    Pose2::new(shift.x, shift.y, rotation.theta)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::time::Stamp;

    /// Truth at (0,0), (2,0); estimate at (0,1), (4,1): the alignment is (-1,-1), and each end is off by 1 m along x.
    #[test]
    fn ate_of_two_poses_matches_hand_calculation() {
        let pair = |truth, estimate| MatchedPose { stamp: Stamp::default(), estimate, truth };
        let ate = ate(&[
            pair(Pose2::new(0.0, 0.0, 0.1), Pose2::new(0.0, 1.0, 0.0)),
            pair(Pose2::new(2.0, 0.0, 0.0), Pose2::new(4.0, 1.0, 0.3)),
        ])
        .unwrap();
        assert_eq!(ate.truth_from_estimate, Pose2::new(-1.0, -1.0, 0.0));
        assert!((ate.errors.trans_m.rmse - 1.0).abs() < 1e-15);
        assert!((ate.errors.rot_deg.mean - 0.2_f64.to_degrees()).abs() < 1e-12);
    }

    #[test]
    fn no_poses_have_no_ate() {
        assert_eq!(ate(&[]), None);
    }
}
