//! Tests that are skipped on this machine. They are reported at once, bypassing the test runner's capture of output, and counted at the
//! end of `cargo test` by `tests/tally.rs`.

use std::fs::{self, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// Reports that the calling test is skipped, and why.
pub fn skip(reason: &str) {
    let thread = std::thread::current();
    let test = thread.name().unwrap_or("a test");
    let _ = writeln!(io::stderr(), "SKIPPED: {test}: {reason}");
    let file = records();
    fs::create_dir_all(file.parent().unwrap()).unwrap();
    let mut file = OpenOptions::new().create(true).append(true).open(file).unwrap();
    file.write_all(format!("{test}: {reason}\n").as_bytes()).unwrap();
}

/// All tests skipped by the test programs of this run of cargo, one per line. The record is deleted.
pub fn take_skipped() -> Vec<String> {
    let file = records();
    let text = fs::read_to_string(&file).unwrap_or_default();
    let _ = fs::remove_dir_all(file.parent().unwrap());
    text.lines().map(String::from).collect()
}

/// One file for each run of cargo, identified by the parent process of its test programs.
fn records() -> PathBuf {
    Path::new(env!("CARGO_TARGET_TMPDIR")).join("skipped").join(std::os::unix::process::parent_id().to_string())
}
