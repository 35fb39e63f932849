//! Relative pose error: how far the estimate drifts over a given distance of travel.
//!
//! J. Sturm, N. Engelhard, F. Endres, W. Burgard, D. Cremers: A benchmark for the evaluation of RGB-D SLAM systems, IROS 2012;
//! over distance, not time, so that standing still does not make an estimate look good.

use super::association::MatchedPose;
use super::statistics::PoseErrors;

/// The relative pose error per `distance` metres of the truth's path; `None` when the path is shorter.
///
/// Every matched pose starts one motion, which ends at the first pose at least `distance` further along the true path. The error
/// is that of the whole motion: it is not divided by the distance.
pub fn rpe(matched: &[MatchedPose], distance: f64) -> Option<PoseErrors> {
    let travelled = travelled(matched);
    let mut errors = Vec::new();
    let mut end = 0;
    for (start, from) in matched.iter().enumerate() {
        while end < matched.len() && travelled[end] - travelled[start] < distance {
            end += 1;
        }
        let Some(to) = matched.get(end) else { break };
        let true_motion = from.truth.between(&to.truth);
        let estimated_motion = from.estimate.between(&to.estimate);
        errors.push(true_motion.between(&estimated_motion));
    }
    PoseErrors::of(&errors)
}

/// Length of the true path from the first pose to each, m.
fn travelled(matched: &[MatchedPose]) -> Vec<f64> {
    let mut previous = matched.first().map(|m| m.truth.translation()).unwrap_or_default();
    matched
        .iter()
        .scan(0.0, |length, m| {
            *length += (m.truth.translation() - previous).norm();
            previous = m.truth.translation();
            Some(*length)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::geometry::Pose2;
    use crate::time::Stamp;

    /// Truth in steps of 0.5 m along x, an estimate whose steps are 0.6 m: 0.2 m per metre, whatever the start.
    fn stretched(poses: usize) -> Vec<MatchedPose> {
        (0..poses)
            .map(|i| MatchedPose {
                stamp: Stamp::default(),
                estimate: Pose2::new(7.0, 3.0 + 0.6 * i as f64, std::f64::consts::FRAC_PI_2),
                truth: Pose2::new(0.5 * i as f64, 0.0, 0.0),
            })
            .collect()
    }

    #[test]
    fn of_a_stretched_path_by_hand() {
        let errors = rpe(&stretched(7), 1.0).unwrap();
        assert_eq!(errors.count, 5); // the last two poses have no metre ahead of them
        assert!((errors.trans_m.rmse - 0.2).abs() < 1e-12 && errors.trans_m.std < 1e-12);
        assert!(errors.rot_deg.max < 1e-12);
        assert!((rpe(&stretched(7), 2.0).unwrap().trans_m.rmse - 0.4).abs() < 1e-12);
    }

    /// One metre straight while the estimate turns by 90 degrees on the way: it ends at (0.5, 0.5) instead of (1, 0).
    #[test]
    fn of_a_wrong_turn_by_hand() {
        let mut matched = stretched(3);
        matched[0].estimate = Pose2::IDENTITY;
        matched[2].estimate = Pose2::new(0.5, 0.5, std::f64::consts::FRAC_PI_2);
        let errors = rpe(&matched, 1.0).unwrap();
        assert_eq!(errors.count, 1);
        assert!((errors.trans_m.rmse - 0.5_f64.sqrt()).abs() < 1e-12);
        assert!((errors.rot_deg.rmse - 90.0).abs() < 1e-12);
    }

    #[test]
    fn of_a_path_too_short_is_nothing() {
        assert_eq!(rpe(&stretched(7), 3.1), None);
        assert_eq!(rpe(&[], 1.0), None);
    }
}
