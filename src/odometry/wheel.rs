//! Wheel odometry as the prediction of where the next scan was taken.

use std::collections::VecDeque;

use super::prediction::Prediction;
use super::{source_noise, uncertainty};
use crate::geometry::{Pose2, Twist2};
use crate::time::Stamp;

/// Messages kept: 4 s at 1 kHz, more than the longest lag that is looked for.
const CAPACITY: usize = 4000;
/// Odometry older than this says nothing about a scan, s.
const MAX_EXTRAPOLATION: f64 = 0.5;
/// Of what happened between two messages that are farther apart nothing is known, s: the clock may have been set in between.
const LONGEST_GAP: f64 = 3.0;
/// Over a shorter time than this the velocity is as good as a message, s.
const GOOD_EXTRAPOLATION: f64 = 0.05;
/// A move faster than any robot drives, m/s ...
const MAX_SPEED: f64 = 30.0;
/// ... and farther than odometry is ever rounded is a reset of the odometry, m.
const MAX_JUMP: f64 = 0.5;

/// A velocity that leads this many standard deviations from where the poses lead is of another frame, or wrong.
const CONTRADICTING: f64 = 3.0;

/// One odometry message.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WheelSample {
    /// When it was measured.
    pub stamp: Stamp,
    /// Pose of the base in the wheels' own odometry frame.
    pub pose: Pose2,
    /// Velocity in the base frame, where the message has one.
    pub twist: Option<Twist2>,
}

/// What became of a sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WheelEvent {
    /// It follows on the one before.
    Appended,
    /// It has the stamp of the one before and was left out.
    Duplicate,
    /// Time went back: earlier samples are forgotten.
    TimeJump {
        /// Whether the pose is where it was: the clock was set, and the robot drives on.
        goes_on: bool,
    },
    /// The pose jumped: motions across the jump are not known.
    Reset,
}

/// The last messages of wheel odometry.
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

    /// Forgets everything.
    pub fn clear(&mut self) {
        self.samples.clear();
    }

    /// The stamp of the last message.
    pub fn last_stamp(&self) -> Option<Stamp> {
        self.samples.back().map(|last| last.stamp)
    }

    /// Whether there is odometry, and none yet that says where the base is at `stamp`.
    pub fn is_behind(&self, stamp: Stamp) -> bool {
        self.samples.back().is_some_and(|last| stamp.seconds_since(last.stamp) > GOOD_EXTRAPOLATION)
    }

    /// Whether messages come, and the one that says where the base is at `stamp` has yet to.
    pub fn is_due(&self, stamp: Stamp) -> bool {
        let fresh = self.samples.back().is_some_and(|last| stamp.seconds_since(last.stamp) <= MAX_EXTRAPOLATION);
        fresh && self.is_behind(stamp)
    }

    /// The motion of the base from one time to another, seen from the first; `None` where the messages do not cover it.
    pub fn motion(&self, from: Stamp, to: Stamp) -> Option<Pose2> {
        Some(self.pose_at(from)?.between(&self.pose_at(to)?))
    }

    /// The pose of the base: between messages interpolated; for a while after the last one carried on by its velocity (its own, or that of
    /// the last two).
    pub fn pose_at(&self, stamp: Stamp) -> Option<Pose2> {
        let after = self.samples.partition_point(|sample| sample.stamp < stamp);
        match (after.checked_sub(1).map(|i| self.samples[i]), self.samples.get(after)) {
            (_, Some(after)) if after.stamp == stamp => Some(after.pose),
            (Some(before), Some(after)) => {
                let (since, gap) = (stamp.seconds_since(before.stamp), after.stamp.seconds_since(before.stamp));
                (gap <= LONGEST_GAP).then(|| before.pose.interpolate(&after.pose, since / gap))
            }
            (Some(last), None) => {
                let ahead = stamp.seconds_since(last.stamp);
                (ahead <= MAX_EXTRAPOLATION).then(|| last.pose * self.last_twist().motion(ahead))
            }
            (None, _) => None,
        }
    }

    /// Its own where the poses bear it out: not every driver gives it in the frame of the base.
    fn last_twist(&self) -> Twist2 {
        let Some(last) = self.samples.back() else { return Twist2::default() };
        let is_earlier = |sample: &&WheelSample| last.stamp.seconds_since(sample.stamp) >= GOOD_EXTRAPOLATION;
        let before =
            self.samples.iter().rev().find(is_earlier).or(self.samples.front()).filter(|before| before.stamp < last.stamp);
        let Some(before) = before else { return last.twist.unwrap_or_default() };
        let (moved, seconds) = (before.pose.between(&last.pose), last.stamp.seconds_since(before.stamp));
        let by_poses = Prediction { motion: moved, covariance: uncertainty::of_wheels(&moved, seconds) };
        let is_borne_out = |twist: &Twist2| source_noise::deviation(&by_poses, &twist.motion(seconds)) < CONTRADICTING;
        last.twist.filter(is_borne_out).unwrap_or_else(|| Twist2::of_motion(&moved, seconds))
    }
}

fn classify(last: &WheelSample, sample: &WheelSample) -> WheelEvent {
    let seconds = sample.stamp.seconds_since(last.stamp);
    let distance = last.pose.between(&sample.pose).distance();
    if seconds < 0.0 {
        WheelEvent::TimeJump { goes_on: distance < MAX_JUMP }
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
    fn interpolates_between_messages_and_goes_on_after_the_last() {
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
    fn a_twist_in_the_message_is_better_than_differences_unless_they_contradict_it() {
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
            "the velocity of a camera that looks sideways: {sideways:?}"
        );
    }

    #[test]
    fn duplicates_resets_and_time_jumps_are_told_apart() {
        let mut odometry = WheelOdometry::default();
        odometry.push(sample(1.0, 0.0));
        assert_eq!(odometry.push(sample(1.0, 0.1)), WheelEvent::Duplicate);
        assert_eq!(odometry.push(sample(1.1, 10.0)), WheelEvent::Reset);
        assert_eq!(motion(&odometry, 1.0, 1.1), None, "no motion is known across a reset");
        assert_eq!(odometry.push(sample(0.5, 10.0)), WheelEvent::TimeJump { goes_on: true });
        assert_eq!(odometry.push(sample(0.2, 0.0)), WheelEvent::TimeJump { goes_on: false });
        assert_eq!(odometry.push(sample(3.2, 9.0)), WheelEvent::Appended, "a long way after a long gap is a gap");
    }
}
