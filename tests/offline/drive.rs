//! Tests of `anytime drive` and of the closed loop behind it.

use std::fs;

use serde_json::Value;

use crate::common::program::{failure, json, success};

fn cases(arguments: &[&str]) -> Vec<Value> {
    json(&[&["drive", "--json"], arguments].concat())["cases"].as_array().unwrap().clone()
}

fn number(case: &Value, path: &[&str]) -> f64 {
    path.iter().fold(case, |value, name| &value[*name]).as_f64().unwrap_or(f64::NAN)
}

#[test]
fn every_law_drives_laps_of_the_corridor_by_the_truth() {
    for law in ["proportional", "pure_pursuit", "stanley"] {
        let case = &cases(&["--estimator", "truth", "--law", law, "--laps", "1", "--speed", "5", "--seeds", "2"])[0];
        assert_eq!((number(case, &["finished"]), number(case, &["wall_hits"])), (2.0, 0.0), "{law}: {case}");
        assert!(number(case, &["lateral_error_m", "max"]) < 0.25, "{law}: {case}");
    }
}

#[test]
fn steering_trim_is_compensated() {
    let by_truth = ["--estimator", "truth", "--laps", "1", "--speed", "5", "--seeds", "3"];
    let with =
        |offset: &str| number(&cases(&[&by_truth[..], &["--steering-offset", offset]].concat())[0], &["lateral_error_m", "mean"]);
    let (straight, with_offset) = (with("0"), with("1"));
    assert!(with_offset < straight + 0.01, "{straight} m with straight wheels, {with_offset} m with a steering offset");
}

#[test]
fn equal_seeds_give_equal_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let files = ["report.html", "figures.json", "path_1_seed_1.svg"];
    let drive = || {
        let out = folder.path().to_str().unwrap();
        let bursts = ["drive", "--laps", "1", "--slowdown", "x100", "--bursts", "x5", "--policy", "fixed:10ms", "--beams", "361"];
        success(&[&bursts[..], &["--seeds", "2", "--out", out]].concat());
        files.map(|name| fs::read(folder.path().join(name)).unwrap())
    };
    let (first, second) = (drive(), drive());
    assert!(first == second);
    let page = String::from_utf8(first[0].clone()).unwrap();
    assert!(page.contains("fixed:10ms") && page.contains("<svg") && !page.contains("<script"));
}

#[test]
fn answers_are_delayed_by_the_time_of_their_work() {
    let age = |slowdown: &str| {
        let arguments = ["--laps", "1", "--speed", "2", "--estimator", "scan_matcher", "--beams", "361", "--slowdown", slowdown];
        let case = &cases(&arguments)[0];
        (number(case, &["pose_age_s", "mean"]), number(case, &["processor_s_per_lap"]), number(case, &["dropped_scans"]))
    };
    let ((quick, little, none), (slow, much, some)) = (age("1"), age("x400"));
    assert!(slow > quick + 0.01 && none == 0.0 && some > 0.0, "{quick} {slow} {some}");
    // Fewer scans are processed, and each costs 400 times as much.
    assert!((40.0..800.0).contains(&(much / little)), "{little} {much}");
}

#[test]
fn late_paths_cause_no_jump_and_no_stop() {
    let arguments = ["--estimator", "truth", "--laps", "1", "--speed", "7", "--replan", "5", "--path-delay", "2s"];
    let case = &cases(&arguments)[0];
    assert_eq!((number(case, &["finished"]), number(case, &["stopped"])), (1.0, 0.0), "{case}");
    assert!(number(case, &["path_step_m"]) < 0.05, "{case}");
}

#[test]
fn a_table_outside_its_conditions_causes_a_warning() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().to_str().unwrap();
    let profile = ["profile", "--world", "room", "--duration", "3s", "--beams", "90", "--knob", "time_budget", "--rounds", "1"];
    let variant = ["--variant", "projective+point_to_line", "--clock", "virtual", "--out", out];
    success(&[&profile[..], &variant].concat());
    let drive = ["--estimator", "scan_matcher", "--laps", "1", "--speed", "3", "--beams", "361", "--policy", "table"];
    let own = &cases(&drive)[0];
    assert_eq!((number(own, &["finished"]), number(own, &["outside_profile"])), (1.0, 0.0), "{own}");
    let errors = |name: &str| own["modes"].as_array().unwrap().iter().map(|mode| number(mode, &[name])).collect::<Vec<_>>();
    for errors in [errors("error_m"), errors("heading_error_rad")] {
        assert!(errors.len() > 3 && errors.is_sorted_by(|less_time, more| less_time >= more), "{errors:?}");
    }
    let file = format!("contract.profile={out}/profile.yaml");
    let text = success(&[&["drive"], &drive[..], &["--set", &file, "--out", out]].concat());
    assert!(text.contains("warning: ") && text.contains("outside the conditions of the profile: rays 361"), "{text}");
    assert!(fs::read_to_string(folder.path().join("report.html")).unwrap().contains("outside the conditions of the profile"));
}

#[test]
fn invalid_arguments_are_rejected_with_a_remedy() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str, text: &str| {
        let path = folder.path().join(name);
        fs::write(&path, text).unwrap();
        path.to_str().unwrap().to_owned()
    };
    let (broken, wall, open) =
        (file("b.csv", "1,2\nx,y,z\n"), file("w.csv", "0,-7.5\n1,-7.5\n"), file("o.csv", "0,-6.1\n5,-6\n"));
    for (arguments, code, words) in [
        (&["--policy", "slow"][..], 2, "fixed:TIME"),
        (&["--follow", "lookahead=1"], 2, "no such parameter"),
        (&["--path", &broken], 1, "line 2"),
        (&["--path", &wall], 1, "touches a wall"),
        (&["--path", &open], 1, "--laps 1"),
        (&["--estimator", "particle_filter"], 1, "maps/corridor.yaml"),
        (&["--costs", "no/such.yaml"], 1, "no/such.yaml"),
        (&["--policy", "table", "--set", "contract.profile=no/such.yaml"], 1, "no/such.yaml"),
        (&["--slowdown", "x0"], 2, "factor"),
    ] {
        let text = failure(&[&["drive"], arguments].concat(), code);
        assert!(text.contains(words), "{arguments:?}: {text}");
    }
    let text = failure(&["drive", "--world", "nowhere"], 2);
    assert!(text.contains("there is no map file of this name"), "{text}");
}
