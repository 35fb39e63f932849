//! `anytime profile` on a short simulated drive: its files, equal reruns, agreement of its figures with `evaluate`, and wrong usage.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

use anytime_scan_matcher::io::profile_file::Profile;
use serde_json::Value;

use crate::common::program::{failure, json, success};

/// A bag of 40 scans of 180 beams from a moving robot, and its truth.
fn drive(folder: &Path) -> (String, String) {
    let path = |name: &str| folder.join(name).to_str().unwrap().to_owned();
    let (bag, truth) = (path("drive.bag"), path("drive.tum"));
    let simulate = ["simulate", "--world", "room", "--duration", "3s", "--rate", "20", "--beams", "180"];
    success(&[&simulate[..], &["--out", &bag, "--truth", &truth]].concat());
    (bag, truth)
}

fn two_variants<'a>(bag: &'a str, truth: &'a str, knob: &'a str, values: &'a str, out: &'a str) -> Vec<&'a str> {
    let variants = ["--variant", "jump_table+point_to_line", "--variant", "kd_tree+point_to_point"];
    [&["profile", bag, "--truth", truth, "--knob", knob, "--values", values, "--out", out, "--rounds", "2"], &variants[..]]
        .concat()
}

fn table(path: &Path) -> Vec<Vec<String>> {
    let text = fs::read_to_string(path).unwrap();
    text.lines().map(|line| line.split(',').map(str::to_owned).collect()).collect()
}

/// A table without the columns that depend on the wall clock.
fn without_delays(path: &Path) -> Vec<Vec<String>> {
    let mut table = table(path);
    let is_delay: Vec<bool> = table[0].iter().map(|name| name.contains("delay")).collect();
    assert!(is_delay.contains(&true), "{}", path.display());
    for row in &mut table {
        let mut column = is_delay.iter();
        row.retain(|_| !column.next().unwrap());
    }
    table
}

fn column(table: &[Vec<String>], name: &str) -> Vec<f64> {
    let index = table[0].iter().position(|column| column == name).unwrap();
    table[1..].iter().map(|row| row[index].parse().unwrap()).collect()
}

const TABLES: [&str; 4] = ["summary.csv", "runs.csv", "scans/jump_table+point_to_line.csv", "scans/kd_tree+point_to_point.csv"];
const PICTURES: [&str; 6] =
    ["trajectories", "poses", "pose_errors", "delay_by_iterations", "residual_by_iteration", "search_time"];

#[test]
fn reruns_differ_only_in_delays_and_all_files_are_written() {
    let folder = tempfile::tempdir().unwrap();
    let (bag, truth) = drive(folder.path());
    let out = |name: &str| folder.path().join(name);
    for (knob, values) in [("max_iterations", "1,2,8"), ("keyframe_distance", "0,0.5")] {
        let (first, second) = (out(&format!("{knob}1")), out(&format!("{knob}2")));
        for folder in [&first, &second] {
            success(&two_variants(&bag, &truth, knob, values, folder.to_str().unwrap()));
        }
        for name in TABLES {
            assert_eq!(without_delays(&first.join(name)), without_delays(&second.join(name)), "{knob}: {name}");
        }
        let cases = 2 * values.split(',').count();
        assert_eq!(table(&first.join("summary.csv")).len(), 1 + cases);
        assert_eq!(table(&first.join("runs.csv")).len(), 1 + 2 * cases);
        assert_eq!(table(&first.join(TABLES[2])).len(), 1 + cases * 60);
        let report = fs::read_to_string(first.join("report.html")).unwrap();
        assert!(report.ends_with("</html>\n") && !report.contains("<script") && !report.contains("src="));
        for name in PICTURES.map(str::to_owned).into_iter().chain([format!("delay_error_{knob}")]) {
            let picture = fs::read_to_string(first.join(format!("{name}.svg"))).unwrap();
            assert!(picture.ends_with("</svg>\n") && report.contains(&picture), "{name}");
        }
    }
}

#[test]
fn on_the_virtual_clock_reruns_are_byte_equal() {
    let folder = tempfile::tempdir().unwrap();
    let (bag, truth) = drive(folder.path());
    let files = |name: &str| {
        let out = folder.path().join(name);
        let mut arguments = two_variants(&bag, &truth, "time_budget", "25us,60us,1ms", out.to_str().unwrap());
        arguments.extend(["--clock", "virtual"]);
        success(&arguments);
        let names = TABLES.iter().chain(&["profile.yaml", "delay_error_time_budget.svg", "trajectories.svg"]);
        let files = names.map(|name| fs::read_to_string(out.join(name)).unwrap()).collect::<Vec<_>>();
        (files, table(&out.join("summary.csv")))
    };
    let (first, second) = (files("a"), files("b"));
    assert!(first == second);
    let iterations = column(&first.1, "mean_iterations");
    assert!(iterations[0] < iterations[2], "the budget must have cut matches short: {iterations:?}");
}

#[test]
fn the_errors_are_those_of_evaluate() {
    let folder = tempfile::tempdir().unwrap();
    let (bag, truth) = drive(folder.path());
    let (out, tum) = (folder.path().join("out"), folder.path().join("two.tum"));
    success(&two_variants(&bag, &truth, "max_iterations", "2", out.to_str().unwrap()));
    success(&[
        "replay",
        &bag,
        "--tum",
        tum.to_str().unwrap(),
        "--set",
        "matching.max_iterations=2",
        "--set",
        "matching.correspondence=jump_table",
    ]);
    let report = json(&["evaluate", tum.to_str().unwrap(), "--truth", &truth, "--json"]);
    let summary = table(&out.join("summary.csv"));
    let (position, orientation) = (column(&summary, "position_rmse_m")[0], column(&summary, "orientation_rmse_rad")[0]);
    // The file has nine decimals.
    assert!((position - report["ate_rmse_m"].as_f64().unwrap()).abs() < 1e-8, "{position}: {report}");
    assert!((orientation.to_degrees() - report["ate_rmse_deg"].as_f64().unwrap()).abs() < 1e-6, "{orientation}: {report}");
    let scans = column(&table(&out.join(TABLES[2])), "position_error_m");
    let mean_square = scans.iter().map(|error| error * error).sum::<f64>() / scans.len() as f64;
    assert!((mean_square - column(&summary, "position_mse_m2")[0]).abs() < 1e-12);
}

#[test]
fn a_drive_is_simulated_and_its_profile_gives_the_expected_errors() {
    let folder = tempfile::tempdir().unwrap();
    let out: PathBuf = folder.path().join("study");
    let simulation = ["--world", "room", "--duration", "3s", "--rate", "20", "--beams", "90", "--seed", "5"];
    let study = ["--knob", "max_iterations", "--values", "1,4,30", "--variant", "jump_table+point_to_line", "--rounds", "1"];
    success(&[&["profile", "--out", out.to_str().unwrap()], &simulation[..], &study].concat());
    assert!(out.join("drive.bag").exists() && out.join("drive.tum").exists());
    let profile = Profile::load(&out.join("profile.yaml")).unwrap();
    assert_eq!((profile.provenance.scans, profile.provenance.beams, profile.provenance.seed), (60, 90, 5));
    let variant = profile.variant("jump_table+point_to_line").unwrap();
    let shortest = variant.budgets[0].delta_s;
    assert_eq!(variant.expected_error(Duration::from_secs_f64(0.9 * shortest)), None);
    let means: Vec<f64> = (0..100)
        .map(|k| {
            variant.expected_error(Duration::from_secs_f64(shortest * (1.001 + 0.1 * f64::from(k)))).unwrap().position_mean_m
        })
        .collect();
    assert!(means.windows(2).all(|pair| pair[1] <= pair[0]) && means.iter().all(|mean| *mean > 0.0), "{means:?}");
    assert!(profile.variant("jump_table+point_to_lime").unwrap_err().to_string().contains("did you mean"));
    assert_eq!(
        Profile::from_yaml(&profile.to_yaml().unwrap()).unwrap(),
        profile,
        "a written profile must be read back unchanged"
    );
    let [least, greatest] = variant.conditions.rays.unwrap();
    assert!(80.0 < least && greatest <= 90.0 && variant.conditions.agreement.unwrap()[0] > 0.5, "{:?}", variant.conditions);
    assert!(
        Profile::from_yaml(&profile.to_yaml().unwrap().replace("conditions", "circumstances")).is_ok(),
        "of earlier programs"
    );
    // The profile fits its own drive, but not one with another laser elsewhere.
    let file = format!("contract.profile={}", out.join("profile.yaml").display());
    let replayed = |bag: &str| {
        let jump_table = ["--set", "matching.correspondence=jump_table", "--set", &file, "--time-budget", "5ms"];
        success(&[&["replay", bag], &jump_table[..]].concat())
    };
    assert!(!replayed(out.join("drive.bag").to_str().unwrap()).contains("differ from those of contract.profile"));
    let elsewhere = replayed("bags/demo.bag");
    assert!(
        elsewhere.contains("scans differ from those of contract.profile") && elsewhere.contains("in the profile"),
        "{elsewhere}"
    );
}

/// A room, 12 m x 9 m with a block in it, as a map of `map_server`.
fn map_of_a_room(folder: &Path) -> String {
    let is_wall = |x: usize, y: usize| x < 2 || y < 2 || x > 237 || y > 177 || (90..140).contains(&x) && (70..110).contains(&y);
    let mut image = b"P5 240 180 255\n".to_vec();
    image.extend((0..240 * 180).map(|i| if is_wall(i % 240, i / 240) { 0_u8 } else { 254 }));
    fs::write(folder.join("room.pgm"), image).unwrap();
    let fields = "image: room.pgm\nresolution: 0.05\norigin: [-3, 1, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n";
    fs::write(folder.join("room.yaml"), fields).unwrap();
    folder.join("room.yaml").to_str().unwrap().into()
}

#[test]
fn the_particle_filter_is_profiled_beside_the_scan_matcher() {
    let folder = tempfile::tempdir().unwrap();
    let (map, out) = (map_of_a_room(folder.path()), folder.path().join("out"));
    let drive = ["--world", &map, "--duration", "4s", "--rate", "20", "--beams", "180"];
    let study = ["--map", &map, "--variant", "projective+point_to_line", "--rounds", "1", "--clock", "virtual"];
    let knobs = ["--knob", "max_iterations", "--knob", "particles", "--knob", "update_period"];
    success(&[&["profile", "--out", out.to_str().unwrap()], &drive[..], &study, &knobs].concat());
    let summary = table(&out.join("summary.csv"));
    let errors = |knob: &str| -> Vec<f64> {
        let column = summary[0].iter().position(|name| name == "position_rmse_m").unwrap();
        summary.iter().filter(|row| row[1] == knob).map(|row| row[column].parse().unwrap()).collect()
    };
    let (particles, period) = (errors("particles"), errors("update_period"));
    assert_eq!((particles.len(), period.len(), errors("max_iterations").len()), (8, 7, 7));
    assert!(particles[7] < 0.05 && particles[0] > particles[7], "{particles:?}");
    assert!(period[0] < 0.05 && period[6] > period[0], "the error must grow with the update period: {period:?}");
    // Before the first call of the timer there is no estimate to extrapolate: 26 scans of the seven periods.
    assert_eq!(table(&out.join("scans/particle_filter.csv")).len(), 1 + 15 * 80 - 26);
    let report = fs::read_to_string(out.join("report.html")).unwrap();
    for name in ["error_particles", "error_update_period", "delay_error_max_iterations", "delay_error_particles"] {
        assert!(report.contains(&fs::read_to_string(out.join(format!("{name}.svg"))).unwrap()), "{name}");
    }
    let no_map = failure(&["profile", "bags/demo.bag", "--out", "/tmp", "--variant", "particle_filter"], 2);
    assert!(no_map.contains("--map"), "{no_map}");
    let no_filter = failure(&["profile", "bags/demo.bag", "--out", "/tmp", "--knob", "particles"], 2);
    assert!(no_filter.contains("--map"), "{no_filter}");
}

#[test]
fn the_look_up_table_is_printed_and_compared_with_contracts() {
    let folder = tempfile::tempdir().unwrap();
    let (bag, truth) = drive(folder.path());
    let study = |out: &str, more: &[&str]| {
        let out = folder.path().join(out);
        let arguments = ["profile", &bag, "--truth", &truth, "--out", out.to_str().unwrap(), "--knob", "max_iterations"];
        let rest = ["--variant", "projective+point_to_line", "--rounds", "1", "--clock", "virtual"];
        let text = success(&[&arguments[..], &rest, more].concat());
        (text, fs::read_to_string(out.join("report.html")).unwrap())
    };
    let (text, report) = study("text", &[]);
    assert!(
        text.contains("delay = a + b * iterations + c * rays") && text.contains("R²") && !text.contains("contract"),
        "{text}"
    );
    assert!(report.contains("id=\"look_up\"") && report.contains("<th>R²</th>"));
    let (text, report) = study("both", &["--delta", "20us,80us,5ms", "--json"]);
    let json: Value = serde_json::from_str(&text).unwrap();
    let table = &json["look_up_tables"][0];
    let number = |value: &Value, name: &str| value[name].as_f64().unwrap_or(f64::NAN);
    // The virtual clock advances with each reading, which happens once an iteration, not once a ray.
    assert!(number(table, "b_us") > 4.0 && number(table, "c_us").abs() < 0.05 && number(table, "r_squared") > 0.9, "{table}");
    let comparisons = json["comparisons"].as_array().unwrap();
    assert_eq!((comparisons.len(), number(&json, "runs")), (3, 13.0), "7 cases, and two runs for each delta");
    let iterations: Vec<f64> = comparisons.iter().map(|c| number(&c["by_table"], "iterations")).collect();
    assert!(iterations[0].is_nan() && iterations[1] >= 1.0 && iterations[2] > iterations[1], "{iterations:?}");
    // Not even a prediction takes less than 40 us there.
    for comparison in &comparisons[1..] {
        let contract = &comparison["by_contract"];
        assert!(number(contract, "late") <= 0.05 && number(contract, "position_mean_m") > 0.0, "{comparison}");
    }
    assert!(report.contains("contract: iterations") && report.contains("<td>80µs</td>"), "the report must contain it, too");
    failure(&["profile", &bag, "--truth", &truth, "--out", "/tmp", "--delta", "0"], 2);
}

#[test]
fn mistakes_are_explained_with_a_remedy() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out").to_str().unwrap().to_owned();
    let profile = |more: &[&str], code| failure(&[&["profile", "--out", &out], more].concat(), code);
    let no_truth = profile(&["bags/demo.bag", "--knob", "max_iterations"], 2);
    assert!(no_truth.contains("--truth") && no_truth.contains("/gt_pose"), "{no_truth}");
    let knob = profile(&["bags/demo.bag", "--knob", "max_iteration"], 2);
    assert!(knob.contains("max_iterations | time_budget"), "{knob}");
    let value = profile(&["bags/demo.bag", "--knob", "max_iterations", "--values", "1,0"], 2);
    assert!(value.contains("matching.max_iterations") && value.contains("1 to 1000"), "{value}");
    let text = profile(&["bags/demo.bag", "--knob", "time_budget", "--values", "soon"], 2);
    assert!(text.contains("time_budget") && text.contains("5ms"), "{text}");
    let variant = profile(&["bags/demo.bag", "--variant", "jump_table+point_to_lin"], 2);
    assert!(variant.contains("did you mean 'jump_table+point_to_line'?"), "{variant}");
    profile(&[], 2);
    profile(&["bags/demo.bag", "--world", "room"], 2);
    profile(&["bags/demo.bag", "--speed", "3"], 2);
    profile(&["bags/demo.bag", "--values", "3"], 2);
    profile(&["bags/demo.bag", "--rounds", "0"], 2);
    let two_knobs = profile(&["bags/demo.bag", "--knob", "beams", "--knob", "max_iterations", "--values", "3"], 2);
    assert!(two_knobs.contains("--values"), "{two_knobs}");
    let no_file = profile(&["bags/demo.bag", "--knob", "max_iterations", "--truth", "no/such.tum"], 1);
    assert!(no_file.contains("no/such.tum"), "{no_file}");
    let blocked = folder.path().join("file");
    fs::write(&blocked, "").unwrap();
    let blocked = blocked.to_str().unwrap();
    let no_folder =
        failure(&["profile", "bags/demo.bag", "--knob", "max_iterations", "--truth", "/gt_pose", "--out", blocked], 1);
    assert!(no_folder.contains(blocked), "{no_folder}");
}
