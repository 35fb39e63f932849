//! Verifies loop closures in the odometry.
//!
//! Each new keyframe is matched to earlier keyframes nearby. If the path has drifted little, a single match is enough. If it has
//! drifted far, a wrong place may match by chance. Then only several keyframes in a row that agree on the drift are accepted
//! (consistency of loop closures in a chain, as in Olson 2009, "Recognizing places using spectrally clustered local matches"). An
//! accepted measurement corrects the path by a Kalman update, weighted by its information: along a corridor that may be none.

use nalgebra::Matrix3;

use crate::geometry::{Pose2, PoseCovariance};
use crate::matching::SearchWindow;

/// Earlier keyframes are searched for within this many standard deviations of the drift. From 2 to 4 makes no difference.
const SEARCH_SIGMAS: f64 = 3.0;
/// Maximum search radius, m, and heading range, rad, which limit the work where the drift is unknown.
const MAX_SEARCH: (f64, f64) = (4.0, 0.35);
/// If at least this fraction of the rays agrees at the pose by the path, no other pose is searched.
const SEARCH_BELOW_AGREEMENT: f64 = 0.8;
/// Minimum fraction of rays that must agree.
const MIN_AGREEMENT: f64 = 0.7;
/// Maximum standard deviation of the position for a match to be well constrained, m. Along corridors few are. From 1.5 to 2 cm
/// all logs do equally well; at 1 cm half of the scans of aces find too few loops, at 5 cm the relations of intel are a third
/// worse.
const MAX_POSITION_ERROR: f64 = 0.017;
/// Maximum position correction that is accepted after a single match, m.
const SMALL_DRIFT: f64 = 0.3;
/// Maximum heading correction that is accepted after a single match, rad.
const SMALL_HEADING_DRIFT: f64 = 0.05;
/// Maximum position difference between larger corrections that agree, m.
const MAX_POSITION_DIFFERENCE: f64 = 0.1;
/// Maximum heading difference between larger corrections that agree, rad.
const MAX_HEADING_DIFFERENCE: f64 = 0.0175;
/// Number of consecutive keyframes that must agree on a larger correction.
const MIN_CONSISTENT: usize = 3;

/// A match of a new keyframe to earlier ones.
#[derive(Clone, Copy, Debug)]
pub(super) struct LoopMeasurement {
    /// Pose of the keyframe's laser according to the path.
    pub(super) path_pose: Pose2,
    /// Pose of the keyframe's laser according to the match.
    pub(super) measured_pose: Pose2,
    /// Fraction of the rays that agree with the earlier keyframes.
    pub(super) agreement: f64,
    /// Information matrix of the measured pose, in the map frame; zero along unconstrained directions.
    pub(super) information: Matrix3<f64>,
}

impl LoopMeasurement {
    /// The transform from poses of the path to the measured poses.
    fn correction(&self) -> Pose2 {
        self.measured_pose * self.path_pose.inverse()
    }

    /// Whether the match determines the position, and not only the distance to a wall.
    fn is_well_constrained(&self) -> bool {
        self.information.try_inverse().is_some_and(|known| (known.m11 + known.m22).sqrt() < MAX_POSITION_ERROR)
    }

    /// Fuses path and measurement: the keyframe's pose and its covariance, in the map frame. `drift` is the covariance of the
    /// path's pose relative to the earlier keyframes. If the innovation is larger than it allows, it is inflated (Mehra 1970).
    pub(super) fn fused(&self, drift: &PoseCovariance) -> (Pose2, PoseCovariance) {
        let Pose2 { x, y, theta } = self.path_pose;
        let offset = self.path_pose.difference(&self.measured_pose);
        // I (D I + E)^-1 equals (D + I^-1)^-1, but also exists if I is singular.
        let innovation_information = |drift: &PoseCovariance| {
            let inverse = (drift * self.information + Matrix3::identity()).try_inverse();
            inverse.map_or_else(Matrix3::zeros, |inverse| self.information * inverse)
        };
        let drift = drift * (offset.dot(&(innovation_information(drift) * offset)) / 3.0).max(1.0);
        let gain = drift * innovation_information(&drift);
        let change = gain * offset;
        (Pose2::new(x + change.x, y + change.y, theta + change.z), drift - gain * drift)
    }
}

/// Search window for earlier keyframes. `drift`: covariance of the path's pose relative to them.
pub(super) fn window(drift: &PoseCovariance) -> SearchWindow {
    SearchWindow {
        distance: (SEARCH_SIGMAS * (drift.m11 + drift.m22).sqrt()).min(MAX_SEARCH.0),
        angle: (SEARCH_SIGMAS * drift.m33.sqrt()).min(MAX_SEARCH.1),
        min_agreement: SEARCH_BELOW_AGREEMENT,
    }
}

/// Decides which loop measurements to accept.
#[derive(Clone, Debug, Default)]
pub(super) struct LoopVerifier {
    /// Corrections of the latest keyframes, which agree with each other.
    corrections: Vec<Pose2>,
}

impl LoopVerifier {
    /// The latest keyframe has no loop measurement.
    pub(super) fn reset(&mut self) {
        self.corrections.clear();
    }

    /// Whether to accept the measurement of the next keyframe.
    pub(super) fn accepts(&mut self, measurement: &LoopMeasurement) -> bool {
        if !measurement.is_well_constrained() {
            return false;
        }
        let is_small = measurement.path_pose.is_near(&measurement.measured_pose, SMALL_DRIFT, SMALL_HEADING_DRIFT);
        if measurement.agreement < MIN_AGREEMENT || is_small {
            self.reset();
            return measurement.agreement >= MIN_AGREEMENT;
        }
        let agrees = |other: &Pose2| {
            (*other * measurement.path_pose).is_near(&measurement.measured_pose, MAX_POSITION_DIFFERENCE, MAX_HEADING_DIFFERENCE)
        };
        if !self.corrections.iter().all(agrees) {
            self.reset();
        }
        self.corrections.push(measurement.correction());
        let is_accepted = self.corrections.len() >= MIN_CONSISTENT;
        if is_accepted {
            self.reset();
        }
        is_accepted
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;

    fn measurement(path_length: f64, drift: Pose2) -> LoopMeasurement {
        let path_pose = Pose2::new(path_length, 1.0, 0.3);
        let information = Matrix3::from_diagonal(&Vector3::new(1e4, 1e4, 1e6));
        LoopMeasurement { path_pose, measured_pose: drift * path_pose, agreement: 0.9, information }
    }

    /// The same measurement by a keyframe that saw nothing but a wall along x.
    fn along_wall(measurement: &LoopMeasurement) -> LoopMeasurement {
        LoopMeasurement { information: Matrix3::from_diagonal(&Vector3::new(0.0, 1e4, 1e6)), ..*measurement }
    }

    fn accepted(measurements: impl IntoIterator<Item = LoopMeasurement>) -> Vec<bool> {
        let mut verifier = LoopVerifier::default();
        measurements.into_iter().map(|measurement| verifier.accepts(&measurement)).collect()
    }

    #[test]
    fn the_search_is_as_wide_as_the_drift_is_uncertain() {
        let of = |variances: [f64; 3]| window(&PoseCovariance::from_diagonal(&variances.into()));
        let (narrow, unknown) = (of([0.09, 0.16, 1e-4]), of([1e3, 1e3, 10.0]));
        assert!((narrow.distance - 1.5).abs() < 1e-9 && (narrow.angle - 0.03).abs() < 1e-9, "{narrow:?}");
        assert_eq!((unknown.distance, unknown.angle), MAX_SEARCH);
    }

    #[test]
    fn a_small_drift_is_accepted_at_once() {
        let small = measurement(3.0, Pose2::new(0.1, -0.1, 0.01));
        assert_eq!(accepted([small, LoopMeasurement { agreement: 0.5, ..small }, along_wall(&small)]), [true, false, false]);
    }

    #[test]
    fn a_large_drift_takes_consecutive_keyframes_that_agree() {
        let drift = Pose2::new(1.0, 0.5, 0.03);
        let (right, wrong) =
            (|path_length| measurement(path_length, drift), |path_length| measurement(path_length, Pose2::new(-0.7, 0.0, 0.0)));
        assert_eq!(accepted([right(0.0), right(0.4), right(0.8)]), [false, false, true]);
        assert_eq!(accepted([right(0.0), wrong(0.4), right(0.8), right(1.2), right(1.6)]), [false, false, false, false, true]);
        let measurements = [right(0.0), along_wall(&right(0.4)), right(0.8), right(1.2)];
        assert_eq!(accepted(measurements), [false, false, false, true], "an unconstrained match is no contradiction");
    }

    #[test]
    fn the_correction_is_weighted_by_the_information_of_the_match() {
        let measurement = measurement(3.0, Pose2::new(0.1, -0.1, 0.01));
        let drift = PoseCovariance::from_diagonal(&Vector3::new(0.04, 0.04, 1e-3));
        let (pose, covariance) = measurement.fused(&drift);
        assert!(pose.between(&measurement.measured_pose).distance() < 1e-3 && (covariance.m11 - 1e-4).abs() < 1e-6);
        let (pose, covariance) = along_wall(&measurement).fused(&drift);
        assert!((pose.x - measurement.path_pose.x).abs() < 1e-9 && (pose.y - measurement.measured_pose.y).abs() < 1e-3);
        assert!((covariance.m11 - drift.m11).abs() < 1e-9, "the position along the wall stays unknown");
    }

    #[test]
    fn a_path_that_claims_to_have_drifted_less_gets_an_inflated_covariance() {
        let measurement = measurement(3.0, Pose2::new(0.1, 0.0, 0.0));
        let claimed = PoseCovariance::from_diagonal(&Vector3::repeat(1e-6));
        let (pose, covariance) = measurement.fused(&claimed);
        assert!(pose.x - measurement.path_pose.x > 0.02, "without inflation it would be a millimetre: {pose:?}");
        assert!(covariance.m11 > 10.0 * claimed.m11, "{covariance}");
    }
}
