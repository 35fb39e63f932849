//! The problem of matching one scan: the prediction of its pose, and the estimate it starts from.

use super::keyframe_pose::KeyframePose;
use super::prediction::Prediction;
use super::previous_estimate::PreviousEstimate;
use super::scale_error::ScaleJacobian;
use super::uncertainty;
use crate::geometry::{Pose2, PoseCovariance};
use crate::matching::{Prior, SearchWindow};

/// Typical variation of the agreement from one scan to the next.
pub(super) const AGREEMENT_VARIATION: f64 = 0.05;
/// The heading is searched by this many times the predicted rotation to either side.
const SEARCHED_ROTATION_FRACTION: f64 = 1.2;

/// A scan to be matched.
#[derive(Clone, Copy)]
pub(super) struct MatchProblem {
    /// The estimate that the prediction starts from.
    pub(super) previous: PreviousEstimate,
    /// Predicted motion of the base since then.
    pub(super) prediction: Prediction,
    /// The motion predicted at constant velocity.
    pub(super) constant_velocity: Prediction,
    /// The motion measured by odometry, whether accepted or rejected.
    pub(super) odometry: Option<Prediction>,
    /// The rotation measured by the IMU, whether accepted or rejected, rad, and its standard deviation, rad.
    pub(super) imu_rotation: Option<(f64, f64)>,
    /// More odometry of that motion is still to come.
    pub(super) awaits_odometry: bool,
    /// Mounting pose of the laser.
    pub(super) base_from_laser: Pose2,
}

impl MatchProblem {
    /// Prior for the match: the predicted pose of the laser in the keyframe's frame. `previous_covariance` is that of the
    /// previous pose in that frame, along the axes of the base.
    pub(super) fn prior(&self, keyframe: &KeyframePose, previous_covariance: &PoseCovariance) -> Prior {
        let none = PoseCovariance::zeros();
        let keyframe_from_last = keyframe.map_from_laser.between(&self.previous.map_from_base);
        let Prediction { motion, covariance } = &self.prediction;
        let keyframe_from_base = keyframe_from_last * *motion;
        let previous_covariance = uncertainty::rotated(previous_covariance, keyframe_from_last.theta);
        let base_covariance = uncertainty::compound(&keyframe_from_last, &previous_covariance, motion, covariance);
        Prior {
            pose: keyframe_from_base * self.base_from_laser,
            covariance: uncertainty::compound(&keyframe_from_base, &base_covariance, &self.base_from_laser, &none),
        }
    }

    /// Search window around the predicted pose. The larger the predicted rotation, the larger its uncertainty. Outdoors scans
    /// never agree as well as in a room, so the search starts only if the agreement is lower than it typically is.
    pub(super) fn window(&self, typical_agreement: f64) -> SearchWindow {
        let (rotation, window) = (self.prediction.motion.theta.abs(), SearchWindow::default());
        let below_typical = (typical_agreement - AGREEMENT_VARIATION).min(window.min_agreement);
        SearchWindow {
            angle: window.angle.max(SEARCHED_ROTATION_FRACTION * rotation),
            min_agreement: if rotation > window.angle { f64::INFINITY } else { below_typical },
            ..window
        }
    }

    /// Predicted pose of the base on the map, and its covariance by all errors.
    pub(super) fn predicted_base(&self) -> (Pose2, PoseCovariance) {
        (self.predicted_pose(), self.predicted_covariance() + self.predicted_by_scale().covariance())
    }

    /// Predicted pose of the base on the map.
    pub(super) fn predicted_pose(&self) -> Pose2 {
        self.previous.map_from_base * self.prediction.motion
    }

    /// Covariance of that pose by all errors except the scale error of the odometry.
    pub(super) fn predicted_covariance(&self) -> PoseCovariance {
        let (previous, Prediction { motion, covariance }) = (&self.previous, &self.prediction);
        uncertainty::compound(&previous.map_from_base, &previous.covariance, motion, covariance)
    }

    /// How the scale error of the odometry moves the predicted pose of the base.
    pub(super) fn predicted_by_scale(&self) -> ScaleJacobian {
        let (previous, motion) = (&self.previous, &self.prediction.motion);
        let predicted = previous.by_scale.after(motion, previous.map_from_base.theta);
        if self.odometry.is_some() { predicted } else { previous.by_scale }
    }

    /// Predicted pose of the laser on the map.
    pub(super) fn predicted_laser(&self) -> Pose2 {
        self.predicted_pose() * self.base_from_laser
    }
}
