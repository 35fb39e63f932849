//! A node in C++ to compare with.

use std::path::Path;
use std::process::Command;

use crate::common::graph::{Graph, Process, installed};
use crate::common::skipped::skip;
use crate::common::wire::Listener;

const HEADER: &str = "/usr/include/ros/ros.h";
const LIBRARIES: [&str; 5] = ["-lroscpp", "-lrosconsole", "-lroscpp_serialization", "-lrostime", "-lboost_thread"];

/// Starts the echo, which answers each scan with a pose. `None` where roscpp or a compiler is not installed.
pub fn start_echo(graph: &Graph) -> Option<Process> {
    if !installed("c++") {
        return None;
    }
    if !Path::new(HEADER).exists() {
        skip(&format!("{HEADER} of roscpp is not installed"));
        return None;
    }
    let program = graph.dir.path().join("echo");
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/live/faults/echo.cpp");
    let mut compiler = Command::new("c++");
    compiler.args(["-O2", "-Wall", "-Wextra", "-Werror"]).arg(source).args(LIBRARIES).arg("-o").arg(&program);
    let output = compiler.output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    Some(graph.spawn(program.to_str().unwrap(), &[]))
}

/// Somebody who hears the echo.
pub fn hear_echo(graph: &Graph) -> Listener {
    Listener::of(graph, "/echo", "/echo")
}
