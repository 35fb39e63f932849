//! Whole replays: the demo bag with its truth and golden trajectory, byte-equal reruns, the real logs, unusable bags.

use std::fs;
use std::path::{Path, PathBuf};

use anytime_scan_matcher::geometry::Pose2;
use anytime_scan_matcher::io::bag::{BagWriter, Compression};
use anytime_scan_matcher::messages::sensor_msgs::Imu;
use anytime_scan_matcher::time::Stamp;

use crate::common::Laser;
use crate::common::program::{anytime, failure, json};

fn numbers(path: &Path) -> Vec<Vec<f64>> {
    let text = fs::read_to_string(path).unwrap();
    text.lines().map(|line| line.split_whitespace().map(|n| n.parse().unwrap()).collect()).collect()
}

#[test]
fn the_demo_is_matched_as_well_as_documented() {
    let summary = json(&["replay", "bags/demo.bag", "--truth", "bags/demo.tum", "--json"]);
    assert_eq!((summary["scans"].as_u64(), summary["failed"].as_u64()), (Some(400), Some(0)));
    // At most a tenth more than the 1.2 mm of docs/figures.md.
    assert!(summary["ate_rmse_m"].as_f64().unwrap() < 0.001_32, "{summary}");
    assert!(summary["rpe_1m_rmse_m"].as_f64().unwrap() < 0.001_32, "{summary}");
    // The truth is also on a topic.
    let by_topic = json(&["replay", "bags/demo.bag", "--truth", "/gt_pose", "--json"]);
    let difference = summary["ate_rmse_m"].as_f64().unwrap() - by_topic["ate_rmse_m"].as_f64().unwrap();
    assert!(difference.abs() < 1e-6, "{difference}: the file has nine decimals");
    assert!(json(&["replay", "bags/demo.bag", "--json"])["ate_rmse_m"].is_null());
}

/// `UPDATE_GOLDEN=1 cargo test` updates the file.
#[test]
fn the_demo_trajectory_is_the_golden_one() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("demo.tum");
    json(&["replay", "bags/demo.bag", "--tum", out.to_str().unwrap(), "--json"]);
    let golden = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden/demo.tum");
    if std::env::var_os("UPDATE_GOLDEN").is_some() {
        fs::copy(&out, &golden).unwrap();
    }
    let (found, expected) = (numbers(&out), numbers(&golden));
    assert_eq!(found.len(), expected.len());
    for (found, expected) in found.iter().zip(&expected) {
        // The last bits of sine and cosine differ between systems.
        let differs = found.iter().zip(expected).any(|(a, b)| (a - b).abs() > 1e-6);
        assert!(!differs, "{found:?} was {expected:?}");
    }
}

#[test]
fn a_second_run_is_byte_equal() {
    let folder = tempfile::tempdir().unwrap();
    let run = |name: &str, more: &[&str]| {
        let path = |ending: &str| folder.path().join(format!("{name}.{ending}")).to_str().unwrap().to_owned();
        let (tum, csv, svg) = (path("tum"), path("csv"), path("svg"));
        let mut arguments =
            vec!["replay", "bags/demo.bag", "--truth", "bags/demo.tum", "--tum", &tum, "--csv", &csv, "--plot", &svg, "--json"];
        arguments.extend(more);
        let output = anytime(&arguments);
        (output.stdout, [tum, csv, svg].map(|path| fs::read(path).unwrap()))
    };
    let with_budget = ["--clock", "virtual", "--time-budget", "60us"];
    let (first, second) = (run("a", &with_budget), run("b", &with_budget));
    assert!(first == second, "on a virtual clock everything is equal, even with a time budget");
    assert!(String::from_utf8(first.1[1].clone()).unwrap().contains("budget"), "the budget must have cut refinements short");
    let (first, second) = (run("c", &[]), run("d", &[]));
    assert_eq!(first.1[0], second.1[0]);
    assert_eq!(first.1[2], second.1[2]);
}

#[test]
fn every_variant_matches_the_demo() {
    for correspondence in ["naive", "jump_table", "kd_tree"] {
        for solver in ["point_to_line", "point_to_point", "levenberg_marquardt", "linearized"] {
            let (search, solver) = (format!("matching.correspondence={correspondence}"), format!("matching.solver={solver}"));
            let summary =
                json(&["replay", "bags/demo.bag", "--truth", "bags/demo.tum", "--json", "--set", &search, "--set", &solver]);
            let limit = if solver.ends_with("point_to_point") { 0.2 } else { 0.02 };
            assert!(summary["ate_rmse_m"].as_f64().unwrap() < limit, "{search} {solver}: {summary}");
            assert_eq!(summary["failed"], 0, "{search} {solver}");
        }
    }
}

#[test]
fn unusable_bags_are_reported_with_a_remedy() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    assert!(failure(&["replay", "no/such.bag"], 1).contains("no/such.bag"));
    let text = path("text.bag");
    fs::write(&text, "this is no bag\n").unwrap();
    assert!(failure(&["replay", &text], 1).contains("text.bag"));
    let idle = anytime(&["replay", "bags/demo.bag", "--json", "--set", "matching.solver=point_to_point"]);
    assert!(String::from_utf8(idle.stderr).unwrap().contains("point_to_point has no effect"));
    let no_topic = failure(&["replay", "bags/demo.bag", "--scan-topic", "/scam"], 1);
    assert!(no_topic.contains("/scam") && no_topic.contains("/scan"), "{no_topic}");
    let wrong_type = failure(&["replay", "bags/demo.bag", "--scan-topic", "/odom"], 1);
    assert!(wrong_type.contains("nav_msgs/Odometry") && wrong_type.contains("sensor_msgs/LaserScan"), "{wrong_type}");
    let no_odometry = failure(&["replay", "bags/demo.bag", "--odom-topic", "/wheels"], 1);
    assert!(no_odometry.contains("/wheels"), "{no_odometry}");
    let no_imu = failure(&["replay", "bags/demo.bag", "--imu-topic", "/imu"], 1);
    assert!(no_imu.contains("/imu") && no_imu.contains("sensor_msgs/Imu"), "{no_imu}");
    let typo = failure(&["replay", "bags/demo.bag", "--set", "matching.max_iteration=5"], 2);
    assert!(typo.contains("matching.max_iterations"), "{typo}");
    let no_truth = failure(&["replay", "bags/demo.bag", "--truth", "nowhere.tum"], 1);
    assert!(no_truth.contains("nowhere.tum"), "{no_truth}");
    let no_folder = failure(&["replay", "bags/demo.bag", "--tum", "no/such/folder.tum"], 1);
    assert!(no_folder.contains("no/such/folder.tum"), "{no_folder}");
    failure(&["replay"], 2);
    failure(&["replay", "bags/demo.bag", "--time-budget", "soon"], 2);
}

/// An IMU that reports a rotation although the robot stands still: with a single classic iteration, the headings show whether the IMU was used,
/// until it is rejected.
#[test]
fn the_imu_of_a_bag_is_used_for_prediction() {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("imu.bag");
    let at = |i: u32| Stamp::from_ros(1000, i * 50_000_000);
    let mut writer = BagWriter::create(&bag, Compression::None).unwrap();
    for i in 0..10 {
        let mut imu = Imu::default();
        imu.header.stamp = at(i).into();
        imu.angular_velocity.z = if i == 5 { f64::NAN } else { 2.0 };
        writer.write("/imu", at(i), &imu).unwrap();
        writer.write("/scan", at(i), &Laser::with_field_of_view(270.0, 361).message(at(i), Pose2::IDENTITY)).unwrap();
    }
    writer.finish().unwrap();
    let heading = |more: &[&str]| {
        let tum = folder.path().join("out.tum");
        let settings =
            ["--set", "matching.correspondence=jump_table", "--set", "matching.max_iterations=1", "--set", "odometry.max_wait=0"];
        let files = ["replay", bag.to_str().unwrap(), "--json", "--tum", tum.to_str().unwrap()];
        let summary = json(&[&files[..], &settings, more].concat());
        let most = numbers(&tum).iter().map(|pose| pose[6].abs()).fold(0.0, f64::max);
        (most, summary["problems"].to_string())
    };
    let ((with, problems), (without, _)) = (heading(&["--imu-topic", "/imu"]), heading(&[]));
    assert!(without < 1e-6 && with > 1e-6, "{without} {with}");
    assert!(problems.contains("the velocity has numbers that are not finite"), "{problems}");
}

#[test]
fn a_truncated_bag_is_used_up_to_its_end() {
    let folder = tempfile::tempdir().unwrap();
    let cut: PathBuf = folder.path().join("cut.bag");
    let whole = fs::read(Path::new(env!("CARGO_MANIFEST_DIR")).join("bags/demo.bag")).unwrap();
    fs::write(&cut, &whole[..whole.len() * 2 / 3]).unwrap();
    let summary = json(&["replay", cut.to_str().unwrap(), "--json"]);
    let scans = summary["scans"].as_u64().unwrap();
    assert!((100..400).contains(&scans) && summary["failed"] == 0, "{summary}");
    assert!(!summary["problems"].as_array().unwrap().is_empty(), "the loss must be reported: {summary}");
}
