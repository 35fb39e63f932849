//! Inputs that caused failures on real robots, each with its expected result. They are stored beside the checkout (`../shared/cases`).

use std::path::Path;

use anytime_scan_matcher::app::planar_pose;
use anytime_scan_matcher::geometry::{Pose2, wrap_angle};
use anytime_scan_matcher::io::bag::{Bag, BagWriter, Compression};
use anytime_scan_matcher::messages::nav_msgs::Odometry;
use anytime_scan_matcher::messages::sensor_msgs::{Imu, LaserScan};
use anytime_scan_matcher::messages::tf2_msgs::TFMessage;
use anytime_scan_matcher::time::Stamp;
use serde_json::Value;

use crate::common::program::{anytime, json};
use crate::common::shared;

/// The summary of `anytime replay` for a case; `None` if the case is not available.
fn replay(case: &str, truth: &str, more: &[&str]) -> Option<Value> {
    let bag = shared(&format!("cases/{case}.bag"))?;
    let truth = (!truth.is_empty()).then(|| bag.with_file_name("truth").join(truth).with_extension("tum"));
    let with_truth = truth.iter().flat_map(|truth| ["--truth", truth.to_str().unwrap()]);
    Some(replay_bag(&bag, &with_truth.chain(more.iter().copied()).collect::<Vec<_>>()))
}

fn replay_bag(bag: &Path, arguments: &[&str]) -> Value {
    json(&[&["replay", bag.to_str().unwrap(), "--json"], arguments].concat())
}

/// The poses of a case in TUM format; `None` if the case is not available.
fn poses(case: &str, more: &[&str]) -> Option<String> {
    let folder = tempfile::tempdir().unwrap();
    let tum = folder.path().join("x.tum");
    replay(case, "", &[&["--tum", tum.to_str().unwrap()], more].concat())?;
    Some(std::fs::read_to_string(tum).unwrap())
}

/// Checks that no scan fails, that the ATE is at most `max_ate`, m, and that the problems contain `note`.
fn check_case(case: &str, truth: &str, more: &[&str], max_ate: f64, note: &str) {
    let Some(summary) = replay(case, truth, more) else { return };
    let ate = summary["ate_rmse_m"].as_f64().unwrap();
    assert!(ate <= max_ate, "{case}: {ate} m: {summary}");
    assert_eq!(summary["failed"], 0, "{case}: {summary}");
    assert!(summary["problems"].to_string().contains(note), "{case}: {summary}");
}

#[test]
fn rays_without_a_return_are_not_walls() {
    check_case("k1_nothing_seen_is_range_max", "b270", &[], 0.01, "");
}

#[test]
fn mounts_may_jitter_and_lasers_may_alternate() {
    check_case("k2_mount_jitters_3um", "b270", &[], 0.01, "");
    // All its scans were taken from one pose, but tf has one of the two frames 2 cm to the side: 1 cm of error is in the file.
    check_case("k2_two_frames_on_scan", "b270", &[], 0.015, "");
}

#[test]
fn beams_are_where_the_increment_puts_them() {
    check_case("k5_velodyne_laserscan_0.005", "b1256", &[], 0.01, "angle_increment give");
}

#[test]
fn sweeps_run_in_both_directions() {
    check_case("k11_negative_time_increment", "skew", &[], 0.01, "");
    check_case("k11_reversed_data", "skew", &["--set", "odometry.scan_duration=-0.045"], 0.01, "");
}

#[test]
fn invalid_fields_that_matching_does_not_need_are_ignored_with_a_warning() {
    check_case("k12_scan_time_nan", "b270", &[], 0.01, "scan_time is NaN: ignored");
    check_case("k12_time_increment_inf", "b270", &[], 0.01, "time_increment is inf");
    check_case("k12_one_intensity", "b270", &[], 0.01, "1 intensities");
}

#[test]
fn a_faulty_imu_is_rejected_and_reported() {
    check_case("k6_imu_ned", "turny", &[], 0.01, "without the IMU");
}

/// Factors on a sensor's values.
#[derive(Clone, Copy, Debug)]
struct Units {
    imu: f64,
    /// Distance and rotation; `None`: no wheel odometry.
    wheels: Option<(f64, f64)>,
}

/// Rewrites the bag of the IMU with the wrong sign, in other units.
fn with_units(from: &Path, to: &Path, units: Units) {
    let mut writer = BagWriter::create(to, Compression::None).unwrap();
    for message in Bag::open(from).unwrap().messages(None) {
        let message = message.unwrap();
        match message.connection.topic.as_str() {
            "/scan" => writer.write("/scan", message.time, &message.decode::<LaserScan>().unwrap()).unwrap(),
            "/tf_static" => writer.write_latched("/tf_static", message.time, &message.decode::<TFMessage>().unwrap()).unwrap(),
            "/imu/data" => {
                let mut imu = message.decode::<Imu>().unwrap();
                imu.angular_velocity.z *= units.imu;
                writer.write("/imu/data", message.time, &imu).unwrap();
            }
            "/odom" => {
                let Some((distance, turn)) = units.wheels else { continue };
                let mut odometry = message.decode::<Odometry>().unwrap();
                let pose = planar_pose(&odometry.pose.pose).unwrap();
                odometry.pose.pose = Pose2::new(distance * pose.x, distance * pose.y, turn * pose.theta).into();
                odometry.twist.twist.linear.x *= distance;
                odometry.twist.twist.angular.z *= turn;
                writer.write("/odom", message.time, &odometry).unwrap();
            }
            _ => {}
        }
    }
    writer.finish().unwrap();
}

#[test]
fn sensors_with_wrong_units_or_signs_do_no_harm() {
    let Some(bag) = shared("cases/k6_imu_ned.bag") else { return };
    let folder = tempfile::tempdir().unwrap();
    let changed = folder.path().join("changed.bag");
    let degrees = 180.0 / std::f64::consts::PI;
    let right = Some((1.0, 1.0));
    for (imu, wheels) in [
        (-1.0, right),
        (-degrees, right),
        (degrees, right),
        (0.0, right),
        (-1.0, None),
        (1.0, None),
        (-degrees, None),
        (-1.0, Some((1.0, -1.0))),
        (1.0, Some((1.0, -1.0))),
        (-1.0, Some((0.01, 1.0))),
        (-1.0, Some((1000.0, 1.0))),
    ] {
        let units = Units { imu, wheels };
        with_units(&bag, &changed, units);
        let truth = bag.with_file_name("truth/turny.tum");
        let summary = replay_bag(&changed, &["--truth", truth.to_str().unwrap()]);
        let ate = summary["ate_rmse_m"].as_f64().unwrap();
        assert!(ate < 0.01 && summary["failed"] == 0, "{units:?}: {ate} m: {summary}");
    }
}

#[test]
fn the_robot_continues_after_the_clock_is_set_back() {
    let end = |case: &str| {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("out.tum");
        replay(case, "", &["--tum", file.to_str().unwrap()])?;
        let text = std::fs::read_to_string(&file).unwrap();
        let numbers: Vec<f64> = text.lines().last()?.split(' ').map(|number| number.parse().unwrap()).collect();
        Some((numbers[1], numbers[2]))
    };
    // The same drive without the clock step.
    let (Some(with), Some(without)) = (end("k7_clock_back_0.6"), end("k12_one_intensity")) else { return };
    assert!((with.0 - without.0).hypot(with.1 - without.1) < 0.05, "{with:?} {without:?}");
}

#[test]
fn before_the_first_usable_scan_answers_follow_odometry() {
    let Some(summary) = replay("k10_blind_start", "b270", &[]) else { return };
    assert!(summary["ate_rmse_m"].as_f64().unwrap() < 0.1, "{summary}");
}

#[test]
fn a_laser_mounted_on_edge_is_reported() {
    let Some(bag) = shared("cases/k13_roll_90.bag") else { return };
    let bag = bag.to_str().unwrap();
    let output = anytime(&["replay", bag, "--json"]);
    let summary: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(summary["matched"], 0, "{summary}");
    assert!(summary["failures"]["tilted_mount"].as_u64() > Some(0), "{summary}");
    assert!(summary["problems"].to_string().contains("tilted by"), "{summary}");
    assert_eq!(output.status.code(), Some(1), "no scan was usable: {}", String::from_utf8_lossy(&output.stderr));
    let info = json(&["info", bag, "--json"]);
    assert!(info["problems"].to_string().contains("tilted by 90 degrees against 'base_link'"), "{info}");
}

/// A match 24 standard deviations from the odometry, along a wall that does not constrain the heading, is outweighed by the odometry.
#[test]
fn a_rotation_that_odometry_contradicts_is_rejected() {
    let Some(poses) = poses("flip_after_lost", &[]) else { return };
    let [before, after] =
        ["1232662036.094", "1232662036.706"].map(|stamp| heading(poses.lines().find(|line| line.starts_with(stamp)).unwrap()));
    // The odometry turns by 0.1 degrees.
    assert!((after - before).abs().to_degrees() < 2.0, "{before} {after}");
}

/// A real laser at rest for 37 s.
#[test]
fn a_laser_at_rest_does_not_move() {
    let Some(poses) = poses("lidarme", &[]) else { return };
    for line in poses.lines() {
        let numbers: Vec<f64> = line.split_whitespace().map(|number| number.parse().unwrap()).collect();
        assert!(numbers[1].hypot(numbers[2]) < 0.07, "{line}");
    }
    let summary = replay("lidarme", "", &[]).unwrap();
    assert_eq!(summary["keyframes"], 1, "nothing new must be seen: {summary}");
}

/// Endless long walls without odometry: the last view equals the first, and the path in between is unobservable.
#[test]
fn the_covariance_grows_along_a_wall_without_odometry() {
    let Some(poses) = poses("rosify_laser", &["--scan-topic", "laser_scan"]) else { return };
    let stamps: Vec<&str> = poses.lines().filter_map(|line| line.split(' ').next()).collect();
    let (first, last) = (&stamps[..1], &stamps[stamps.len() - 20..]);
    let at_the_start: Vec<String> = first.iter().chain(last).map(|stamp| format!("{stamp} 0 0 0 0 0 0 1\n")).collect();
    let folder = tempfile::tempdir().unwrap();
    let truth = folder.path().join("truth.tum");
    std::fs::write(&truth, at_the_start.concat()).unwrap();
    let arguments = ["--scan-topic", "laser_scan", "--truth", truth.to_str().unwrap()];
    let summary = replay("rosify_laser", "", &arguments).unwrap();
    assert!(summary["consistency"]["positions_within"].as_f64().unwrap() > 0.75, "{summary}");
}

/// A laser inside a wall sees only its own noise; the rotation must come from the odometry.
#[test]
fn a_laser_in_a_wall_does_not_turn_the_robot() {
    let Some(bag) = shared("cases/wall_contact.bag") else { return };
    let Some(poses) = poses("wall_contact", &["--set", "odometry.laser_in_base=[0.275,0,0]"]) else { return };
    let bag = Bag::open(&bag).unwrap();
    let odometry: Vec<(f64, f64)> = bag
        .messages(Some(&["/odom"]))
        .map(|message| message.unwrap().decode::<Odometry>().unwrap())
        .map(|message| {
            (Stamp::from(message.header.stamp).seconds_since(Stamp::default()), planar_pose(&message.pose.pose).unwrap().theta)
        })
        .collect();
    for line in poses.lines() {
        let stamp: f64 = line.split(' ').next().unwrap().parse().unwrap();
        let latest = odometry.partition_point(|&(of, _)| of <= stamp).saturating_sub(1);
        let turn = wrap_angle(heading(line) - (odometry[latest].1 - odometry[0].1));
        assert!(turn.abs().to_degrees() < 2.0, "{line}: {} degrees from the odometry", turn.to_degrees());
    }
}

/// The heading in a line of a TUM file, rad.
fn heading(line: &str) -> f64 {
    let numbers: Vec<f64> = line.split_whitespace().map(|number| number.parse().unwrap()).collect();
    2.0 * numbers[6].atan2(numbers[7])
}
