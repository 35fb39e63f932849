//! Absolute trajectory error: how far the estimate is from the truth once the two are aligned as well as possible.
//!
//! J. Sturm, N. Engelhard, F. Endres, W. Burgard, D. Cremers: A benchmark for the evaluation of RGB-D SLAM systems, IROS 2012.

use super::association::MatchedPose;
use super::statistics::PoseErrors;
use crate::geometry::{Point, Pose2, perpendicular};

/// Absolute trajectory error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ate {
    /// The alignment: takes the estimate to the truth.
    pub truth_from_estimate: Pose2,
    /// What is left after it.
    pub errors: PoseErrors,
}

impl Ate {
    /// The error of one pose: the aligned estimate seen from the truth.
    pub fn error(&self, matched: &MatchedPose) -> Pose2 {
        error(self.truth_from_estimate, matched)
    }
}

fn error(truth_from_estimate: Pose2, matched: &MatchedPose) -> Pose2 {
    matched.truth.between(&(truth_from_estimate * matched.estimate))
}

/// The absolute trajectory error over all matched poses; `None` when there are none.
pub fn ate(matched: &[MatchedPose]) -> Option<Ate> {
    let truth_from_estimate = align(matched);
    let errors: Vec<_> = matched.iter().map(|m| error(truth_from_estimate, m)).collect();
    Some(Ate { truth_from_estimate, errors: PoseErrors::of(&errors)? })
}

/// The motion that takes the positions of the estimate onto those of the truth with the least sum of squared distances.
///
/// S. Umeyama: Least-squares estimation of transformation parameters between two point patterns, PAMI 1991; without the scale,
/// which a laser knows. In the plane its SVD shrinks to one arctangent: with both patterns about their centroids,
/// sum |q - R(theta) p|^2 = const - 2 (cos(theta) sum p.q + sin(theta) sum p x q). A robot that never moved leaves the angle
/// open; 0 is taken.
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

    /// Truth at (0,0), (2,0); estimate at (0,1), (4,1): aligned by (-1,-1), each end 1 m off along x.
    #[test]
    fn of_two_poses_by_hand() {
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
    fn of_nothing_is_nothing() {
        assert_eq!(ate(&[]), None);
    }
}
