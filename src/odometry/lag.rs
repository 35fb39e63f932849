//! Estimates how far scans lag behind the odometry, in seconds.
//!
//! Drivers stamp a message when they send it, up to a second after its content was measured, and that delay differs between scans
//! and odometry. The lag is observable while the robot turns: the rotation by odometry equals that by the matches only at the
//! right lag. The squared rotation errors of the odometry are summed up for a grid of lags. They are clipped, because wheels slip
//! and matches fail. The lag with the smallest sum is accepted if it explains most of the difference between odometry and
//! matches.

use std::collections::VecDeque;

use super::uncertainty;
use super::wheel::WheelOdometry;
use crate::geometry::{Pose2, wrap_angle};
use crate::time::Stamp;

/// Step of the lag grid, s: at 3 rad/s it causes no larger error than odometry has anyway.
const LAG_STEP: f64 = 0.04;
/// Number of negative lags, which need odometry that is newer than the scan.
const NEGATIVE_LAGS: usize = 10;
/// Number of lags, up to a second.
const LAG_COUNT: usize = NEGATIVE_LAGS + 26;
/// Minimum time over which a rotation is compared, s: between the scans of a fast laser it is too small.
const MIN_DURATION: f64 = 0.1;
/// Maximum time over which a rotation is compared, s: the motion in between is unknown.
const MAX_DURATION: f64 = 1.0;
/// Maximum normalized error, in standard deviations; larger errors are outliers and are clipped.
const MAX_ERROR: f64 = 3.0;
/// Rotation after which earlier evidence is forgotten, rad: drivers may be restarted.
const ROTATION_MEMORY: f64 = 60.0;
/// Maximum number of motions that wait for odometry.
const MAX_PENDING: usize = 32;

/// Estimates the lag.
#[derive(Clone, Debug)]
pub(super) struct LagEstimator {
    /// Sum of squared normalized errors for each lag.
    costs: [f64; LAG_COUNT],
    seconds: f64,
    /// Stamp and pose that the next motion starts from.
    start: Option<(Stamp, Pose2)>,
    /// Starts and ends of motions by the matches that wait for odometry: stamp and pose.
    pending: VecDeque<[(Stamp, Pose2); 2]>,
}

impl Default for LagEstimator {
    fn default() -> Self {
        Self { costs: [0.0; LAG_COUNT], seconds: 0.0, start: None, pending: VecDeque::with_capacity(MAX_PENDING) }
    }
}

impl LagEstimator {
    /// The estimated lag, s: a scan shows the robot where the odometry had it this much earlier.
    pub(super) fn seconds(&self) -> f64 {
        self.seconds
    }

    /// Adds the pose of a matched scan, in a frame in which it does not jump.
    pub(super) fn learn(&mut self, stamp: Stamp, pose: Pose2, odometry: &WheelOdometry) {
        let Some((from, before)) = self.start else {
            self.start = Some((stamp, pose));
            return;
        };
        let seconds = stamp.seconds_since(from);
        if (0.0..MIN_DURATION).contains(&seconds) {
            return;
        }
        self.start = Some((stamp, pose));
        if (MIN_DURATION..=MAX_DURATION).contains(&seconds) {
            if self.pending.len() == MAX_PENDING {
                self.pending.pop_front();
            }
            self.pending.push_back([(from, before), (stamp, pose)]);
        }
        self.compare(odometry);
    }

    /// Compares the pending motions for which odometry has arrived at all lags of the grid.
    fn compare(&mut self, odometry: &WheelOdometry) {
        let Some(last) = odometry.last_stamp() else { return };
        while let Some(&[start, end]) = self.pending.front()
            && end.0.offset_by(-lag(0)) <= last
        {
            self.pending.pop_front();
            self.accumulate(start, end, odometry);
        }
    }

    fn accumulate(&mut self, (from, start): (Stamp, Pose2), (to, end): (Stamp, Pose2), odometry: &WheelOdometry) {
        let matched = start.between(&end);
        let variance = uncertainty::wheel_covariance(&matched, to.seconds_since(from)).m33;
        let cost = |i: usize| {
            let motion = odometry.motion(from.offset_by(-lag(i)), to.offset_by(-lag(i)))?;
            let error = wrap_angle(motion.theta - matched.theta);
            Some((error * error / variance).min(MAX_ERROR * MAX_ERROR))
        };
        if cost(LAG_COUNT - 1).is_none() {
            return;
        }
        let decay = (-matched.theta.abs() / ROTATION_MEMORY).exp();
        for (i, sum) in self.costs.iter_mut().enumerate() {
            *sum = decay * *sum + cost(i).unwrap_or(MAX_ERROR * MAX_ERROR);
        }
        self.seconds = self.most_likely_lag();
    }

    /// The lag of the smallest cost, interpolated between grid points by a parabola through the best three. It is 0 unless a lag
    /// explains most of the difference between odometry and matches: with jittering stamps a lag of some hundredths of a second
    /// looks slightly better, but odometry at the wrong time is worse than odometry at the scan's own.
    fn most_likely_lag(&self) -> f64 {
        let costs = &self.costs;
        let best = (0..LAG_COUNT).min_by(|&a, &b| costs[a].total_cmp(&costs[b])).unwrap_or(NEGATIVE_LAGS);
        if costs[NEGATIVE_LAGS] < 2.0 * (costs[best] + MAX_ERROR * MAX_ERROR) {
            return 0.0;
        }
        if best == 0 || best == LAG_COUNT - 1 {
            return lag(best);
        }
        let [left, middle, right] = [costs[best - 1], costs[best], costs[best + 1]];
        let curvature = left - 2.0 * middle + right;
        lag(best) + if curvature > 0.0 { 0.5 * LAG_STEP * (left - right) / curvature } else { 0.0 }
    }
}

fn lag(i: usize) -> f64 {
    LAG_STEP * (i as f64 - NEGATIVE_LAGS as f64)
}

#[cfg(test)]
mod tests {
    use super::super::wheel::WheelSample;
    use super::*;

    /// The lag estimated for a robot that drives in curves for a minute, with odometry stamped `lag` earlier than its scans.
    #[allow(clippy::cast_sign_loss)] // a count
    fn estimated_lag(lag: f64, scan_rate: f64) -> f64 {
        let pose = |seconds: f64| Pose2::new(seconds, 0.0, 0.8 * (0.9 * seconds).sin());
        let mut odometry = WheelOdometry::default();
        let mut estimator = LagEstimator::default();
        let mut sent = 0;
        for i in 0..(60.0 * scan_rate) as u32 {
            let seconds = 10.0 + f64::from(i) / scan_rate;
            while f64::from(sent) * 0.05 <= seconds {
                let stamp = f64::from(sent) * 0.05;
                odometry.push(WheelSample { stamp: Stamp::from_seconds(stamp), pose: pose(stamp + lag), twist: None });
                sent += 1;
            }
            estimator.learn(Stamp::from_seconds(seconds), pose(seconds), &odometry);
        }
        estimator.seconds()
    }

    #[test]
    fn the_lag_is_estimated_at_any_rate() {
        for lag in [-0.2, 0.0, 0.11, 0.64] {
            for rate in [4.0, 40.0, 200.0] {
                let estimated = estimated_lag(lag, rate);
                assert!((estimated - lag).abs() < 0.02, "{estimated} s instead of {lag} s at {rate} Hz");
            }
        }
    }

    #[test]
    fn driving_straight_does_not_reveal_the_lag() {
        let mut odometry = WheelOdometry::default();
        let mut estimator = LagEstimator::default();
        for i in 0..500 {
            let (stamp, pose) = (Stamp::from_seconds(0.1 * f64::from(i)), Pose2::new(0.1 * f64::from(i), 0.0, 0.0));
            odometry.push(WheelSample { stamp, pose, twist: None });
            estimator.learn(stamp, pose, &odometry);
        }
        assert!(estimator.seconds().abs() < 1e-9, "{}", estimator.seconds());
    }
}
