//! Tests the header with a C program, compiled as C and as C++.

use std::collections::HashMap;
use std::io::{BufRead, BufReader};
use std::mem::offset_of;
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;

use anytime_scan_matcher::shared_memory::Responder;
use anytime_scan_matcher::shared_memory::layout::{MAGIC, SIZE, Segment, VERSION};

use super::node::{unique, work};

const HANDSHAKES: u32 = 5_000;

/// Compiles the program; `false` if there is no compiler.
fn compile(compiler: &str, language: &[&str], program: &Path) -> bool {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let output = Command::new(compiler)
        .args(["-O2", "-Wall", "-Wextra", "-Wpedantic", "-Wshadow", "-Werror"])
        .args(language)
        .arg("-I")
        .arg(root.join("include"))
        .arg(root.join("tests/offline/shared_memory/handshakes.c"))
        .args(["-lm", "-lrt", "-o"])
        .arg(program)
        .output();
    let Ok(output) = output else {
        crate::common::skipped::skip(&format!("there is no compiler {compiler}"));
        return false;
    };
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    true
}

/// Offsets and sizes on the Rust side.
fn layout() -> HashMap<String, u64> {
    let offset = |name: &str, offset: usize| (name.to_owned(), offset as u64);
    HashMap::from([
        ("magic_number".to_owned(), MAGIC),
        ("version_number".to_owned(), VERSION.into()),
        ("segment_size".to_owned(), SIZE.into()),
        offset("version", offset_of!(Segment, identity.version)),
        offset("size", offset_of!(Segment, identity.size)),
        offset("owner", offset_of!(Segment, identity.owner)),
        offset("closed", offset_of!(Segment, identity.closed)),
        offset("requested", offset_of!(Segment, controller.requested)),
        offset("acknowledged", offset_of!(Segment, node.acknowledged)),
        offset("completed", offset_of!(Segment, node.completed)),
        offset("idle", offset_of!(Segment, node.idle)),
        offset("sequence", offset_of!(Segment, estimate.sequence)),
        offset("flags", offset_of!(Segment, estimate.flags)),
        offset("number", offset_of!(Segment, estimate.number)),
        offset("stamp_seconds", offset_of!(Segment, estimate.stamp_seconds)),
        offset("stamp_nanoseconds", offset_of!(Segment, estimate.stamp_nanoseconds)),
        offset("x", offset_of!(Segment, estimate.x)),
        offset("y", offset_of!(Segment, estimate.y)),
        offset("theta", offset_of!(Segment, estimate.theta)),
        offset("position_deviation", offset_of!(Segment, estimate.position_deviation)),
        offset("heading_deviation", offset_of!(Segment, estimate.heading_deviation)),
        offset("elapsed_nanoseconds", offset_of!(Segment, estimate.elapsed_nanoseconds)),
    ])
}

/// Runs the program against a node; returns its output, and the number of estimates published.
fn run(program: &Path, segment: &str) -> (HashMap<String, u64>, u32) {
    let responder = Responder::create(segment).unwrap();
    let mut child = Command::new(program)
        .args([segment, &HANDSHAKES.to_string()])
        .stdout(Stdio::piped())
        .stderr(Stdio::inherit())
        .spawn()
        .unwrap();
    let mut reported = HashMap::new();
    let mut lines = BufReader::new(child.stdout.take().unwrap()).lines().map(|line| {
        let line = line.unwrap();
        let (name, value) = line.split_once(' ').unwrap();
        (name.to_owned(), value.parse().unwrap())
    });
    let stop = AtomicBool::new(false);
    let published = thread::scope(|scope| {
        let node = scope.spawn(|| work(&responder, 4, &stop));
        reported.extend(lines.by_ref().take_while(|(name, _)| name != "handshakes_done"));
        stop.store(true, Ordering::Relaxed);
        node.join().unwrap()
    });
    drop(responder);
    reported.extend(lines);
    assert!(child.wait().unwrap().success());
    (reported, published)
}

#[test]
fn a_controller_in_c_or_cpp_works_with_the_node() {
    let folder = tempfile::tempdir().unwrap();
    for (compiler, language) in [("cc", ["-x", "c", "-std=c11"]), ("c++", ["-x", "c++", "-std=c++11"])] {
        let program = folder.path().join(compiler);
        if compile(compiler, &language, &program) {
            let (reported, published) = run(&program, &unique(&format!("in_{}", compiler.replace('+', "p"))));
            let mut expected = layout();
            expected.insert("edges".into(), published.into());
            assert_eq!(reported, expected);
        }
    }
}
