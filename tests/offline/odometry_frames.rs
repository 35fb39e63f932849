//! Odometry of a frame other than the base: a tracking camera, `base_footprint`.

use std::sync::Arc;
use std::time::Duration;

use anytime_scan_matcher::anytime::clock::VirtualClock;
use anytime_scan_matcher::app::localizer::Localizer;
use anytime_scan_matcher::app::{App, InputError, ScanProcessor as _};
use anytime_scan_matcher::config::Config;
use anytime_scan_matcher::geometry::Pose2;
use anytime_scan_matcher::messages::geometry_msgs::{Transform, TransformStamped};
use anytime_scan_matcher::messages::nav_msgs::Odometry;
use anytime_scan_matcher::messages::std_msgs::Header;
use anytime_scan_matcher::messages::tf2_msgs::TFMessage;
use anytime_scan_matcher::time::Stamp;

use crate::common::{Laser, corridor};

/// The pose of the camera on the base: ahead, facing left.
const BASE_FROM_CAMERA: Pose2 = Pose2 { x: 0.5, y: 0.1, theta: 1.2 };

fn transform(parent: &str, child: &str, place: Pose2) -> TFMessage {
    let header = Header { frame_id: parent.into(), ..Header::default() };
    TFMessage { transforms: vec![TransformStamped { header, child_frame_id: child.into(), transform: Transform::from(place) }] }
}

/// The camera's odometry starts at the camera; when the base turns, the camera moves on a circle.
fn odometry(seconds: f64, odom_from_base: Pose2, child: &str) -> Odometry {
    let header = Header { stamp: Stamp::from_seconds(seconds).into(), frame_id: "camera_odom".into(), ..Header::default() };
    let mut message = Odometry { header, child_frame_id: child.into(), ..Odometry::default() };
    message.pose.pose = (BASE_FROM_CAMERA.inverse() * odom_from_base * BASE_FROM_CAMERA).into();
    message
}

fn true_pose(seconds: f64) -> Pose2 {
    Pose2::new(0.3 * seconds, 0.0, 2.0 * seconds)
}

fn clock() -> Arc<VirtualClock> {
    Arc::new(VirtualClock::new(Duration::from_micros(10)))
}

#[test]
fn a_cameras_odometry_predicts_the_base() {
    for child in ["camera", "/camera"] {
        let mut app = App::new(&Config::default(), clock()).unwrap();
        app.on_transforms(&transform("base_link", "laser", Pose2::IDENTITY)).unwrap();
        app.on_transforms(&transform("base_link", "camera", BASE_FROM_CAMERA)).unwrap();
        let laser = Laser::with_field_of_view(270.0, 361);
        for i in 0..10 {
            let seconds = f64::from(i) * 0.1;
            app.on_odometry(&odometry(seconds, true_pose(seconds), child)).unwrap();
            let estimate = app.on_scan(&laser.message(Stamp::from_seconds(seconds), true_pose(seconds)), Duration::ZERO);
            let error = true_pose(seconds).between(&estimate.registration.odom_from_base);
            assert!(error.distance() < 0.01 && error.theta.abs() < 0.01, "{seconds}: {error:?}");
        }
        let counters = app.odometry_counters();
        assert_eq!((counters.odometry_rejected, counters.predicted), (0, 0), "the odometry is exact");
    }
}

#[test]
fn odometry_of_an_unknown_frame_is_reported_as_unusable() {
    let mut app = App::new(&Config::default(), clock()).unwrap();
    let mut localizer = Localizer::new(corridor(), &Config::default(), clock()).unwrap();
    let unusable = InputError::OdometryOfAnotherFrame { child: "camera".into(), base: "base_link".into() };
    for moving in [None, Some(("camera_odom", "camera")), Some(("odom", "base_link")), Some(("odom", "camera_odom"))] {
        if let Some((parent, child)) = moving {
            // Now they are connected, but only through frames in which they move.
            app.on_transforms(&transform(parent, child, Pose2::IDENTITY)).unwrap();
            localizer.on_transforms(&transform(parent, child, Pose2::IDENTITY)).unwrap();
        }
        let message = odometry(0.0, true_pose(0.0), "camera");
        assert_eq!(app.on_odometry(&message), Err(unusable.clone()));
        assert_eq!(localizer.on_odometry(&message), Err(unusable.clone()));
    }
    assert!(unusable.to_string().contains("'camera'") && unusable.to_string().contains("/tf_static"), "{unusable}");
    assert_eq!(app.counters().refused_messages, 4);
}

#[test]
fn the_particle_filter_transforms_it_to_the_base_too() {
    let mut localizer = Localizer::new(corridor(), &Config::default(), clock()).unwrap();
    localizer.on_transforms(&transform("base_footprint", "base_link", Pose2::new(0.1, 0.0, 0.0))).unwrap();
    let mut message = odometry(1.0, Pose2::IDENTITY, "base_footprint");
    message.pose.pose = Pose2::new(3.0, 4.0, std::f64::consts::FRAC_PI_2).into();
    localizer.on_odometry(&message).unwrap();
    let pose = localizer.odom_from_base(Stamp::from_seconds(1.0)).unwrap();
    assert!((pose.x - 3.0).abs() < 1e-9 && (pose.y - 4.1).abs() < 1e-9, "{pose:?}");
}
