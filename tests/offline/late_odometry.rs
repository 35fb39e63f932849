//! Scans that are processed before their odometry has arrived.

use std::sync::Arc;
use std::time::Duration;

use anytime_scan_matcher::anytime::clock::VirtualClock;
use anytime_scan_matcher::app::{App, Estimate, ScanProcessor as _};
use anytime_scan_matcher::config::Config;
use anytime_scan_matcher::geometry::Pose2;
use anytime_scan_matcher::mapping::MotionStatus;
use anytime_scan_matcher::messages::nav_msgs::Odometry;
use anytime_scan_matcher::messages::std_msgs::Header;
use anytime_scan_matcher::time::Stamp;

use crate::common::Laser;

struct Robot {
    app: App,
    laser: Laser,
}

/// A heading change that exceeds the allowed correction but not the search: the match is certain to be rejected, rad.
const TURN: f64 = 0.3;

impl Robot {
    fn new() -> Self {
        let mut config = Config::default();
        config.odometry.max_correction_angle = 0.5 * TURN;
        let app = App::new(&config, Arc::new(VirtualClock::new(Duration::from_micros(10)))).unwrap();
        Self { app, laser: Laser::with_field_of_view(180.0, 181) }
    }

    fn odometry(&mut self, seconds: f64, pose: Pose2) {
        let header = Header { stamp: Stamp::from_seconds(seconds).into(), frame_id: "odom".into(), ..Header::default() };
        let mut message = Odometry { header, child_frame_id: "base_link".into(), ..Odometry::default() };
        message.pose.pose = pose.into();
        self.app.on_odometry(&message).unwrap();
    }

    /// Processes a scan in an endless corridor along x.
    fn scan_in_corridor(&mut self, seconds: f64) -> Estimate {
        let mut message = self.laser.message(Stamp::from_seconds(seconds), Pose2::IDENTITY);
        for (range, direction) in message.ranges.iter_mut().zip(self.laser.geometry().directions()) {
            let distance = 1.5 / direction.y.abs();
            *range = if distance < 12.0 { distance as f32 } else { f32::INFINITY };
        }
        self.app.on_scan(&message, Duration::ZERO)
    }

    fn scan(&mut self, seconds: f64, pose: Pose2) -> Estimate {
        self.app.on_scan(&self.laser.message(Stamp::from_seconds(seconds), pose), Duration::ZERO)
    }
}

/// Long steps, as when scans are lost: odometry measures them, but arrives a little later than the scan.
#[test]
fn a_scan_without_a_match_before_its_odometry_does_no_harm() {
    let turned = |i: u32| Pose2::new(0.0, 0.0, TURN * f64::from(i));
    let mut robot = Robot::new();
    for i in 0..5 {
        robot.odometry(0.1 * f64::from(i), turned(0));
        robot.scan(0.1 * f64::from(i), turned(0));
    }
    let early = robot.scan(1.0, turned(1));
    assert!(!early.registration.outcome.is_ok() && early.motion_status().is_none(), "{:?}", early.registration);
    robot.odometry(1.0, turned(1));
    for i in 1..4 {
        robot.odometry(1.0 + 0.1 * f64::from(i), turned(1));
        let answer = robot.scan(1.0 + 0.1 * f64::from(i), turned(1));
        let error = turned(1).between(&answer.registration.odom_from_base);
        assert!(error.distance() < 0.1 && error.theta.abs() < 0.05, "{i}: {error:?}");
        assert_ne!(answer.motion_status(), Some(MotionStatus::Start));
    }
}

/// If odometry has stopped, or nothing fits although it has arrived, the robot continues from its estimated pose.
#[test]
fn only_one_scan_is_skipped() {
    let mut robot = Robot::new();
    let place = Pose2::IDENTITY;
    for i in 0..5 {
        robot.odometry(0.1 * f64::from(i), place);
        robot.scan(0.1 * f64::from(i), place);
    }
    let elsewhere = Pose2::new(0.0, 0.0, TURN);
    let statuses = [1.0, 1.1].map(|seconds| robot.scan(seconds, elsewhere).motion_status());
    assert_eq!(statuses, [None, Some(MotionStatus::Lost)]);
    assert_eq!(robot.scan(1.2, elsewhere).motion_status(), Some(MotionStatus::Known), "there must be a new keyframe");
}

/// For 0.3 s odometry reports standstill although the robot drives at 4 m/s, and then catches up at once. The corridor does not constrain the
/// motion along it.
#[test]
fn frozen_odometry_inflates_the_covariance() {
    let mut robot = Robot::new();
    for i in 0..80 {
        let seconds = 0.025 * f64::from(i);
        let reported_time = if (40..52).contains(&i) { 0.975 } else { seconds };
        robot.odometry(seconds, Pose2::new(4.0 * reported_time, 0.0, 0.0));
        let found = robot.scan_in_corridor(seconds).registration;
        let (error, sigma) = (found.odom_from_base.x - 4.0 * seconds, found.covariance.m11.sqrt());
        assert!(error.abs() < 3.0 * sigma + 0.01, "{seconds:.3} s: {error:.3} m off, sigma {sigma:.3} m");
    }
}
