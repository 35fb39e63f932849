//! Relative pose error (RPE): the drift of the estimate over a given path length.
//!
//! J. Sturm, N. Engelhard, F. Endres, W. Burgard, D. Cremers: A benchmark for the evaluation of RGB-D SLAM systems, IROS 2012;
//! here over distance, not time, so that standing still does not improve the result.

use super::association::MatchedPose;
use super::statistics::PoseErrors;

/// Computes the relative pose error over `distance` metres of the true path; `None` if the path is shorter.
///
/// Every matched pose starts one motion, which ends at the first pose at least `distance` further along the true path. The error of the
/// whole motion counts; it is not divided by the distance.
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

    /// Truth in steps of 0.5 m along x, and an estimate with steps of 0.6 m: an error of 0.2 m per metre from any start.
    fn scaled_path(poses: usize) -> Vec<MatchedPose> {
        (0..poses)
            .map(|i| MatchedPose {
                stamp: Stamp::default(),
                estimate: Pose2::new(7.0, 3.0 + 0.6 * i as f64, std::f64::consts::FRAC_PI_2),
                truth: Pose2::new(0.5 * i as f64, 0.0, 0.0),
            })
            .collect()
    }

    #[test]
    fn rpe_of_a_scaled_path_matches_hand_calculation() {
        let errors = rpe(&scaled_path(7), 1.0).unwrap();
        assert_eq!(errors.count, 5); // the last two poses have less than a metre left
        assert!((errors.trans_m.rmse - 0.2).abs() < 1e-12 && errors.trans_m.std < 1e-12);
        assert!(errors.rot_deg.max < 1e-12);
        assert!((rpe(&scaled_path(7), 2.0).unwrap().trans_m.rmse - 0.4).abs() < 1e-12);
    }

    /// One metre straight, but the estimate rotates by 90 degrees and ends at (0.5, 0.5) instead of (1, 0).
    #[test]
    fn rpe_of_a_wrong_rotation_matches_hand_calculation() {
        let mut matched = scaled_path(3);
        matched[0].estimate = Pose2::IDENTITY;
        matched[2].estimate = Pose2::new(0.5, 0.5, std::f64::consts::FRAC_PI_2);
        let errors = rpe(&matched, 1.0).unwrap();
        assert_eq!(errors.count, 1);
        assert!((errors.trans_m.rmse - 0.5_f64.sqrt()).abs() < 1e-12);
        assert!((errors.rot_deg.rmse - 90.0).abs() < 1e-12);
    }

    #[test]
    fn short_paths_have_no_rpe() {
        assert_eq!(rpe(&scaled_path(7), 3.1), None);
        assert_eq!(rpe(&[], 1.0), None);
    }
}
