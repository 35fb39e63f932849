//! Wheel odometry: a buffer of messages that is interpolated and extrapolated.

use std::collections::VecDeque;

use super::prediction::Prediction;
use super::source_noise;
use crate::geometry::{Pose2, Twist2};
use crate::time::Stamp;

/// Number of messages kept: 4 s at 1 kHz, more than the longest lag.
const CAPACITY: usize = 4000;
/// Maximum time to extrapolate odometry, s.
const MAX_EXTRAPOLATION: f64 = 0.5;
/// Maximum time between two messages to interpolate, s: over a longer gap the clock may have been set.
const MAX_GAP: f64 = 3.0;
/// Maximum time over which an extrapolation is as good as a message, s.
const RELIABLE_EXTRAPOLATION: f64 = 0.05;
/// Speed above which a jump of the pose is a reset of the odometry, m/s: no robot drives faster.
const MAX_SPEED: f64 = 30.0;
/// Distance above which a jump of the pose is a reset of the odometry, m: no odometry is rounded more coarsely.
const MAX_JUMP: f64 = 0.5;

/// A twist whose motion differs from that of the poses by more standard deviations than this is in another frame, or wrong.
const TWIST_GATE: f64 = 3.0;

/// One odometry message.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WheelSample {
    /// Time of the measurement.
    pub stamp: Stamp,
    /// Pose of the base in the frame of the wheel odometry.
    pub pose: Pose2,
    /// Velocity in the base frame, if the message has one.
    pub twist: Option<Twist2>,
}

/// How a sample was handled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WheelEvent {
    /// It was appended.
    Appended,
    /// It was ignored: its stamp is that of the previous one.
    Duplicate,
    /// Time went back: earlier samples were dropped.
    TimeJump {
        /// The pose continues where it was: the clock was set while the robot drove on.
        is_continuous: bool,
    },
    /// The pose jumped: motions across the jump are unknown.
    Reset,
}

/// The latest messages of wheel odometry.
#[derive(Clone, Debug, Default)]
pub struct WheelOdometry {
    samples: VecDeque<WheelSample>,
}

impl WheelOdometry {
    /// Adds a message.
    pub fn push(&mut self, sample: WheelSample) -> WheelEvent {
        let event = self.samples.back().map_or(WheelEvent::Appended, |last| classify(last, &sample));
        match event {
            WheelEvent::Duplicate => return event,
            WheelEvent::TimeJump { .. } | WheelEvent::Reset => self.samples.clear(),
            WheelEvent::Appended => {}
        }
        if self.samples.len() == CAPACITY {
            self.samples.pop_front();
        }
        self.samples.push_back(sample);
        event
    }

    /// The stamp of the latest message.
    pub fn last_stamp(&self) -> Option<Stamp> {
        self.samples.back().map(|last| last.stamp)
    }

    /// Whether there is odometry, but none yet that covers `stamp`.
    pub fn is_behind(&self, stamp: Stamp) -> bool {
        self.samples.back().is_some_and(|last| stamp.seconds_since(last.stamp) > RELIABLE_EXTRAPOLATION)
    }

    /// Whether messages are arriving, but the one that covers `stamp` has not arrived yet.
    pub fn is_due(&self, stamp: Stamp) -> bool {
        let fresh = self.samples.back().is_some_and(|last| stamp.seconds_since(last.stamp) <= MAX_EXTRAPOLATION);
        fresh && self.is_behind(stamp)
    }

    /// The motion of the base from one time to another, in the frame of the first; `None` if the messages do not cover it.
    pub fn motion(&self, from: Stamp, to: Stamp) -> Option<Pose2> {
        Some(self.pose_at(from)?.between(&self.pose_at(to)?))
    }

    /// The pose of the base: interpolated between messages, and extrapolated for a short time after the latest one.
    pub fn pose_at(&self, stamp: Stamp) -> Option<Pose2> {
        let after = self.samples.partition_point(|sample| sample.stamp < stamp);
        match (after.checked_sub(1).map(|i| self.samples[i]), self.samples.get(after)) {
            (_, Some(after)) if after.stamp == stamp => Some(after.pose),
            (Some(before), Some(after)) => {
                let (since, gap) = (stamp.seconds_since(before.stamp), after.stamp.seconds_since(before.stamp));
                (gap <= MAX_GAP).then(|| before.pose.interpolate(&after.pose, since / gap))
            }
            (Some(last), None) => {
                let ahead = stamp.seconds_since(last.stamp);
                (ahead <= MAX_EXTRAPOLATION).then(|| last.pose * self.last_twist().motion(ahead))
            }
            (None, _) => None,
        }
    }

    /// The twist of the latest message if it agrees with the poses, since not every driver reports it in the base frame;
    /// otherwise the velocity between the latest poses.
    fn last_twist(&self) -> Twist2 {
        let Some(last) = self.samples.back() else { return Twist2::default() };
        let is_earlier = |sample: &&WheelSample| last.stamp.seconds_since(sample.stamp) >= RELIABLE_EXTRAPOLATION;
        let before =
            self.samples.iter().rev().find(is_earlier).or(self.samples.front()).filter(|before| before.stamp < last.stamp);
        let Some(before) = before else { return last.twist.unwrap_or_default() };
        let (moved, seconds) = (before.pose.between(&last.pose), last.stamp.seconds_since(before.stamp));
        let pose_based = Prediction::by_wheels(moved, seconds);
        let is_consistent =
            |twist: &Twist2| source_noise::normalized_innovation(&pose_based, &twist.motion(seconds)) < TWIST_GATE;
        last.twist.filter(is_consistent).unwrap_or_else(|| Twist2::from_motion(&moved, seconds))
    }
}

fn classify(last: &WheelSample, sample: &WheelSample) -> WheelEvent {
    let seconds = sample.stamp.seconds_since(last.stamp);
    let distance = last.pose.between(&sample.pose).distance();
    if seconds < 0.0 {
        WheelEvent::TimeJump { is_continuous: distance < MAX_JUMP }
    } else if seconds == 0.0 {
        WheelEvent::Duplicate
    } else if distance > MAX_JUMP && distance > MAX_SPEED * seconds {
        WheelEvent::Reset
    } else {
        WheelEvent::Appended
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(seconds: f64, x: f64) -> WheelSample {
        WheelSample { stamp: Stamp::from_seconds(seconds), pose: Pose2::new(x, 0.0, 0.0), twist: None }
    }

    fn motion(odometry: &WheelOdometry, from: f64, to: f64) -> Option<f64> {
        odometry.motion(Stamp::from_seconds(from), Stamp::from_seconds(to)).map(|m| m.x)
    }

    #[test]
    fn interpolates_between_messages_and_extrapolates_after_the_last() {
        let mut odometry = WheelOdometry::default();
        for i in 0..5 {
            assert_eq!(odometry.push(sample(f64::from(i) * 0.1, f64::from(i))), WheelEvent::Appended);
        }
        assert!((motion(&odometry, 0.05, 0.25).unwrap() - 2.0).abs() < 1e-9);
        assert!((motion(&odometry, 0.4, 0.45).unwrap() - 0.5).abs() < 1e-9);
        assert_eq!(motion(&odometry, 0.3, 1.0), None, "far behind");
        assert_eq!(motion(&odometry, -0.1, 0.2), None, "before the first message");
    }

    #[test]
    fn the_twist_of_the_message_is_used_unless_the_poses_contradict_it() {
        let ahead = |twist: Twist2| {
            let mut odometry = WheelOdometry::default();
            odometry.push(sample(0.0, 0.0));
            odometry.push(WheelSample { twist: Some(twist), ..sample(0.1, 0.2) });
            odometry.motion(Stamp::from_seconds(0.1), Stamp::from_seconds(0.2)).unwrap()
        };
        assert!((ahead(Twist2 { vx: 2.3, vy: 0.0, omega: 0.0 }).x - 0.23).abs() < 1e-9);
        let sideways = ahead(Twist2 { vx: 0.0, vy: -2.0, omega: 0.0 });
        assert!(
            (sideways.x - 0.2).abs() < 1e-9 && sideways.y.abs() < 1e-9,
            "the velocity of a camera that faces sideways: {sideways:?}"
        );
    }

    #[test]
    fn duplicates_resets_and_time_jumps_are_distinguished() {
        let mut odometry = WheelOdometry::default();
        odometry.push(sample(1.0, 0.0));
        assert_eq!(odometry.push(sample(1.0, 0.1)), WheelEvent::Duplicate);
        assert_eq!(odometry.push(sample(1.1, 10.0)), WheelEvent::Reset);
        assert_eq!(motion(&odometry, 1.0, 1.1), None, "motions across a reset are unknown");
        assert_eq!(odometry.push(sample(0.5, 10.0)), WheelEvent::TimeJump { is_continuous: true });
        assert_eq!(odometry.push(sample(0.2, 0.0)), WheelEvent::TimeJump { is_continuous: false });
        assert_eq!(odometry.push(sample(3.2, 9.0)), WheelEvent::Appended, "a large distance after a long gap is no reset");
    }
}
