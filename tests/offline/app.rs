//! The application with everything that a robot may send it.

use std::sync::Arc;
use std::time::Duration;

use crate::common::{Laser, room_range};
use anytime_scan_matcher::anytime::clock::VirtualClock;
use anytime_scan_matcher::app::{App, Estimate, InputError, MountSource, ScanProcessor as _};
use anytime_scan_matcher::config::Config;
use anytime_scan_matcher::geometry::Pose2;
use anytime_scan_matcher::matching::StopReason;
use anytime_scan_matcher::messages::geometry_msgs::{
    PoseWithCovarianceStamped, Quaternion, Transform, TransformStamped, Twist, Vector3,
};
use anytime_scan_matcher::messages::nav_msgs::Odometry;
use anytime_scan_matcher::messages::own::Contract;
use anytime_scan_matcher::messages::sensor_msgs::{Imu, LaserScan};
use anytime_scan_matcher::messages::std_msgs::Header;
use anytime_scan_matcher::messages::tf2_msgs::TFMessage;
use anytime_scan_matcher::odometry::Outcome;
use anytime_scan_matcher::scan::{ScanConverter, ScanError};
use anytime_scan_matcher::time::Stamp;

const START: f64 = 1000.0;

fn app(assignments: &[&str]) -> App {
    let mut config = Config::default();
    for assignment in assignments {
        config.set_assignment(assignment).unwrap();
    }
    App::new(&config, Arc::new(VirtualClock::new(Duration::from_micros(10)))).unwrap()
}

/// A scan of the room from `laser_pose`, without noise.
fn scan_at(seconds: f64, laser_pose: Pose2) -> LaserScan {
    Laser::with_field_of_view(270.0, 361).message(Stamp::from_seconds(START + seconds), laser_pose)
}

fn odometry_at(seconds: f64, pose: Pose2) -> Odometry {
    let mut message = Odometry::default();
    message.header.stamp = Stamp::from_seconds(START + seconds).into();
    message.pose.pose = pose.into();
    message
}

fn answer(app: &mut App, message: &LaserScan) -> Estimate {
    let mut estimate = app.on_scan(message, Duration::ZERO);
    app.conclude(&mut estimate);
    estimate
}

/// The true pose on a slow arc through the room, relative to its start.
fn true_pose(seconds: f64) -> Pose2 {
    Pose2::new(0.4 * seconds, 0.2 * seconds, 0.3 * seconds)
}

fn assert_near(found: Pose2, expected: Pose2, tolerance: f64) {
    let difference = expected.between(&found);
    assert!(difference.distance() < tolerance && difference.theta.abs() < tolerance, "{found:?}, expected {expected:?}");
}

fn reason(estimate: &Estimate) -> &str {
    match &estimate.registration.outcome {
        Outcome::Predicted(failure) => &failure.text,
        other => panic!("{other:?} is not a prediction"),
    }
}

#[test]
fn scans_alone_give_the_trajectory() {
    let mut app = app(&["odometry.initial_pose=[1, 2, 0.5]"]);
    let start = Pose2::new(1.0, 2.0, 0.5);
    for i in 0..40 {
        let seconds = f64::from(i) * 0.05;
        let estimate = answer(&mut app, &scan_at(seconds, true_pose(seconds)));
        assert!(estimate.registration.outcome.is_ok(), "{i}: {:?}", estimate.registration.outcome);
        assert_near(estimate.registration.odom_from_base, start * true_pose(seconds), 0.01);
        assert_eq!(Stamp::from_seconds(START + seconds), estimate.stamp);
        if i > 2 {
            let twist = estimate.registration.twist;
            assert!((twist.omega - 0.3).abs() < 0.05 && twist.vx.hypot(twist.vy) < 0.6, "{twist:?}");
        }
    }
    assert!(app.odometry_counters().keyframes > 1);
}

#[test]
fn the_laser_pose_on_the_robot_is_used() {
    let mount = Pose2::new(0.3, -0.1, 2.8);
    let mut by_parameter = app(&["odometry.laser_in_base=[0.3, -0.1, 2.8]"]);
    let mut by_transforms = app(&[]);
    let mut transform =
        TransformStamped { child_frame_id: "/laser".into(), transform: mount.into(), ..TransformStamped::default() };
    transform.header.frame_id = "base_link".into();
    by_transforms.on_transforms(&TFMessage { transforms: vec![transform] }).unwrap();
    for i in 0..20 {
        let seconds = f64::from(i) * 0.05;
        for app in [&mut by_parameter, &mut by_transforms] {
            let estimate = answer(app, &scan_at(seconds, true_pose(seconds) * mount));
            assert_near(estimate.registration.odom_from_base, true_pose(seconds), 0.01);
        }
    }
    assert_eq!(by_parameter.mount().1, MountSource::Parameter);
    assert_eq!(by_transforms.mount().1, MountSource::Transforms);
}

#[test]
fn scans_before_the_laser_pose_is_known_do_not_shift_the_pose() {
    let mount = Pose2::new(0.3, -0.1, 0.5);
    let mut app = app(&["odometry.initial_pose=[1, 2, 0.5]"]);
    let start = Pose2::new(1.0, 2.0, 0.5);
    for i in 0..3 {
        assert_near(answer(&mut app, &scan_at(f64::from(i) * 0.05, mount)).registration.odom_from_base, start, 0.002);
    }
    send_transform(&mut app, "base_link", "laser", mount.into());
    for i in 0..60 {
        let seconds = f64::from(i) * 0.05;
        let estimate = answer(&mut app, &scan_at(seconds + 0.15, true_pose(seconds) * mount));
        assert_near(estimate.registration.odom_from_base, start * true_pose(seconds), 0.01);
    }
    assert_eq!(app.take_warnings(), [""; 0], "the laser has not moved");
}

#[test]
fn late_transforms_are_reported() {
    let mut app = app(&[]);
    for seconds in [0.0, 2.0, 4.0] {
        if seconds > 3.0 {
            send_transform(&mut app, "base_link", "laser", Pose2::IDENTITY.into());
        }
        answer(&mut app, &scan_at(seconds, Pose2::IDENTITY));
    }
    assert!(app.take_warnings()[0].starts_with("no transform to the laser 'laser' came for 4.0 s"));
}

/// Sends the transform of `child` on `parent` by tf.
fn send_transform(app: &mut App, parent: &str, child: &str, transform: Transform) {
    let mut transform = TransformStamped { child_frame_id: child.into(), transform, ..TransformStamped::default() };
    transform.header.frame_id = parent.into();
    app.on_transforms(&TFMessage { transforms: vec![transform] }).unwrap();
}

#[test]
fn a_panning_laser_is_followed() {
    let mut app = app(&[]);
    for i in 0..60 {
        let seconds = f64::from(i) * 0.05;
        let mount = Pose2::new(0.2, 0.1, 0.6 * (2.0 * seconds).sin());
        send_transform(&mut app, "base_link", "laser", mount.into());
        let estimate = answer(&mut app, &scan_at(seconds, true_pose(seconds) * mount));
        assert_near(estimate.registration.odom_from_base, true_pose(seconds), 0.01);
    }
    assert!(
        app.take_warnings().iter().any(|remark| remark.contains("used as published")),
        "the mount moves by up to 3 degrees from scan to scan"
    );
}

/// One laser faces forward, one backward; their views do not overlap.
#[test]
fn two_lasers_back_to_back_alternate_on_one_topic() {
    let mut app = app(&[]);
    let mounts = [("front", Pose2::new(0.3, 0.0, 0.0)), ("rear", Pose2::new(-0.2, 0.1, 3.1))];
    for (frame, mount) in mounts {
        send_transform(&mut app, "base_link", frame, mount.into());
    }
    for i in 0..120 {
        let seconds = f64::from(i) * 0.025;
        let (frame, mount) = mounts[usize::from(i % 2 == 1)];
        app.on_odometry(&odometry_at(seconds, true_pose(seconds))).unwrap();
        let laser = Laser::with_field_of_view(170.0, 171);
        let mut message = laser.message(Stamp::from_seconds(START + seconds), true_pose(seconds) * mount);
        message.header.frame_id = frame.into();
        let estimate = answer(&mut app, &message);
        assert_eq!(estimate.registration.outcome.is_ok(), i != 1, "{i}: {:?}", estimate.registration.outcome);
        assert_near(estimate.registration.odom_from_base, true_pose(seconds), 0.02);
    }
    assert!(app.odometry_counters().keyframes < 20, "{} keyframes", app.odometry_counters().keyframes);
}

#[test]
fn rolling_and_pitching_keeps_the_keyframes() {
    let mut app = app(&["base_frame=base_footprint"]);
    send_transform(&mut app, "base_link", "laser", Pose2::new(0.2, 0.0, 0.0).into());
    for i in 0..60 {
        let seconds = f64::from(i) * 0.05;
        let (roll, pitch) = (0.03 * (9.0 * seconds).sin(), 0.03 * (7.0 * seconds).cos());
        let rotation = Quaternion { x: 0.5 * roll, y: 0.5 * pitch, z: 0.0, w: 1.0 };
        send_transform(&mut app, "base_footprint", "base_link", Transform { rotation, ..Transform::default() });
        let estimate = answer(&mut app, &scan_at(seconds, true_pose(seconds) * Pose2::new(0.2, 0.0, 0.0)));
        assert!(i == 0 || estimate.registration.outcome == Outcome::Matched, "{:?}", estimate.registration.outcome);
        assert_near(estimate.registration.odom_from_base, true_pose(seconds), 0.01);
    }
    assert!(app.odometry_counters().keyframes < 12, "{:?}", app.odometry_counters());
}

#[test]
fn a_mount_that_jumps_is_reported() {
    let mut app = app(&[]);
    for i in 0..20 {
        let seconds = f64::from(i) * 0.05;
        let mount = if i < 10 { Pose2::new(0.2, 0.0, 0.0) } else { Pose2::new(0.5, 0.0, 0.0) };
        send_transform(&mut app, "base_link", "laser", mount.into());
        let estimate = answer(&mut app, &scan_at(seconds, true_pose(seconds) * mount));
        assert_near(estimate.registration.odom_from_base, true_pose(seconds), 0.01);
    }
    let remarks = app.take_warnings();
    assert!(remarks.iter().any(|remark| remark.contains("moved on the base by 0.300 m")), "{remarks:?}");
}

/// An application whose laser is upside down: by tf (half a turn about x) or not, as `by_tf` says.
fn with_upside_down_laser(parameter: &[&str], by_tf: bool) -> App {
    let mut app = app(parameter);
    let upside_down = Transform { rotation: Quaternion { x: 1.0, y: 0.0, z: 0.0, w: 0.0 }, ..Transform::default() };
    if by_tf {
        send_transform(&mut app, "base_link", "laser", upside_down);
    }
    app
}

#[test]
fn an_upside_down_laser_sees_the_same() {
    let by_parameter = ["odometry.laser_in_base=[0, 0, 0, 3.1416]"];
    let place_alone = ["odometry.laser_in_base=[0, 0, 0]"];
    let ways: [(&[&str], bool); 4] = [(&[], true), (&place_alone, true), (&by_parameter, false), (&by_parameter, true)];
    for (parameter, by_tf) in ways {
        let mut app = with_upside_down_laser(parameter, by_tf);
        for i in 0..20 {
            let seconds = f64::from(i) * 0.05;
            let mut message = scan_at(seconds, true_pose(seconds));
            message.ranges.reverse();
            assert_near(answer(&mut app, &message).registration.odom_from_base, true_pose(seconds), 0.01);
        }
        assert!(app.mount().0.upside_down, "{parameter:?}, tf: {by_tf}");
    }
    assert!(!{
        let mut upright = with_upside_down_laser(&["odometry.laser_in_base=[0, 0, 0, 0]"], true);
        answer(&mut upright, &scan_at(0.0, true_pose(0.0)));
        upright.mount().0.upside_down
    });
}

#[test]
fn a_laser_on_edge_by_its_parameter_is_reported() {
    let mut app = app(&["odometry.laser_in_base=[0, 0, 0, 1.57]"]);
    let estimate = answer(&mut app, &scan_at(0.0, true_pose(0.0)));
    assert!(reason(&estimate).contains("the roll in odometry.laser_in_base"), "{}", reason(&estimate));
}

#[test]
fn a_scan_that_matches_nothing_is_answered_with_the_prediction_and_does_not_freeze_the_keyframe() {
    let mut app = app(&[]);
    for i in 0..10 {
        let seconds = f64::from(i) * 0.1;
        app.on_odometry(&odometry_at(seconds, true_pose(seconds))).unwrap();
        // From the sixth scan on the robot is in another room.
        let jump = if i < 5 { Pose2::IDENTITY } else { Pose2::new(-2.5, -1.5, 1.5) };
        let estimate = answer(&mut app, &scan_at(seconds, jump * true_pose(seconds)));
        assert_near(estimate.registration.odom_from_base, true_pose(seconds), 0.02);
        assert_eq!(estimate.registration.outcome.is_ok(), i != 5, "{i}: {:?}", estimate.registration.outcome);
        if i == 5 {
            assert!(
                reason(&estimate).contains("too few correspondences") || reason(&estimate).contains("corrects"),
                "{}",
                reason(&estimate)
            );
            assert!(estimate.registration.estimated_error.translation > 0.01);
        }
    }
    assert_eq!(app.odometry_counters().predicted, 1);
}

#[test]
fn odometry_is_interpolated_extrapolated_and_optional() {
    let fast = |seconds: f64| Pose2::new(2.0 * seconds - 1.0, 0.0, 0.0);
    let guess_error = |stamps: &[f64]| {
        // A single classic iteration shows the initial guess.
        let mut app = app(&["matching.correspondence=jump_table", "matching.max_iterations=1"]);
        for &seconds in stamps {
            app.on_odometry(&odometry_at(seconds, fast(seconds))).unwrap();
        }
        answer(&mut app, &scan_at(0.0, fast(0.0)));
        let estimate = answer(&mut app, &scan_at(0.3, fast(0.3)));
        fast(0.0).between(&fast(0.3)).between(&estimate.registration.odom_from_base).distance()
    };
    assert!(guess_error(&[0.0, 0.1, 0.2, 0.4]) < 0.01, "interpolated");
    assert!(guess_error(&[-0.1, 0.0, 0.1]) < 0.01, "extrapolated");
    assert!(guess_error(&[]) > 0.05, "without odometry a first step of 0.6 m cannot be predicted");
}

/// The pose of a robot that suddenly turns from rest.
fn turn_at_once(seconds: f64) -> Pose2 {
    Pose2::new(0.0, 0.0, if seconds < 0.1 { 0.0 } else { 0.35 })
}

fn imu_at(seconds: f64) -> Imu {
    let mut message = Imu::default();
    message.header.stamp = Stamp::from_seconds(START + seconds).into();
    message.orientation = Quaternion::from_yaw(2.0 + turn_at_once(seconds).theta);
    message
}

#[test]
fn an_imu_predicts_rotations() {
    let error_of = |with_imu: bool| {
        // A single classic iteration shows the initial guess.
        let mut app = app(&["matching.correspondence=jump_table", "matching.max_iterations=1"]);
        for seconds in [0.0, 0.05, 0.1, 0.2] {
            if with_imu {
                app.on_imu(&imu_at(seconds)).unwrap();
            }
        }
        answer(&mut app, &scan_at(0.0, turn_at_once(0.0)));
        let registration = answer(&mut app, &scan_at(0.15, turn_at_once(0.15))).registration;
        ((registration.odom_from_base.theta - 0.35).abs(), registration.predicted_error.rotation)
    };
    let ((with, predicted_with), (without, predicted_without)) = (error_of(true), error_of(false));
    assert!(with < 0.005 && without > 0.02, "{with} {without}");
    assert!(predicted_with < 0.5 * predicted_without, "{predicted_with} {predicted_without}");
}

#[test]
fn an_upside_down_imu_is_corrected_and_an_empty_one_is_ignored() {
    let mut app = app(&["matching.correspondence=jump_table", "matching.max_iterations=1"]);
    let mut transform = TransformStamped { child_frame_id: "imu".into(), ..TransformStamped::default() };
    transform.header.frame_id = "base_link".into();
    transform.transform.rotation.x = 1.0;
    app.on_transforms(&TFMessage { transforms: vec![transform] }).unwrap();
    for i in 0..=20 {
        let mut message = imu_at(f64::from(i) * 0.01);
        message.orientation = Quaternion::default();
        message.header.frame_id = "imu".into();
        message.angular_velocity.z = -3.5;
        app.on_imu(&message).unwrap();
        app.on_imu(&Imu { header: message.header, ..Imu::default() }).unwrap();
    }
    answer(&mut app, &scan_at(0.0, Pose2::IDENTITY));
    let registration = answer(&mut app, &scan_at(0.1, Pose2::new(0.0, 0.0, 0.35))).registration;
    assert!((registration.odom_from_base.theta - 0.35).abs() < 0.005, "{registration:?}");
    let mut spoilt = imu_at(0.3);
    spoilt.angular_velocity.x = f64::INFINITY;
    assert_eq!(app.on_imu(&spoilt), Err(InputError::VelocityNotFinite));
    assert_eq!(app.counters().refused_messages, 1);
}

#[test]
fn other_nodes_transforms_and_velocities_predict() {
    let fast = |seconds: f64| Pose2::new(2.0 * seconds - 1.0, 0.0, 0.0);
    let guess_error = |prepare: &dyn Fn(&mut App)| {
        let settings = ["matching.correspondence=jump_table", "matching.max_iterations=1", "prediction_frame=wheels"];
        let mut app = app(&settings);
        answer(&mut app, &scan_at(0.0, fast(0.0)));
        prepare(&mut app);
        let estimate = answer(&mut app, &scan_at(0.3, fast(0.3)));
        fast(0.0).between(&fast(0.3)).between(&estimate.registration.odom_from_base).distance()
    };
    let stamped = |seconds: f64, parent: &str, child: &str, pose: Pose2| {
        let mut transform =
            TransformStamped { child_frame_id: child.into(), transform: pose.into(), ..TransformStamped::default() };
        transform.header.frame_id = parent.into();
        transform.header.stamp = Stamp::from_seconds(START + seconds).into();
        TFMessage { transforms: vec![transform] }
    };
    let by_transforms = |app: &mut App| {
        app.on_transforms(&stamped(0.0, "footprint", "base_link", Pose2::new(0.1, 0.0, 0.0))).unwrap();
        for i in 0..5 {
            let seconds = f64::from(i) * 0.1;
            app.on_transforms(&stamped(seconds, "/wheels", "/footprint", fast(seconds))).unwrap();
        }
    };
    let by_velocity =
        |app: &mut App| app.on_velocity(&Twist { linear: Vector3 { x: 2.0, ..Vector3::default() }, ..Twist::default() }).unwrap();
    assert!(guess_error(&by_transforms) < 0.01 && guess_error(&by_velocity) < 0.01);
    assert!(guess_error(&|_| ()) > 0.05, "without either, a first step of 0.6 m cannot be predicted");
}

#[test]
fn scans_wait_for_odometry_only_while_it_arrives() {
    let mut app = app(&["odometry.laser_in_base=[0, 0, 0]"]);
    let wait = |app: &App, seconds| app.wait_for_inputs(&header_at(seconds));
    assert_eq!(wait(&app, 0.0), None, "there is no odometry");
    answer(&mut app, &scan_at(0.0, true_pose(0.0)));
    app.on_odometry(&odometry_at(0.0, true_pose(0.0))).unwrap();
    assert_eq!(wait(&app, 0.04), None, "close enough to extrapolate");
    assert_eq!(wait(&app, 0.2), Some(Duration::from_millis(300)));
    app.on_contract(&contract(0, 10_000_000)).unwrap();
    assert_eq!(wait(&app, 0.2), Some(Duration::from_millis(5)), "never beyond the budget");
    answer(&mut app, &scan_at(0.2, true_pose(0.2)));
    assert_eq!(wait(&app, 0.4), None, "the last wait timed out");
    app.on_odometry(&odometry_at(0.2, true_pose(0.2))).unwrap();
    assert!(wait(&app, 0.4).is_some());
}

#[test]
fn the_first_scan_waits_for_the_pose_of_its_laser() {
    let wait = |app: &App| app.wait_for_inputs(&header_at(0.0));
    let mut known = app(&[]);
    assert_eq!(wait(&known), Some(Duration::from_millis(300)));
    send_transform(&mut known, "base_link", "laser", Pose2::new(0.3, 0.0, 0.0).into());
    assert_eq!(wait(&known), None);
    let mut unknown = app(&[]);
    answer(&mut unknown, &scan_at(0.0, true_pose(0.0)));
    assert_eq!(wait(&unknown), None, "once is enough: there may never be one");
}

/// The header of a scan.
fn header_at(seconds: f64) -> Header {
    scan_at(seconds, Pose2::IDENTITY).header
}

fn contract(sec: i32, nsec: i32) -> Contract {
    Contract { time_budget: anytime_scan_matcher::messages::Duration { sec, nsec }, ..Contract::default() }
}

#[test]
fn contracts_apply_from_the_next_scan_on_and_invalid_ones_are_rejected() {
    // With bounds of zero the refinement ends only by a cycle.
    let mut app = app(&["matching.epsilon_translation=0", "matching.epsilon_rotation=0"]);
    answer(&mut app, &scan_at(0.0, true_pose(0.0)));
    app.on_contract(&contract(0, 25_000)).unwrap();
    let estimate = answer(&mut app, &scan_at(0.1, true_pose(0.1)));
    assert_eq!(estimate.contract.time_budget, Some(Duration::from_micros(25)));
    assert_eq!(estimate.registration.refinement.unwrap().stop_reason, StopReason::Budget);
    assert!(!estimate.deadline_met(), "the clock advances by 10 us per reading: {:?}", estimate.elapsed);
    assert!(matches!(app.on_contract(&contract(-1, 0)), Err(InputError::Contract(_))));
    assert_eq!(app.contract().time_budget, Some(Duration::from_micros(25)));
    app.on_contract(&Contract { translation_error_bound: 1.0, ..contract(0, 0) }).unwrap();
    answer(&mut app, &scan_at(0.15, true_pose(0.15)));
    let estimate = answer(&mut app, &scan_at(0.2, true_pose(0.2)));
    assert_eq!(estimate.registration.refinement.unwrap().stop_reason, StopReason::ErrorBound);
    // A microsecond is too short for any work: the answer is the prediction, and is marked as such.
    app.on_contract(&contract(0, 1000)).unwrap();
    let estimate = answer(&mut app, &scan_at(0.25, true_pose(0.25)));
    assert!(reason(&estimate).contains("time budget"), "{}", reason(&estimate));
    assert_eq!(app.counters().deadline_misses, 2);
}

#[test]
fn stamps_may_repeat_go_back_and_leave_gaps() {
    let mut app = app(&[]);
    for i in 0..5 {
        answer(&mut app, &scan_at(2.0 + f64::from(i) * 0.1, true_pose(f64::from(i) * 0.1)));
    }
    let before = answer(&mut app, &scan_at(2.5, true_pose(0.5)));
    let again = answer(&mut app, &scan_at(2.5, true_pose(0.6)));
    assert!(reason(&again).contains("the answer is repeated"));
    assert_eq!(again.registration.odom_from_base, before.registration.odom_from_base);
    let late = answer(&mut app, &scan_at(2.3, true_pose(0.3)));
    assert!(reason(&late).contains("out of order"));
    // After a gap matching continues from the last pose.
    let later = answer(&mut app, &scan_at(7.0, true_pose(0.6)));
    assert!(later.registration.outcome.is_ok());
    assert_near(later.registration.odom_from_base, true_pose(0.6), 0.02);
    // A bag that starts again begins a new run.
    let new_run = answer(&mut app, &scan_at(2.1, true_pose(3.0)));
    assert_eq!(new_run.registration.outcome, Outcome::First);
    assert_eq!(new_run.registration.odom_from_base, Pose2::IDENTITY);
    let counters = app.odometry_counters();
    assert_eq!((counters.duplicate_scans, counters.out_of_order_scans, counters.time_jumps), (1, 1, 1));
    assert_eq!(app.counters().scans, 10);
}

/// The error of the last pose if the clock is set by `step` seconds during the drive, m.
fn error_after_clock_step(step: f64, with_odometry: bool) -> f64 {
    let mut app = app(&[]);
    let round = |seconds: f64| {
        let (sin, cos) = (0.4 * seconds).sin_cos();
        Pose2::new(0.6 * sin, 0.6 * (1.0 - cos), 0.4 * seconds)
    };
    let set = |seconds: f64| if seconds > 3.0 { seconds + step } else { seconds };
    let mut off = f64::INFINITY;
    for seconds in (0..240).map(|i| f64::from(i) * 0.025) {
        if with_odometry {
            app.on_odometry(&odometry_at(set(seconds), round(seconds))).unwrap();
        }
        let estimate = answer(&mut app, &scan_at(set(seconds), round(seconds)));
        off = estimate.registration.odom_from_base.between(&round(seconds)).distance();
    }
    assert_eq!(app.odometry_counters().time_jumps, 0, "set by {step} s");
    off
}

#[test]
fn setting_the_clock_does_not_move_the_robot() {
    for step in [-0.05, -0.6, -0.9, -1.5, -2.0, 0.6, 0.9, 1.5, 100.0] {
        for with_odometry in [true, false] {
            let off = error_after_clock_step(step, with_odometry);
            assert!(off < 0.01, "set by {step} s, odometry: {with_odometry}: {off} m");
        }
    }
    for step in [-60.0, -900.0] {
        let off = error_after_clock_step(step, true);
        assert!(off < 0.01, "set to before the beginning, by {step} s: {off} m");
    }
}

#[test]
fn invalid_poses_are_rejected() {
    let mut app = app(&[]);
    let mut nan = odometry_at(0.0, true_pose(0.0));
    nan.pose.pose.position.x = f64::NAN;
    assert_eq!(app.on_odometry(&nan), Err(InputError::PoseNotFinite));
    let mut zero = odometry_at(0.0, true_pose(0.0));
    zero.pose.pose.orientation = Quaternion::default();
    assert!(matches!(app.on_odometry(&zero), Err(InputError::QuaternionNotNormalized { .. })));
    let mut initial = PoseWithCovarianceStamped::default();
    initial.pose.pose.orientation.w = f64::INFINITY;
    assert_eq!(app.on_initial_pose(&initial, Duration::ZERO), Err(InputError::PoseNotFinite));
    let transform = TransformStamped { child_frame_id: "laser".into(), ..TransformStamped::default() };
    assert_eq!(app.on_transforms(&TFMessage { transforms: vec![transform] }), Err(InputError::BadTransforms { count: 1 }));
    assert_eq!(app.counters().refused_messages, 4);
    // None of these has an effect.
    let mut nan_twist = odometry_at(0.0, true_pose(0.0));
    nan_twist.twist.twist.linear.x = f64::NAN;
    app.on_odometry(&nan_twist).unwrap();
    for i in 0..5 {
        let seconds = f64::from(i) * 0.1;
        let estimate = answer(&mut app, &scan_at(seconds, true_pose(seconds)));
        assert_near(estimate.registration.odom_from_base, true_pose(seconds), 0.01);
    }
}

#[test]
fn an_initial_pose_and_a_reset_start_a_new_run() {
    let mut app = app(&[]);
    for i in 0..5 {
        answer(&mut app, &scan_at(f64::from(i) * 0.1, true_pose(f64::from(i) * 0.1)));
    }
    let mut initial = PoseWithCovarianceStamped::default();
    initial.pose.pose = Pose2::new(5.0, 6.0, 1.0).into();
    app.on_initial_pose(&initial, Duration::ZERO).unwrap();
    let estimate = answer(&mut app, &scan_at(0.6, true_pose(0.6)));
    assert_eq!(estimate.registration.outcome, Outcome::First);
    assert_near(estimate.registration.odom_from_base, Pose2::new(5.0, 6.0, 1.0), 1e-9);
    app.reset();
    let estimate = answer(&mut app, &scan_at(0.7, true_pose(0.7)));
    assert_eq!(estimate.registration.odom_from_base, Pose2::IDENTITY);
}

#[test]
fn the_source_that_matches_contradict_is_reported() {
    for (backwards, expected) in [((true, false), vec!["odometry"]), ((false, true), vec!["imu"]), ((false, false), vec![])] {
        let mut app = app(&[]);
        let mut named = Vec::new();
        for i in 0..12 {
            let seconds = f64::from(i) * 0.1;
            app.on_odometry(&odometry_at(seconds, true_pose(if backwards.0 { -seconds } else { seconds }))).unwrap();
            let mut imu = Imu::default();
            imu.header.stamp = Stamp::from_seconds(START + seconds).into();
            imu.angular_velocity.z = if backwards.1 { -0.3 } else { 0.3 };
            app.on_imu(&imu).unwrap();
            named = answer(&mut app, &scan_at(seconds, true_pose(seconds))).registration.rejected_sources.names().collect();
        }
        assert_eq!(named, expected, "{backwards:?}");
    }
}

/// Turns a good scan into a malformed one.
type Spoil = fn(&mut LaserScan);

/// Most rays hit a cover that moves with the laser, the others see the room: the matches claim that the robot stands still, which is reported.
#[test]
fn a_cover_with_slots_is_reported_to_contradict_the_odometry() {
    let along = |seconds: f64| Pose2::new(0.4 * seconds, 0.0, 0.0);
    for is_covered in [true, false] {
        let mut app = app(&[]);
        let mut contradictions = 0;
        for i in 0..60 {
            let seconds = f64::from(i) * 0.05;
            app.on_odometry(&odometry_at(seconds, along(seconds))).unwrap();
            let mut message = scan_at(seconds, along(seconds));
            let rays = message.ranges.iter_mut().enumerate();
            rays.filter(|(ray, _)| is_covered && ray % 90 > 18).for_each(|(_, range)| *range = 0.12);
            contradictions += usize::from(answer(&mut app, &message).registration.contradicts_odometry);
        }
        assert_eq!(contradictions > 30, is_covered, "{contradictions} contradictions");
        assert_eq!(app.odometry_counters().in_words().any(|words| words.contains("contradict the odometry")), is_covered);
    }
}

#[test]
fn malformed_scans_are_reported_and_answered() {
    let mut app = app(&[]);
    for i in 0..3 {
        answer(&mut app, &scan_at(f64::from(i) * 0.1, true_pose(f64::from(i) * 0.1)));
    }
    let spoils: [(&str, Spoil); 9] = [
        ("angle_increment is 0", |s| s.angle_increment = 0.0),
        ("angle_min is NaN", |s| s.angle_min = f32::NAN),
        ("range_min is inf", |s| s.range_min = f32::INFINITY),
        ("0 ranges", |s| s.ranges.clear()),
        ("5 ranges", |s| s.ranges.truncate(5)),
        ("1000000 ranges", |s| s.ranges.resize(1_000_000, 1.0)),
        ("more than a full turn", |s| {
            s.angle_increment = 0.1;
            s.angle_max = s.angle_min + 36.0;
        }),
        ("leave no range valid", |s| s.range_max = 0.01),
        ("0 of 361 rays", |s| s.ranges.fill(f32::NAN)),
    ];
    for (i, (text, spoil)) in spoils.iter().enumerate() {
        let seconds = 0.3 + i as f64 * 0.1;
        let mut message = scan_at(seconds, true_pose(seconds));
        spoil(&mut message);
        let estimate = answer(&mut app, &message);
        assert!(reason(&estimate).contains("malformed scan") && reason(&estimate).contains(text), "{}", reason(&estimate));
        assert!(estimate.registration.odom_from_base.is_finite());
    }
    assert_eq!(app.counters().malformed_scans, 9);
    let estimate = answer(&mut app, &scan_at(0.35, true_pose(0.3)));
    assert!(estimate.registration.outcome.is_ok(), "the next good scan must be matched: {:?}", estimate.registration.outcome);
}

#[test]
fn errors_in_unneeded_fields_are_reported_once_and_reject_no_scan() {
    let mut app = app(&[]);
    let oddities: [(&str, Spoil); 5] = [
        ("300 ranges, but angle_min", |s| s.ranges.truncate(300)),
        ("361 ranges but 7 intensities", |s| s.intensities = vec![1.0; 7]),
        ("scan_time is NaN", |s| s.scan_time = f32::NAN),
        ("time_increment is inf", |s| s.time_increment = f32::INFINITY),
        ("have a range of about 8.00 m", |s| {
            s.ranges.iter_mut().filter(|range| **range > 4.5).for_each(|range| *range = 8.0);
        }),
    ];
    answer(&mut app, &scan_at(0.0, true_pose(0.0)));
    for (i, (text, spoil)) in oddities.iter().enumerate() {
        for half in [0.0, 0.05] {
            let seconds = 0.1 + i as f64 * 0.1 + half;
            let mut message = scan_at(seconds, true_pose(seconds));
            spoil(&mut message);
            let estimate = answer(&mut app, &message);
            assert!(estimate.registration.outcome.is_ok(), "{text}: {:?}", estimate.registration.outcome);
            let remarks = app.take_warnings();
            let expected = usize::from(half == 0.0);
            assert_eq!(remarks.iter().filter(|remark| remark.contains(text)).count(), expected, "{text}: {remarks:?}");
        }
    }
}

/// A laser begins a sweep after the previous one has ended.
#[test]
fn a_sweep_cannot_take_longer_than_the_scan_period() {
    for (sweep, is_accepted) in [(0.045, true), (0.05, true), (0.2, false), (0.9, false)] {
        let mut converter = ScanConverter::default();
        let mut accepted = 0;
        for i in 0..20 {
            let seconds = f64::from(i) * 0.05;
            let mut message = scan_at(seconds, true_pose(seconds));
            message.time_increment = sweep / message.ranges.len() as f32;
            accepted += usize::from(converter.convert(&message, false).unwrap().sweep_duration() > 0.0);
        }
        assert_eq!(accepted == 20, is_accepted, "{sweep} s: {accepted} of 20");
        assert!(is_accepted || accepted <= 3, "{sweep} s: {accepted} of 20");
        let reported = converter.take_warnings().iter().any(|oddity| oddity.to_string().contains("a sweep cannot take"));
        assert_ne!(reported, is_accepted, "{sweep} s");
    }
}

#[test]
fn rays_without_a_return_keep_their_index() {
    let mut message = scan_at(0.0, Pose2::IDENTITY);
    for (i, value) in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 0.0, -1.0, 0.01, 31.0].into_iter().enumerate() {
        message.ranges[10 * i] = value;
    }
    let scan = ScanConverter::default().convert(&message, false).unwrap();
    assert_eq!((scan.len(), scan.valid_len()), (361, 354));
    for i in 0..7 {
        assert_eq!(scan.point(10 * i), None);
        assert!(scan.point(10 * i + 1).is_some());
    }
    message.range_max = f32::INFINITY;
    assert_eq!(ScanConverter::default().convert(&message, false).unwrap().valid_len(), 355, "without an upper limit");
    message.ranges.fill(f32::NAN);
    assert_eq!(ScanConverter::default().convert(&message, false).unwrap_err(), ScanError::TooFewValid { valid: 0, beams: 361 });
}

/// Two lasers that alternate on one topic, a changing geometry, 10 to 10 000 beams.
#[test]
fn the_geometry_may_change_from_scan_to_scan() {
    let mut app = app(&[]);
    for (i, beams) in [361, 181, 10_000, 60, 1081, 361].into_iter().enumerate() {
        let seconds = i as f64 * 0.05;
        let laser = Laser::with_field_of_view(270.0, beams);
        let pose = true_pose(seconds);
        let mut message = scan_at(seconds, pose);
        message.angle_increment = laser.increment as f32;
        message.ranges = laser
            .geometry()
            .directions()
            .iter()
            .map(|&d| room_range(pose.translation(), pose.transform().rotate(d)) as f32)
            .collect();
        let estimate = answer(&mut app, &message);
        assert!(estimate.registration.outcome.is_ok(), "{beams}: {:?}", estimate.registration.outcome);
        assert_near(estimate.registration.odom_from_base, pose, 0.05);
    }
}
