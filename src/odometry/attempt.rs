//! A scan that is to be matched: what is known of its pose beforehand.

use super::motion_state::MotionState;
use super::placement::Placement;
use super::prediction::Prediction;
use super::uncertainty;
use crate::geometry::{Pose2, PoseCovariance, Twist2};
use crate::matching::{Prior, SearchWindow};
use crate::time::Stamp;

/// The agreement of scans varies by this from one to the next.
pub(super) const USUAL_VARIATION: f64 = 0.05;
/// To either side of a predicted turn so much of it is searched.
const SEARCHED_PART_OF_TURN: f64 = 1.2;

/// The last answer.
#[derive(Clone, Copy, Debug)]
pub(super) struct Last {
    pub(super) stamp: Stamp,
    pub(super) map_from_base: Pose2,
    pub(super) map_from_laser: Pose2,
    pub(super) covariance: PoseCovariance,
    /// The same seen from the keyframe that it was matched to, along the axes of the base.
    pub(super) covariance_to_keyframe: PoseCovariance,
    /// The velocity that led from the answer before to this one.
    pub(super) seen_twist: Twist2,
    /// The same, but of the last step that a robot can have driven. Sweeps are straightened by it: the filter's, which is of the step's
    /// end, overshoots, and a sweep that was straightened by too much makes it overshoot again.
    pub(super) mean_twist: Twist2,
    /// The velocity that is believed in, and what is known of it.
    pub(super) motion: MotionState,
    /// A scan after it could not be matched, and has changed nothing of what the next one starts from.
    pub(super) passed_over: bool,
}

impl Last {
    /// The place of its laser on the base.
    pub(super) fn base_from_laser(&self) -> Pose2 {
        self.map_from_base.between(&self.map_from_laser)
    }
}

/// A scan to be matched.
#[derive(Clone, Copy)]
pub(super) struct Attempt {
    /// The answer before.
    pub(super) last: Last,
    /// Motion of the base since then.
    pub(super) prediction: Prediction,
    /// That motion if the base has gone on as it did.
    pub(super) expected: Prediction,
    /// What odometry says of it, believed or not.
    pub(super) said: Option<Prediction>,
    /// What the IMU says of its turn, believed or not, rad, and the standard deviation.
    pub(super) said_turn: Option<(f64, f64)>,
    /// Odometry that says more of that motion is on its way.
    pub(super) awaits_odometry: bool,
    /// Place of the laser on the base.
    pub(super) base_from_laser: Pose2,
}

impl Attempt {
    /// The predicted pose of the laser in the keyframe's frame. `of_last`: covariance of the last pose there, along the axes of the base.
    pub(super) fn prior(&self, keyframe: &Placement, of_last: &PoseCovariance) -> Prior {
        let none = PoseCovariance::zeros();
        let keyframe_from_last = keyframe.map_from_laser.between(&self.last.map_from_base);
        let Prediction { motion, covariance } = &self.prediction;
        let keyframe_from_base = keyframe_from_last * *motion;
        let of_last = uncertainty::turned(of_last, keyframe_from_last.theta);
        let of_base = uncertainty::compound(&keyframe_from_last, &of_last, motion, covariance);
        Prior {
            pose: keyframe_from_base * self.base_from_laser,
            covariance: uncertainty::compound(&keyframe_from_base, &of_base, &self.base_from_laser, &none),
        }
    }

    /// Where to search, and when: the more the robot has turned, the less is known of how far. Where scans never agree as in a room,
    /// outdoors, less than usual is a sign.
    pub(super) fn window(&self, usual_agreement: f64) -> SearchWindow {
        let (turn, window) = (self.prediction.motion.theta.abs(), SearchWindow::default());
        let less_than_usual = (usual_agreement - USUAL_VARIATION).min(window.doubtful_agreement);
        SearchWindow {
            angle: window.angle.max(SEARCHED_PART_OF_TURN * turn),
            doubtful_agreement: if turn > window.angle { f64::INFINITY } else { less_than_usual },
            ..window
        }
    }

    /// Where the base should be on the map, and how well that is known.
    pub(super) fn predicted_base(&self) -> (Pose2, PoseCovariance) {
        let (last, Prediction { motion, covariance }) = (&self.last, &self.prediction);
        (last.map_from_base * *motion, uncertainty::compound(&last.map_from_base, &last.covariance, motion, covariance))
    }

    /// Where the laser should be.
    pub(super) fn predicted_laser(&self) -> Pose2 {
        self.last.map_from_base * self.prediction.motion * self.base_from_laser
    }
}
