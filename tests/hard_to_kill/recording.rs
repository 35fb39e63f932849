//! SIGKILL while files are written: they hold every answer until then.

use std::fs;
use std::path::Path;
use std::process::Command;
use std::time::Duration;

use anytime_scan_matcher::io::tum;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use tempfile::TempDir;

use crate::drive;
use crate::graph::{Process, eventually};

/// The whole lines of a file.
fn whole_lines(path: &Path) -> String {
    let text = fs::read_to_string(path).unwrap_or_default();
    text[..text.rfind('\n').map_or(0, |end| end + 1)].to_owned()
}

#[test]
fn what_was_written_before_a_kill_can_be_read() {
    let dir = TempDir::new().unwrap();
    let bag = dir.path().join("drive.bag");
    drive::write_with_beams(&bag, 4000, 181, |_| ());
    let mut rng = Pcg64::seed_from_u64(7);
    for round in 0..5 {
        let [csv, trajectory] = ["csv", "tum"].map(|end| dir.path().join(format!("{round}.{end}")));
        let mut command = Command::new(env!("CARGO_BIN_EXE_anytime"));
        command.arg("replay").arg(&bag).arg("--csv").arg(&csv).arg("--tum").arg(&trajectory);
        let replay = Process::spawn(command, dir.path());
        assert!(eventually(|| whole_lines(&trajectory).lines().count() > 20), "{}", replay.log());
        std::thread::sleep(Duration::from_millis(rng.random_range(0..100)));
        replay.signal("KILL");
        drop(replay);
        let poses = tum::parse(&whole_lines(&trajectory), &trajectory).unwrap().poses().len();
        let table = whole_lines(&csv);
        let rows: Vec<csv::StringRecord> = csv::Reader::from_reader(table.as_bytes()).records().map(Result::unwrap).collect();
        assert!(poses > 20 && rows.len().abs_diff(poses) <= 1, "{poses} poses, {} rows", rows.len());
        eprintln!("killed after {poses} poses");
    }
}
