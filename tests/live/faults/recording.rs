//! SIGKILL while files are written: they must contain everything until then, up to the last complete line.

use std::fs;
use std::path::Path;
use std::process::Command;
use std::time::Duration;

use anytime_scan_matcher::io::tum;
use csv::StringRecord;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use tempfile::TempDir;

use super::bench::Bench;
use crate::common::drive;
use crate::common::graph::{Process, eventually};

/// The complete lines of a file.
fn whole_lines(path: &Path) -> String {
    let text = fs::read_to_string(path).unwrap_or_default();
    text[..text.rfind('\n').map_or(0, |end| end + 1)].to_owned()
}

/// The complete rows of a table, each with as many fields as the header.
fn rows(path: &Path) -> Vec<StringRecord> {
    csv::Reader::from_reader(whole_lines(path).as_bytes()).records().map(Result::unwrap).collect()
}

/// Kills `process` at a random time after `file` has this number of lines.
fn kill_after(process: Process, file: &Path, lines: usize, rng: &mut Pcg64) {
    assert!(eventually(|| whole_lines(file).lines().count() > lines), "{}", process.log());
    std::thread::sleep(Duration::from_millis(rng.random_range(0..100)));
    process.signal("KILL");
    drop(process); // waits until it has ended
}

fn anytime(arguments: &[&Path]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_anytime"));
    command.args(arguments);
    command
}

#[test]
fn a_killed_replay_leaves_every_earlier_answer() {
    let dir = TempDir::new().unwrap();
    let bag = dir.path().join("drive.bag");
    drive::write_with_beams(&bag, 4000, 181, |_| ());
    let mut rng = Pcg64::seed_from_u64(7);
    for round in 0..5 {
        let [csv, trajectory] = ["csv", "tum"].map(|end| dir.path().join(format!("{round}.{end}")));
        let command = anytime(&["replay".as_ref(), &bag, "--csv".as_ref(), &csv, "--tum".as_ref(), &trajectory]);
        kill_after(Process::spawn(command, dir.path()), &trajectory, 20, &mut rng);
        let poses = tum::parse(&whole_lines(&trajectory), &trajectory).unwrap().poses().len();
        let rows = rows(&csv).len();
        assert!(poses > 20 && rows.abs_diff(poses) <= 1, "{poses} poses, {rows} rows");
        eprintln!("killed after {poses} poses");
    }
}

#[test]
fn a_killed_study_leaves_every_earlier_run() {
    const SCANS: usize = 100;
    let dir = TempDir::new().unwrap();
    let bag = dir.path().join("drive.bag");
    drive::write_with_beams(&bag, 100, 181, |_| ());
    let mut rng = Pcg64::seed_from_u64(8);
    for round in 0..5 {
        let out = dir.path().join(format!("study{round}"));
        let mut command = anytime(&["profile".as_ref(), &bag, "--out".as_ref(), &out]);
        command.args(["--truth", "/odom", "--knob", "max_iterations", "--rounds", "1000"]);
        command.args(["--variant", "projective+point_to_line", "--variant", "kd_tree+point_to_point"]);
        kill_after(Process::spawn(command, dir.path()), &out.join("runs.csv"), 5, &mut rng);
        let runs = rows(&out.join("runs.csv"));
        for variant in ["projective+point_to_line", "kd_tree+point_to_point"] {
            let scans = rows(&out.join(format!("scans/{variant}.csv"))).len();
            let of_variant = runs.iter().filter(|run| &run[0] == variant).count();
            assert!(scans >= of_variant * SCANS, "{variant}: {scans} scans of {of_variant} runs");
            eprintln!("killed after {of_variant} runs of {variant}, {scans} of their scans");
        }
    }
}

#[test]
fn a_killed_demo_controller_leaves_a_row_for_every_earlier_report() {
    let Some(mut bench) = Bench::start(181) else { return };
    for round in 0..3 {
        let table = bench.graph.dir.path().join(format!("{round}.csv"));
        let argument = format!("_csv:={}", table.display());
        let demo = bench.graph.spawn(env!("CARGO_BIN_EXE_contract_demo"), &[&argument]);
        let mut answered = 0;
        assert!(
            eventually(|| {
                bench.step();
                answered += 1;
                rows(&table).len() > 20
            }),
            "{}",
            demo.log()
        );
        demo.signal("KILL");
        drop(demo);
        let rows = rows(&table);
        assert!(rows.len() <= answered, "{} rows", rows.len());
        eprintln!("killed after {} rows", rows.len());
    }
}
