//! Odometry under disturbances: fast motion during a sweep, lost scans, wrong wheel odometry, and a long rest.

use std::sync::Arc;
use std::time::Duration;

use crate::common::Laser;
use anytime_scan_matcher::anytime::clock::VirtualClock;
use anytime_scan_matcher::anytime::interrupt::NeverInterrupt;
use anytime_scan_matcher::app::{App, ScanProcessor as _};
use anytime_scan_matcher::config::Config;
use anytime_scan_matcher::geometry::Pose2;
use anytime_scan_matcher::knobs::Seconds;
use anytime_scan_matcher::messages::nav_msgs::Odometry;
use anytime_scan_matcher::messages::sensor_msgs::LaserScan;
use anytime_scan_matcher::messages::tf2_msgs::TFMessage;
use anytime_scan_matcher::odometry::Registration;
use anytime_scan_matcher::simulation::built_in::BuiltIn;
use anytime_scan_matcher::simulation::drive::{Settings, SimulatedMessage, simulate};
use anytime_scan_matcher::simulation::scene::Scene;
use anytime_scan_matcher::time::Stamp;
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

/// A drive around the corridor: its messages in order, with the true pose of the base at each scan.
fn drive(settings: &Settings, mut handle: impl FnMut(Pose2, SimulatedMessage)) {
    let mut truths = Vec::new();
    let scene = Scene::built_in(BuiltIn::Corridor).unwrap();
    let played: Result<(), std::convert::Infallible> = simulate(settings, &scene, |_, message| {
        let truth = match &message {
            SimulatedMessage::Truth { stamp, map_from_base } => {
                truths.push((*stamp, *map_from_base));
                None
            }
            SimulatedMessage::Scan(scan) => truths.iter().rev().find(|(stamp, _)| *stamp == Stamp::from(scan.header.stamp)),
            SimulatedMessage::Mount(_) | SimulatedMessage::Odometry(_) => None,
        };
        handle(truth.map(|(_, truth)| *truth).unwrap_or_default(), message);
        Ok(())
    });
    played.unwrap();
}

/// The answers to a drive's scans, each with the true pose of the base. Messages can be modified before they are handled.
fn answers(
    settings: &Settings,
    app: &mut App,
    mut hears: impl FnMut(&mut LaserScan) -> bool,
    mut wheels: impl FnMut(&mut Odometry),
) -> Vec<(Pose2, Registration)> {
    let mut answers = Vec::new();
    drive(settings, |truth, message| match message {
        SimulatedMessage::Mount(mount) => app.on_transforms(&mount).unwrap(),
        SimulatedMessage::Odometry(mut odometry) => {
            wheels(&mut odometry);
            app.on_odometry(&odometry).unwrap();
        }
        SimulatedMessage::Truth { .. } => {}
        SimulatedMessage::Scan(mut scan) => {
            if hears(&mut scan) {
                answers.push((truth, app.on_scan(&scan, Duration::ZERO).registration));
                app.maintain(&NeverInterrupt);
            }
        }
    });
    answers
}

/// RMS of the position error over a drive, relative to the first pose, without alignment, m.
fn error(answers: &[(Pose2, Registration)]) -> f64 {
    let start = answers[0].0;
    let of = |(truth, answer): &(Pose2, Registration)| start.between(truth).between(&answer.map_from_base()).distance();
    (answers.iter().map(|answer| of(answer).powi(2)).sum::<f64>() / answers.len() as f64).sqrt()
}

#[test]
fn motion_during_a_sweep_is_compensated() {
    let settings = settings(7.0, 0.02);
    let of = |knob| error(&answers(&settings, &mut app(&[knob]), |_| true, |_| {}));
    let (with, without) = (of("odometry.deskew=true"), of("odometry.deskew=false"));
    println!("7 m/s, 3 rad/s, sweeps of 20 ms: {with:.4} m, without deskewing {without:.4} m");
    assert!(with < 0.0062 && with < without / 3.0, "{with} {without}");
    // The driver does not give the sweep time, the parameter does.
    let silent = |scan: &mut LaserScan| {
        scan.time_increment = 0.0;
        true
    };
    let by_parameter = error(&answers(&settings, &mut app(&["odometry.scan_duration=20ms"]), silent, |_| {}));
    assert!(by_parameter < without / 3.0, "{by_parameter} {without}");
}

/// Predictions must be as good after a thousandth of a second as after a twentieth.
#[test]
fn scans_alone_suffice_at_any_rate() {
    for (rate, seconds) in [(20.0, 20.0), (40.0, 20.0), (100.0, 20.0), (200.0, 12.0), (1000.0, 6.0)] {
        let mut settings = settings(6.0, 0.0);
        (settings.lidar.rate, settings.drive.duration) = (rate, Seconds(seconds));
        let (mut app, mut answers) = (app(&[]), Vec::new());
        drive(&settings, |truth, message| match message {
            SimulatedMessage::Mount(mount) => app.on_transforms(&mount).unwrap(),
            SimulatedMessage::Scan(scan) => {
                answers.push((truth, app.on_scan(&scan, Duration::ZERO).registration));
                app.maintain(&NeverInterrupt);
            }
            SimulatedMessage::Odometry(_) | SimulatedMessage::Truth { .. } => {}
        });
        let error = error(&answers);
        println!("6 m/s by scans alone at {rate} Hz: {error:.4} m");
        assert!(error < 0.0081, "{rate} Hz: {error}");
    }
}

#[test]
fn one_scan_in_five_may_be_lost() {
    let mut settings = settings(3.0, 0.0);
    let mut random = Pcg64::seed_from_u64(3);
    let (mut all, mut most) = (0.0, 0.0);
    for seed in 0..10 {
        settings.drive.seed = seed;
        all += error(&answers(&settings, &mut app(&[]), |_| true, |_| {})).powi(2);
        most += error(&answers(&settings, &mut app(&[]), |_| random.random::<f64>() > 0.2, |_| {})).powi(2);
    }
    let [all, most] = [all, most].map(|squares| (squares / 10.0).sqrt());
    println!("ten drives, all scans: {all:.4} m, without a fifth of them {most:.4} m");
    assert!(most < 0.0044 && most < 1.5 * all, "{most} {all}");
}

#[test]
fn people_and_cars_do_not_drag_the_pose_along() {
    let mut settings = settings(3.0, 0.0);
    settings.drive.duration = Seconds(40.0);
    let mut of = |walkers, rivals| {
        (settings.traffic.walkers, settings.traffic.rivals) = (walkers, rivals);
        let drive = |seed| {
            settings.drive.seed = seed;
            error(&answers(&settings, &mut app(&[]), |_| true, |_| {}))
        };
        let mut errors: Vec<f64> = (0..7).map(drive).collect();
        errors.sort_by(f64::total_cmp);
        println!("seven drives among {walkers} people and {rivals} cars: {errors:.4?} m");
        errors[3]
    };
    let (empty, people, rivals) = (of(0, 0), of(60, 0), of(35, 2));
    assert!(people < 0.0122 && people < 2.5 * empty, "{people} {empty}");
    assert!(rivals < 0.0207, "{rivals}");
}

#[test]
fn a_spinning_wheel_is_tolerated() {
    let settings = settings(3.0, 0.0);
    let (mut count, spin) = (0, Pose2::new(0.0, 0.0, 60_f64.to_radians()));
    let spun = |odometry: &mut Odometry| {
        count += 1;
        if count > 300 {
            let pose = anytime_scan_matcher::app::planar_pose(&odometry.pose.pose).unwrap();
            odometry.pose.pose = (spin * pose).into();
        }
    };
    let error = error(&answers(&settings, &mut app(&[]), |_| true, spun));
    println!("after one step of odometry that is 60 degrees wrong: {error:.4} m");
    assert!(error < 0.0029, "{error}");
}

#[test]
fn odometry_with_the_wrong_sign_is_rejected() {
    let settings = settings(3.0, 0.0);
    let (mut count, mut before, mut reported) = (0, None, Pose2::IDENTITY);
    // From the fourth to the eighth second every step is reported with the wrong sign.
    let backwards = |odometry: &mut Odometry| {
        let pose = anytime_scan_matcher::app::planar_pose(&odometry.pose.pose).unwrap();
        let step = before.replace(pose).map_or(pose, |before| before.between(&pose));
        count += 1;
        let is_wrong = (200..400).contains(&count);
        reported = reported * if is_wrong { Pose2 { x: -step.x, ..step } } else { step };
        odometry.pose.pose = reported.into();
    };
    let mut app = app(&[]);
    let error = error(&answers(&settings, &mut app, |_| true, backwards));
    let rejected = app.odometry_counters().odometry_rejected;
    println!("four seconds of odometry with the wrong sign: {error:.4} m, rejected {rejected} times");
    assert!(error < 0.0023, "{error}");
    assert!((150..=170).contains(&rejected), "{rejected}");
}

/// Laps with a laser whose beams are a little farther apart than it reports, so that every rotation is measured too small.
fn laps_of_a_laser_that_errs(app: &mut App) -> Vec<(Pose2, Registration)> {
    let mut settings = settings(3.0, 0.0);
    settings.drive.duration = Seconds(60.0);
    let err = |scan: &mut LaserScan| {
        for angle in [&mut scan.angle_min, &mut scan.angle_max, &mut scan.angle_increment] {
            *angle *= 0.99;
        }
        true
    };
    answers(&settings, app, err, |_| {})
}

/// Distance between the map poses of the same place in successive laps, m: mean over the last lap.
fn drift_of_a_lap(answers: &[(Pose2, Registration)]) -> f64 {
    let passed_again = |(i, (truth, answer)): (usize, &(Pose2, Registration))| {
        let is_near = |(earlier, _): &&(Pose2, Registration)| earlier.between(truth).distance() < 0.2;
        let before = answers[..i.saturating_sub(200)].iter().rev().find(is_near)?;
        let (moved, seen) = (before.0.between(truth), before.1.map_from_base().between(&answer.map_from_base()));
        Some(moved.between(&seen).distance())
    };
    let last_lap: Vec<f64> = answers.iter().enumerate().skip(answers.len() * 3 / 4).filter_map(passed_again).collect();
    assert!(last_lap.len() > 50, "the drive is not longer than a lap");
    last_lap.iter().sum::<f64>() / last_lap.len() as f64
}

#[test]
fn previously_visited_places_are_recognised_and_the_odometry_never_jumps() {
    let mut with = app(&[]);
    let answers = laps_of_a_laser_that_errs(&mut with);
    let without = drift_of_a_lap(&laps_of_a_laser_that_errs(&mut app(&["odometry.close_loops=false"])));
    let (drift, recognised) = (drift_of_a_lap(&answers), with.odometry_counters().closed_loops);
    println!("a lap later a place is {drift:.3} m off, without closing loops {without:.3} m; recognised: {recognised} times");
    assert!(recognised > 0 && drift < 0.0024 && drift < 0.3 * without, "{drift} {without}");
    let steps = answers.windows(2).map(|pair| {
        let [(truth, before), (next_truth, after)] = pair else { unreachable!() };
        truth.between(next_truth).between(&before.odom_from_base.between(&after.odom_from_base)).distance()
    });
    let worst = steps.fold(0.0, f64::max);
    assert!(worst < 0.05, "a jump of {worst} m");
}

#[test]
fn the_pose_does_not_drift_in_ten_minutes_at_rest() {
    let mut random = Pcg64::seed_from_u64(5);
    let laser = Laser::with_field_of_view(270.0, 361);
    let mut app = app(&[]);
    let (mut farthest, mut sum) = (0.0_f64, nalgebra::Vector3::zeros());
    let scans = 6000;
    for i in 0..scans {
        let mut scan = laser.message(Stamp::from_seconds(1.7e9 + 0.1 * f64::from(i)), Pose2::IDENTITY);
        #[allow(clippy::cast_possible_truncation)] // the message carries 32 bits
        scan.ranges.iter_mut().for_each(|range| *range += (0.01 * crate::common::normal(&mut random)) as f32);
        let pose = app.on_scan(&scan, Duration::ZERO).registration.map_from_base();
        farthest = farthest.max(pose.distance());
        sum += nalgebra::Vector3::new(pose.x, pose.y, pose.theta.to_degrees());
    }
    let mean = sum / f64::from(scans);
    let (distance, turn) = (mean.xy().norm(), mean.z.abs());
    println!("10 minutes at rest: on average {:.2} mm and {turn:.4} deg away, at most {:.2} mm", 1e3 * distance, 1e3 * farthest);
    assert!(distance < 0.001 && turn < 0.0056 && farthest < 0.0045, "{distance} {turn} {farthest}");
    assert_eq!(app.odometry_counters().keyframes, 1);
}

/// Scans of a drive around the corridor, each with its true pose, and the transform of the laser's mount.
fn scans(settings: &Settings) -> (TFMessage, Vec<(Pose2, LaserScan)>) {
    let (mut scans, mut mount) = (Vec::new(), TFMessage::default());
    drive(settings, |truth, message| match message {
        SimulatedMessage::Mount(message) => mount = message,
        SimulatedMessage::Scan(scan) => scans.push((truth, scan)),
        SimulatedMessage::Odometry(_) | SimulatedMessage::Truth { .. } => {}
    });
    (mount, scans)
}

#[test]
fn a_kidnapped_robot_continues_from_its_last_pose() {
    let mut settings = settings(3.0, 0.0);
    settings.drive.duration = Seconds(36.0);
    settings.lidar.rate = 100.0;
    let (mount, scans) = scans(&settings);
    let mut lost = Vec::new();
    for (from, to) in (0..8).flat_map(|from| (0..8).map(move |to| (200 + 230 * from, 230 + 370 * to))) {
        let mut app = app(&[]);
        app.on_transforms(&mount).unwrap();
        let drive = scans[from..from + 400].iter().chain(&scans[to..to + 300]).enumerate();
        let answers: Vec<(Pose2, Pose2)> = drive
            .map(|(i, (truth, scan))| {
                let mut scan = scan.clone();
                scan.header.stamp = Stamp::from_seconds(100.0 + 0.01 * i as f64).into();
                let registration = app.on_scan(&scan, Duration::ZERO).registration;
                app.maintain(&NeverInterrupt);
                (*truth, registration.odom_from_base)
            })
            .collect();
        // Leave out the kidnapping itself, and cases that become visible only later.
        let settled = &answers[550..];
        let (truth, found) = settled[0];
        let worst = settled.iter().map(|(t, f)| truth.between(t).between(&found.between(f)).distance()).fold(0.0, f64::max);
        if worst > 0.05 {
            lost.push((from, to, worst));
        }
    }
    println!("kidnapped, by scans alone: continued wrongly {} of 64 times: {lost:?}", lost.len());
    assert!(lost.is_empty(), "{lost:?}");
}
