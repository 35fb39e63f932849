//! Runs the program `anytime`.

use std::process::{Command, Output};

use serde_json::Value;

pub fn anytime(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_anytime")).args(arguments).current_dir(env!("CARGO_MANIFEST_DIR")).output().unwrap()
}

/// The output of a run that must succeed.
pub fn success(arguments: &[&str]) -> String {
    let output = anytime(arguments);
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

/// The JSON output of a run that must succeed.
pub fn json(arguments: &[&str]) -> Value {
    serde_json::from_str(&success(arguments)).unwrap()
}

/// The error text of a run that must fail with this exit code.
pub fn failure(arguments: &[&str], code: i32) -> String {
    let output = anytime(arguments);
    assert_eq!(output.status.code(), Some(code), "{arguments:?}: {}", String::from_utf8_lossy(&output.stdout));
    String::from_utf8(output.stderr).unwrap()
}
