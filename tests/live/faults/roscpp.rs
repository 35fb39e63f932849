//! A C++ node for comparison.

use std::path::{Path, PathBuf};
use std::process::Command;

use tempfile::TempDir;

use crate::common::graph::{Graph, Process, installed};
use crate::common::skipped::skip;
use crate::common::wire::Listener;

const HEADER: &str = "/usr/include/ros/ros.h";
const LIBRARIES: [&str; 5] = ["-lroscpp", "-lrosconsole", "-lroscpp_serialization", "-lrostime", "-lboost_thread"];

/// The echo node, which answers each scan with a pose.
pub struct Echo {
    dir: TempDir,
}

impl Echo {
    /// Compiles it. `None` if roscpp or a compiler is not installed.
    pub fn compile() -> Option<Self> {
        if !installed("c++") {
            return None;
        }
        if !Path::new(HEADER).exists() {
            skip(&format!("{HEADER} of roscpp is not installed"));
            return None;
        }
        let echo = Self { dir: TempDir::new().unwrap() };
        let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/live/faults/echo.cpp");
        let mut compiler = Command::new("c++");
        compiler.args(["-O2", "-Wall", "-Wextra", "-Werror"]).arg(source).args(LIBRARIES).arg("-o").arg(echo.program());
        let output = compiler.output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        Some(echo)
    }

    fn program(&self) -> PathBuf {
        self.dir.path().join("echo")
    }

    pub fn start(&self, graph: &Graph) -> Process {
        graph.spawn(self.program().to_str().unwrap(), &[])
    }

    /// A subscriber to its poses.
    pub fn listener(graph: &Graph) -> Listener {
        Listener::of(graph, "/echo", "/echo")
    }
}
