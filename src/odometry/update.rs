//! Updates the state by the estimate of a scan, and turns the estimate into a registration.

use super::keyframes::PendingKeyframe;
use super::motion_state::MotionState;
use super::pose_estimate::PoseEstimate;
use super::previous_estimate::PreviousEstimate;
use super::registration::Registration;
use super::{LaserOdometry, TYPICAL_WEIGHT, uncertainty};
use crate::geometry::{Pose2, PoseCovariance, Twist2};
use crate::scan::Scan;
use crate::time::Stamp;

/// Time constant of the smoothed velocity, s.
const TYPICAL_TWIST_TIME: f64 = 0.1;

impl LaserOdometry {
    /// Updates the state by the estimate of a scan and returns its registration.
    pub(super) fn commit(
        &mut self,
        scan: &Scan,
        base_from_laser: &Pose2,
        estimate: PoseEstimate,
        becomes_keyframe: bool,
    ) -> Registration {
        let (measured_twist, motion, is_continuous) = self.updated_motion(scan.stamp(), &estimate);
        let mean_twist = self.previous.filter(|_| !is_continuous).map_or(measured_twist, |previous| previous.mean_twist);
        let seconds = self.previous.map_or(0.0, |previous| scan.stamp().seconds_since(previous.stamp));
        let weight = if self.typical_period > 0.0 { TYPICAL_WEIGHT } else { 1.0 };
        self.typical_period += weight * (seconds - self.typical_period);
        self.typical_twist = self.typical_twist.interpolate(&motion.twist, (seconds / TYPICAL_TWIST_TIME).clamp(0.0, 1.0));
        let is_lost = estimate.is_lost || !is_continuous;
        let becomes_keyframe = becomes_keyframe || is_lost;
        if becomes_keyframe {
            self.counters.keyframes += 1;
            let pose = estimate.keyframe_pose(base_from_laser);
            self.pending_keyframe = Some(PendingKeyframe { scan: scan.clone(), pose, is_lost });
        }
        self.recent_path.push(scan.stamp(), estimate.map_from_base);
        self.previous = Some(PreviousEstimate {
            map_from_laser: estimate.map_from_base * *base_from_laser,
            by_scale: estimate.by_scale,
            covariance_to_keyframe: if becomes_keyframe { PoseCovariance::zeros() } else { estimate.covariance_to_keyframe },
            measured_twist,
            mean_twist,
            ..PreviousEstimate::new(scan.stamp(), estimate.map_from_base, estimate.covariance, &motion)
        });
        Registration {
            twist: motion.twist,
            twist_covariance: motion.twist_covariance(),
            new_keyframe: becomes_keyframe,
            ..self.registration(estimate)
        }
    }

    /// The velocity measured by the estimate for a scan taken at `stamp`, the updated motion state, and whether the robot can
    /// have reached the pose by driving. A jump of the pose, as when the robot is kidnapped, is not a velocity unless the motion
    /// continues at that velocity.
    fn updated_motion(&self, stamp: Stamp, estimate: &PoseEstimate) -> (Twist2, MotionState, bool) {
        let Some(previous) = self.previous else {
            return (Twist2::default(), MotionState::unknown(&PoseCovariance::zeros()), true);
        };
        let seconds = stamp.seconds_since(previous.stamp);
        let moved = previous.map_from_base.between(&estimate.map_from_base);
        let measured = Twist2::from_motion(&moved, seconds);
        let is_continuous = previous.can_reach(&measured, seconds);
        let predicted = previous.motion.predict(seconds);
        let motion = match &estimate.matched_covariance {
            Some(known) if is_continuous => predicted.updated(&moved, known),
            Some(known) => predicted.kidnapped(known),
            None => predicted.state,
        };
        (measured, motion, is_continuous)
    }

    /// The registration with this estimate, of a robot of unknown velocity.
    pub(super) fn registration(&self, estimate: PoseEstimate) -> Registration {
        let covariance = estimate.covariance + estimate.by_scale.covariance();
        let PoseEstimate { outcome, map_from_base, refinement, predicted_error, estimated_error, .. } = estimate;
        let odom_from_map = self.map_from_odom.inverse();
        Registration {
            outcome,
            odom_from_base: odom_from_map * map_from_base,
            map_from_odom: self.map_from_odom,
            covariance: uncertainty::compound(&odom_from_map, &self.drift_covariance, &map_from_base, &covariance),
            twist: Twist2::default(),
            twist_covariance: PoseCovariance::zeros(),
            refinement,
            predicted_error,
            estimated_error,
            rejected_sources: self.noise.rejected_sources(),
            contradicts_odometry: estimate.contradicts_odometry,
            new_keyframe: false,
        }
    }
}
