//! Inputs that went wrong on somebody's robot, each with its right value. They lie beside the checkout (`../shared/cases`).

use std::path::Path;
use std::process::Command;

use anytime_scan_matcher::app::planar_pose;
use anytime_scan_matcher::geometry::{Pose2, wrap_angle};
use anytime_scan_matcher::io::bag::{Bag, BagWriter, Compression};
use anytime_scan_matcher::messages::nav_msgs::Odometry;
use anytime_scan_matcher::messages::sensor_msgs::{Imu, LaserScan};
use anytime_scan_matcher::messages::tf2_msgs::TFMessage;
use anytime_scan_matcher::time::Stamp;
use serde_json::Value;

use crate::common::shared;

/// What `anytime replay` says of a case; `None` where it is not there.
fn replay(case: &str, truth: &str, more: &[&str]) -> Option<Value> {
    let bag = shared(&format!("cases/{case}.bag"))?;
    let truth = (!truth.is_empty()).then(|| bag.with_file_name("truth").join(truth).with_extension("tum"));
    let with_truth = truth.iter().flat_map(|truth| ["--truth", truth.to_str().unwrap()]);
    Some(replay_bag(&bag, &with_truth.chain(more.iter().copied()).collect::<Vec<_>>()))
}

fn replay_bag(bag: &Path, arguments: &[&str]) -> Value {
    let output =
        Command::new(env!("CARGO_BIN_EXE_anytime")).arg("replay").arg(bag).arg("--json").args(arguments).output().unwrap();
    assert!(output.status.success(), "{}: {}", bag.display(), String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

/// The poses of a case, as a TUM file has them; `None` where it is not there.
fn poses(case: &str, more: &[&str]) -> Option<String> {
    let folder = tempfile::tempdir().unwrap();
    let tum = folder.path().join("x.tum");
    replay(case, "", &[&["--tum", tum.to_str().unwrap()], more].concat())?;
    Some(std::fs::read_to_string(tum).unwrap())
}

/// All scans but the first are matched, within so many metres of the truth; among the notes is this text.
fn right(case: &str, truth: &str, more: &[&str], most: f64, note: &str) {
    let Some(summary) = replay(case, truth, more) else { return };
    let ate = summary["ate_rmse_m"].as_f64().unwrap();
    assert!(ate <= most, "{case}: {ate} m: {summary}");
    assert_eq!(summary["failed"], 0, "{case}: {summary}");
    assert!(summary["problems"].to_string().contains(note), "{case}: {summary}");
}

#[test]
fn rays_that_saw_nothing_are_no_walls() {
    right("k1_nothing_seen_is_range_max", "b270", &[], 0.01, "");
}

#[test]
fn a_mount_may_shake_and_lasers_may_take_turns() {
    right("k2_mount_jitters_3um", "b270", &[], 0.01, "");
    // Its scans are all of one place, while tf has one of the two frames 2 cm aside: 1 cm of error is in the file.
    right("k2_two_frames_on_scan", "b270", &[], 0.015, "");
}

#[test]
fn beams_are_where_the_increment_puts_them() {
    right("k5_velodyne_laserscan_0.005", "b1256", &[], 0.01, "angle_increment make");
}

#[test]
fn sweeps_run_in_both_directions() {
    right("k11_negative_time_increment", "skew", &[], 0.01, "");
    right("k11_reversed_data", "skew", &["--set", "odometry.scan_duration=-0.045"], 0.01, "");
}

#[test]
fn numbers_that_matching_does_not_need_are_ignored_with_a_word() {
    right("k12_scan_time_nan", "b270", &[], 0.01, "scan_time is NaN: ignored");
    right("k12_time_increment_inf", "b270", &[], 0.01, "time_increment is inf");
    right("k12_one_intensity", "b270", &[], 0.01, "1 intensities");
}

#[test]
fn an_imu_that_errs_is_not_believed_and_named() {
    right("k6_imu_ned", "turny", &[], 0.01, "without the IMU");
}

/// What a sensor's numbers are multiplied by.
#[derive(Clone, Copy, Debug)]
struct Units {
    imu: f64,
    /// Distance and turn; `None`: there are no wheels.
    wheels: Option<(f64, f64)>,
}

/// The bag of the IMU whose sign is wrong, with other units.
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
                let Some((way, turn)) = units.wheels else { continue };
                let mut odometry = message.decode::<Odometry>().unwrap();
                let pose = planar_pose(&odometry.pose.pose).unwrap();
                odometry.pose.pose = Pose2::new(way * pose.x, way * pose.y, turn * pose.theta).into();
                odometry.twist.twist.linear.x *= way;
                odometry.twist.twist.angular.z *= turn;
                writer.write("/odom", message.time, &odometry).unwrap();
            }
            _ => {}
        }
    }
    writer.finish().unwrap();
}

#[test]
fn sensors_of_other_units_and_signs_lead_nowhere_else() {
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
fn where_the_clock_is_set_back_the_robot_drives_on() {
    let end = |case: &str| {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("out.tum");
        replay(case, "", &["--tum", file.to_str().unwrap()])?;
        let text = std::fs::read_to_string(&file).unwrap();
        let numbers: Vec<f64> = text.lines().last()?.split(' ').map(|number| number.parse().unwrap()).collect();
        Some((numbers[1], numbers[2]))
    };
    // The same drive, without the step.
    let (Some(with), Some(without)) = (end("k7_clock_back_0.6"), end("k12_one_intensity")) else { return };
    assert!((with.0 - without.0).hypot(with.1 - without.1) < 0.05, "{with:?} {without:?}");
}

#[test]
fn before_the_first_usable_scan_answers_follow_odometry() {
    let Some(summary) = replay("k10_blind_start", "b270", &[]) else { return };
    assert!(summary["ate_rmse_m"].as_f64().unwrap() < 0.1, "{summary}");
}

#[test]
fn a_laser_on_edge_is_named() {
    let Some(bag) = shared("cases/k13_roll_90.bag") else { return };
    let output = Command::new(env!("CARGO_BIN_EXE_anytime")).arg("replay").arg(&bag).arg("--json").output().unwrap();
    let summary: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(summary["matched"], 0, "{summary}");
    assert!(summary["failures"]["tilted_mount"].as_u64() > Some(0), "{summary}");
    assert!(summary["problems"].to_string().contains("tilted by"), "{summary}");
    assert_eq!(output.status.code(), Some(1), "no scan was of use: {}", String::from_utf8_lossy(&output.stderr));
    let info = Command::new(env!("CARGO_BIN_EXE_anytime")).arg("info").arg(bag).arg("--json").output().unwrap();
    let info: Value = serde_json::from_slice(&info.stdout).unwrap();
    assert!(info["problems"].to_string().contains("tilted by 90 degrees against 'base_link'"), "{info}");
}

/// A match 24 standard deviations from what odometry says, along a wall that leaves the heading open, is outweighed by the odometry.
#[test]
fn a_turn_that_the_odometry_does_not_know_is_not_believed() {
    let Some(poses) = poses("flip_after_lost", &[]) else { return };
    let [before, after] =
        ["1232662036.094", "1232662036.706"].map(|stamp| heading(poses.lines().find(|line| line.starts_with(stamp)).unwrap()));
    // The odometry turns by 0.1 degrees.
    assert!((after - before).abs().to_degrees() < 2.0, "{before} {after}");
}

/// A real laser that stands still for 37 s.
#[test]
fn a_laser_at_rest_stays_where_it_is() {
    let Some(poses) = poses("lidarme", &[]) else { return };
    for line in poses.lines() {
        let numbers: Vec<f64> = line.split_whitespace().map(|number| number.parse().unwrap()).collect();
        assert!(numbers[1].hypot(numbers[2]) < 0.07, "{line}");
    }
    let summary = replay("lidarme", "", &[]).unwrap();
    assert_eq!(summary["keyframes"], 1, "nothing new is seen: {summary}");
}

/// Long walls without an end, and no odometry: what is seen last is what was seen first, and where the robot has been in between nobody
/// knows.
#[test]
fn along_a_wall_without_odometry_the_covariance_says_that_nothing_is_known() {
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

/// A laser inside a wall sees nothing but its own noise; the odometry says how the robot turns.
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

/// Of a line of a TUM file, rad.
fn heading(line: &str) -> f64 {
    let numbers: Vec<f64> = line.split_whitespace().map(|number| number.parse().unwrap()).collect();
    2.0 * numbers[6].atan2(numbers[7])
}
