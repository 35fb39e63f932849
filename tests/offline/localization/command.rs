//! `anytime localize`: its output for good and bad maps.

use serde_json::Value;

use crate::common::program::{anytime, json};
use crate::common::shared;

/// The summary for a case in the shipped corridor.
fn in_the_corridor(case: &str) -> Option<Value> {
    let bag = shared(&format!("cases/{case}.bag"))?;
    let truth = bag.with_file_name("truth").join("b270.tum");
    let [bag, truth] = [&bag, &truth].map(|path| path.to_str().unwrap());
    Some(json(&["localize", bag, "--map", "maps/corridor.yaml", "--json", "--truth", truth]))
}

#[test]
fn rays_without_a_return_are_not_walls() {
    let Some(summary) = in_the_corridor("k1_nothing_seen_is_range_max") else { return };
    assert!(summary["localized"] == 200 && summary["position_rmse_m"].as_f64().unwrap() <= 0.1, "{summary}");
}

/// Four seconds without a usable ray, in which the robot drives 7 m.
#[test]
fn before_the_first_usable_scan_the_robot_moves_by_odometry() {
    let Some(summary) = in_the_corridor("k10_blind_start") else { return };
    assert!(summary["position_rmse_m"].as_f64().unwrap() <= 0.1, "{summary}");
}

/// Along a corridor whose walls do not constrain the motion; it is measured by matching with the scans before.
#[test]
fn the_robot_is_tracked_by_scans_alone() {
    let demo = ["localize", "bags/demo.bag", "--map", "maps/corridor.yaml", "--truth", "bags/demo.tum"];
    let summary = json(&[&demo[..], &["--json", "--scan-only"]].concat());
    assert!(summary["localized"] == 400 && summary["position_rmse_m"].as_f64().unwrap() <= 0.05, "{summary}");
    assert!(summary["problems"].to_string().contains("matching them to earlier scans"), "{summary}");
}

#[test]
fn a_map_of_another_place_is_reported_with_exit_code_1() {
    let Some(map) = shared("data/maps/skirk.yaml") else { return };
    let files = tempfile::tempdir().unwrap();
    let csv = files.path().join("scans.csv");
    let demo = ["localize", "bags/demo.bag", "--map", map.to_str().unwrap(), "--truth", "bags/demo.tum"];
    let few = ["--particles", "1000", "--set", "localization.global_particles=20000"];
    let output = anytime(&[&demo[..], &few, &["--json", "--csv", csv.to_str().unwrap()]].concat());
    assert_eq!(output.status.code(), Some(1));
    let summary: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert!(summary["outcome"] == "not_localized" && summary["mean_explained"].as_f64().unwrap() < 0.5, "{summary}");
    assert!(String::from_utf8_lossy(&output.stderr).contains("Check the map and its scale"), "{output:?}");
    // The available figures are in the file nevertheless.
    let mut rows = csv::Reader::from_path(&csv).unwrap();
    let column = rows.headers().unwrap().iter().position(|name| name == "localized").unwrap();
    let localized: Vec<bool> = rows.records().map(|row| &row.unwrap()[column] == "true").collect();
    assert!(localized.len() == 400 && localized.iter().filter(|&&localized| localized).count() < 20);
}
