//! The particle filter on long drives: no false alarms, and its error on a recording of `racecar_simulator`.

use std::path::Path;

use serde_json::Value;

use crate::common::program::{json, success};
use crate::common::shared;

/// The JSON summary of the program.
fn localize(bag: &Path, map: &Path, truth: &str, particles: u32) -> Value {
    let [bag, map] = [bag, map].map(|path| path.to_str().unwrap());
    let options = ["--json", "--clock", "processor", "--particles", &particles.to_string()];
    json(&[&["localize", bag, "--map", map, "--truth", truth], &options[..]].concat())
}

#[test]
fn ten_drives_of_two_minutes_raise_no_false_alarm() {
    let folder = tempfile::tempdir().unwrap();
    for seed in 1..=10 {
        // Combine each map with each number of particles.
        let name = ["levine", "columbia", "skirk"][seed % 3];
        let particles = [1000, 2000, 4000][(seed + seed / 3) % 3];
        let Some(map) = shared(&format!("data/maps/{name}.yaml")) else { return };
        let bag = folder.path().join("drive.bag");
        let [world, out] = [&map, &bag].map(|path| path.to_str().unwrap());
        success(&["simulate", "--duration", "120s", "--seed", &seed.to_string(), "--world", world, "--out", out]);
        let summary = localize(&bag, &map, "/gt_pose", particles);
        println!("{name}, {particles} particles, seed {seed}: {summary}");
        assert_eq!(summary["localized"], summary["scans"], "{name}, {particles} particles, seed {seed}: {summary}");
        assert!(summary["position_max_m"].as_f64().unwrap() < 0.3, "{summary}");
    }
}

#[test]
fn a_recording_of_racecar_simulator_with_range_errors_up_to_5_cm_is_tracked() {
    let (Some(bag), Some(map)) = (shared("data/racecar-levine/racecar-levine.bag"), shared("data/maps/levine.yaml")) else {
        return;
    };
    let summary = localize(&bag, &map, bag.with_file_name("truth.tum").to_str().unwrap(), 4000);
    println!("{summary}");
    assert!(summary["position_rmse_m"].as_f64().unwrap() <= 0.05 && summary["localized"] == summary["scans"], "{summary}");
}
