//! What the programs of all nodes do with their arguments: those that are not ROS's.

use std::env;
use std::os::unix::process::CommandExt as _;
use std::process::{Command, ExitCode};

use anytime_scan_matcher::knobs::KnobInfo;
use anytime_scan_matcher::ros::NodeError;

/// A node as its program.
pub(crate) struct NodeProgram<'a> {
    pub(crate) name: &'a str,
    /// The help, up to the parameters.
    pub(crate) usage: &'a str,
    /// Path and description of every parameter.
    pub(crate) parameters: Vec<(String, KnobInfo)>,
    pub(crate) run: fn() -> Result<(), NodeError>,
}

impl NodeProgram<'_> {
    /// Runs the node, unless the arguments, those that are not ROS's, ask for something else.
    pub(crate) fn main(&self, arguments: &[String]) -> ExitCode {
        match arguments.first().map(String::as_str) {
            None => self.run_node(),
            Some("-h" | "--help") => {
                println!("{}", self.usage);
                for (path, knob) in &self.parameters {
                    println!("  {path} ({}; default {}): {}", knob.accepts, knob.default, knob.help);
                }
                ExitCode::SUCCESS
            }
            Some("-V" | "--version") => {
                println!("{} {}", self.name, env!("CARGO_PKG_VERSION"));
                ExitCode::SUCCESS
            }
            Some(argument) => {
                eprintln!("{0}: unexpected argument '{argument}': see {0} --help", self.name);
                ExitCode::from(2)
            }
        }
    }

    fn run_node(&self) -> ExitCode {
        limit_arenas();
        match (self.run)() {
            Ok(()) => ExitCode::SUCCESS,
            Err(error) => {
                eprintln!("{}: {error}", self.name);
                ExitCode::FAILURE
            }
        }
    }
}

/// Starts the program once more in this process, with a limit to the C library's memory arenas, unless that has been set: it takes the
/// limit from the environment that a program starts with, and nowhere else. Every thread may have an arena, and each reserves 64 MB of
/// addresses. Where addresses are limited (`ulimit -v`), that alone would leave none for another thread.
fn limit_arenas() {
    const LIMIT: &str = "MALLOC_ARENA_MAX";
    if env::var_os(LIMIT).is_none()
        && let Ok(program) = env::current_exe()
    {
        // Returns only when it has failed; then there is no limit.
        let _ = Command::new(program).args(env::args_os().skip(1)).env(LIMIT, "2").exec();
    }
}

/// The arguments that are not ROS's.
pub(crate) fn own_arguments() -> Vec<String> {
    let all = env::args_os().skip(1).map(|argument| argument.to_string_lossy().into_owned());
    all.filter(|argument| !argument.contains(":=")).collect()
}
