//! Odometry through what spoils it: fast motion during a sweep, lost scans, wrong wheels, and nothing at all for a long time.
#![allow(clippy::unwrap_used, clippy::print_stdout)]

mod common;

use std::sync::Arc;
use std::time::Duration;

use anytime_scan_matcher::anytime::clock::VirtualClock;
use anytime_scan_matcher::app::App;
use anytime_scan_matcher::config::Config;
use anytime_scan_matcher::geometry::Pose2;
use anytime_scan_matcher::knobs::Seconds;
use anytime_scan_matcher::messages::nav_msgs::Odometry;
use anytime_scan_matcher::simulation::built_in::BuiltIn;
use anytime_scan_matcher::simulation::drive::{Settings, SimulatedMessage, simulate};
use anytime_scan_matcher::simulation::scene::Scene;
use anytime_scan_matcher::time::Stamp;
use common::Laser;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

fn app(assignments: &[&str]) -> App {
    let mut config = Config::default();
    for assignment in assignments {
        config.set_assignment(assignment).unwrap();
    }
    App::new(&config, Arc::new(VirtualClock::new(Duration::from_micros(1)))).unwrap()
}

fn settings(speed: f64, scan_duration: f64) -> Settings {
    let mut settings = Settings::default();
    settings.drive.duration = Seconds(12.0);
    settings.vehicle.speed = speed;
    settings.vehicle.acceleration = 8.0;
    settings.vehicle.lateral_acceleration = 20.0;
    settings.lidar.scan_duration = Seconds(scan_duration);
    settings.lidar.beams = 541;
    settings
}

/// Root mean square of the position error, m, over a drive in the corridor: relative to the first pose, not aligned.
fn error(settings: &Settings, app: &mut App, mut keeps: impl FnMut() -> bool, mut wheels: impl FnMut(&mut Odometry)) -> f64 {
    let (mut truths, mut squares) = (Vec::<(Stamp, Pose2)>::new(), Vec::new());
    let scene = Scene::built_in(BuiltIn::Corridor).unwrap();
    let played: Result<(), std::convert::Infallible> = simulate(settings, &scene, |_, message| {
        match message {
            SimulatedMessage::Mount(mount) => app.on_transforms(&mount).unwrap(),
            SimulatedMessage::Odometry(mut odometry) => {
                wheels(&mut odometry);
                app.on_odometry(&odometry).unwrap();
            }
            SimulatedMessage::Truth { stamp, map_from_base } => truths.push((stamp, map_from_base)),
            SimulatedMessage::Scan(scan) if keeps() => {
                let estimate = app.on_scan(&scan, Duration::ZERO);
                let truth = truths.iter().rev().find(|(stamp, _)| *stamp == estimate.stamp).unwrap().1;
                let expected = truths[0].1.between(&truth);
                squares.push(expected.between(&estimate.registration.odom_from_base).distance().powi(2));
            }
            SimulatedMessage::Scan(_) => {}
        }
        Ok(())
    });
    played.unwrap();
    (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
}

#[test]
fn motion_during_the_sweep_is_taken_out() {
    let settings = settings(7.0, 0.02);
    let of = |deskew| error(&settings, &mut app(&[deskew]), || true, |_| {});
    let (with, without) = (of("odometry.deskew=true"), of("odometry.deskew=false"));
    println!("7 m/s, 3 rad/s, sweeps of 20 ms: {with:.4} m, without deskewing {without:.4} m");
    assert!(with < without / 3.0, "{with} {without}");
    // The driver does not say, the parameter does.
    let mut silent = app(&["odometry.scan_duration=20ms"]);
    assert!(error(&settings, &mut silent, || true, |_| {}) < without / 3.0);
}

#[test]
fn one_scan_in_five_may_be_lost() {
    let settings = settings(3.0, 0.0);
    let mut random = Pcg64::seed_from_u64(3);
    let all = error(&settings, &mut app(&[]), || true, |_| {});
    let most = error(&settings, &mut app(&[]), || random.random::<f64>() > 0.2, |_| {});
    println!("all scans: {all:.4} m, without a fifth of them {most:.4} m");
    assert!(most < 1.5 * all + 0.002, "{most} {all}");
}

#[test]
fn a_wheel_that_spins_is_survived() {
    let settings = settings(3.0, 0.0);
    let (mut count, spin) = (0, Pose2::new(0.0, 0.0, 60_f64.to_radians()));
    let spun = |odometry: &mut Odometry| {
        count += 1;
        if count > 300 {
            let pose = anytime_scan_matcher::app::planar_pose(&odometry.pose.pose).unwrap();
            odometry.pose.pose = (spin * pose).into();
        }
    };
    let error = error(&settings, &mut app(&[]), || true, spun);
    println!("after one step of odometry that is 60 degrees wrong: {error:.4} m");
    assert!(error < 0.02, "{error}");
}

#[test]
fn at_rest_for_ten_minutes_nothing_moves() {
    let mut random = Pcg64::seed_from_u64(5);
    let laser = Laser::with_field_of_view(270.0, 361);
    let mut app = app(&[]);
    let (mut farthest, mut sum) = (0.0_f64, nalgebra::Vector3::zeros());
    let scans = 6000;
    for i in 0..scans {
        let mut scan = laser.message(Stamp::from_seconds(1.7e9 + 0.1 * f64::from(i)), Pose2::IDENTITY);
        #[allow(clippy::cast_possible_truncation)] // the message carries 32 bits
        scan.ranges.iter_mut().for_each(|range| *range += (0.01 * common::normal(&mut random)) as f32);
        let pose = app.on_scan(&scan, Duration::ZERO).registration.odom_from_base;
        farthest = farthest.max(pose.distance());
        sum += nalgebra::Vector3::new(pose.x, pose.y, pose.theta.to_degrees());
    }
    let mean = sum / f64::from(scans);
    let (distance, turn) = (mean.xy().norm(), mean.z.abs());
    println!("10 minutes at rest: on average {:.2} mm and {turn:.4} deg away, at most {:.2} mm", 1e3 * distance, 1e3 * farthest);
    assert!(distance < 0.001 && turn < 0.01 && farthest < 0.005, "{distance} {turn} {farthest}");
    assert_eq!(app.odometry_counters().keyframes, 1);
}
