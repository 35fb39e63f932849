//! How far scans lag behind the odometry, found along the path.
//!
//! Drivers stamp a message when they send it, up to a second after its content was measured, and for scans and odometry that time
//! differs. While the robot turns, it shows: the odometry has turned as much as the matches did only between the right moments. Squared
//! errors of the odometry's turns are summed up for a grid of lags, clipped, as wheels slip and matches go wrong, and the lag of the
//! least sum is taken where it explains most of what the two differ by.

use std::collections::VecDeque;

use super::uncertainty;
use super::wheel::WheelOdometry;
use crate::geometry::{Pose2, wrap_angle};
use crate::time::Stamp;

/// Between two lags of the grid, s: a car that turns by 3 rad/s is off by no more than the odometry errs anyway.
const STEP: f64 = 0.04;
/// Lags before zero: odometry of that much later is needed for a scan.
const BEFORE: usize = 10;
/// Lags: to a second.
const LAGS: usize = BEFORE + 26;
/// A turn is taken over this time at least, s: scan by scan a fast laser says little.
const SHORTEST: f64 = 0.1;
/// After a longer time the robot has not been seen turning, s.
const LONGEST: f64 = 1.0;
/// An error of so many standard deviations says no more than that something was wrong.
const CLIPPED: f64 = 3.0;
/// What was seen before the robot has turned by this is forgotten, rad: drivers are started again.
const MEMORY: f64 = 60.0;
/// Turns that wait for odometry of later on.
const WAITING: usize = 32;

/// A turn that the matches saw.
#[derive(Clone, Copy, Debug)]
struct Turn {
    from: Stamp,
    to: Stamp,
    motion: Pose2,
}

/// What is known of the lag.
#[derive(Clone, Debug)]
pub(super) struct Lag {
    /// Squares of the normalised errors of each lag, summed up.
    costs: [f64; LAGS],
    seconds: f64,
    start: Option<(Stamp, Pose2)>,
    waiting: VecDeque<Turn>,
}

impl Default for Lag {
    fn default() -> Self {
        Self { costs: [0.0; LAGS], seconds: 0.0, start: None, waiting: VecDeque::with_capacity(WAITING) }
    }
}

impl Lag {
    /// A scan of a stamp shows where the odometry has the robot so much earlier, s.
    pub(super) fn seconds(&self) -> f64 {
        self.seconds
    }

    /// Takes where a match has found the robot, in a frame in which it does not jump.
    pub(super) fn learn(&mut self, stamp: Stamp, pose: Pose2, odometry: &WheelOdometry) {
        let Some((from, before)) = self.start else {
            self.start = Some((stamp, pose));
            return;
        };
        let seconds = stamp.seconds_since(from);
        if (0.0..SHORTEST).contains(&seconds) {
            return;
        }
        self.start = Some((stamp, pose));
        if (SHORTEST..=LONGEST).contains(&seconds) {
            if self.waiting.len() == WAITING {
                self.waiting.pop_front();
            }
            self.waiting.push_back(Turn { from, to: stamp, motion: before.between(&pose) });
        }
        self.compare(odometry);
    }

    /// Compares with the odometry the turns that it has come for, whatever its lag.
    fn compare(&mut self, odometry: &WheelOdometry) {
        let Some(last) = odometry.last_stamp() else { return };
        while let Some(turn) = self.waiting.front().copied()
            && turn.to.offset_by(-lag(0)) <= last
        {
            self.waiting.pop_front();
            self.judge(&turn, odometry);
        }
    }

    fn judge(&mut self, turn: &Turn, odometry: &WheelOdometry) {
        let variance = uncertainty::of_wheels(&turn.motion, turn.to.seconds_since(turn.from)).m33;
        let cost = |i: usize| {
            let motion = odometry.motion(turn.from.offset_by(-lag(i)), turn.to.offset_by(-lag(i)))?;
            let error = wrap_angle(motion.theta - turn.motion.theta);
            Some((error * error / variance).min(CLIPPED * CLIPPED))
        };
        if cost(LAGS - 1).is_none() {
            return;
        }
        let kept = (-turn.motion.theta.abs() / MEMORY).exp();
        for (i, sum) in self.costs.iter_mut().enumerate() {
            *sum = kept * *sum + cost(i).unwrap_or(CLIPPED * CLIPPED);
        }
        self.seconds = self.likeliest();
    }

    /// The likeliest lag, between those of the grid where the parabola through the best three has its lowest point. None, unless one
    /// explains most of what odometry and matches differ by: stamps that jitter make a lag of some hundredths of a second look a little
    /// better, but odometry of other moments than the scans' is worse then than odometry of their own.
    fn likeliest(&self) -> f64 {
        let costs = &self.costs;
        let best = (0..LAGS).min_by(|&a, &b| costs[a].total_cmp(&costs[b])).unwrap_or(BEFORE);
        if costs[BEFORE] < 2.0 * (costs[best] + CLIPPED * CLIPPED) {
            return 0.0;
        }
        if best == 0 || best == LAGS - 1 {
            return lag(best);
        }
        let [left, middle, right] = [costs[best - 1], costs[best], costs[best + 1]];
        let bend = left - 2.0 * middle + right;
        lag(best) + if bend > 0.0 { 0.5 * STEP * (left - right) / bend } else { 0.0 }
    }
}

fn lag(i: usize) -> f64 {
    STEP * (i as f64 - BEFORE as f64)
}

#[cfg(test)]
mod tests {
    use super::super::wheel::WheelSample;
    use super::*;

    /// What is found of a robot whose odometry is stamped `lag` earlier than its scans, when it winds its way for a minute.
    #[allow(clippy::cast_sign_loss)] // a count
    fn found(lag: f64, scan_rate: f64) -> f64 {
        let pose = |seconds: f64| Pose2::new(seconds, 0.0, 0.8 * (0.9 * seconds).sin());
        let mut odometry = WheelOdometry::default();
        let mut known = Lag::default();
        let mut heard = 0;
        for i in 0..(60.0 * scan_rate) as u32 {
            let seconds = 10.0 + f64::from(i) / scan_rate;
            while f64::from(heard) * 0.05 <= seconds {
                let stamp = f64::from(heard) * 0.05;
                odometry.push(WheelSample { stamp: Stamp::from_seconds(stamp), pose: pose(stamp + lag), twist: None });
                heard += 1;
            }
            known.learn(Stamp::from_seconds(seconds), pose(seconds), &odometry);
        }
        known.seconds()
    }

    #[test]
    fn a_lag_is_found_at_any_rate() {
        for lag in [-0.2, 0.0, 0.11, 0.64] {
            for rate in [4.0, 40.0, 200.0] {
                let found = found(lag, rate);
                assert!((found - lag).abs() < 0.02, "{found} s found of {lag} s at {rate} Hz");
            }
        }
    }

    #[test]
    fn a_robot_that_drives_straight_says_nothing_of_it() {
        let mut odometry = WheelOdometry::default();
        let mut known = Lag::default();
        for i in 0..500 {
            let (stamp, pose) = (Stamp::from_seconds(0.1 * f64::from(i)), Pose2::new(0.1 * f64::from(i), 0.0, 0.0));
            odometry.push(WheelSample { stamp, pose, twist: None });
            known.learn(stamp, pose, &odometry);
        }
        assert!(known.seconds().abs() < 1e-9, "{}", known.seconds());
    }
}
