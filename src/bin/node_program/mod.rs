//! Command-line handling shared by the programs of all nodes, for arguments that are not ROS's.

use std::env;
use std::os::unix::process::CommandExt as _;
use std::process::{Command, ExitCode};

use anytime_scan_matcher::knobs::KnobInfo;
use anytime_scan_matcher::ros::NodeError;

/// The program of a node.
pub(crate) struct NodeProgram<'a> {
    pub(crate) name: &'a str,
    /// The help text before the list of parameters.
    pub(crate) usage: &'a str,
    /// Path and description of every parameter.
    pub(crate) parameters: Vec<(String, KnobInfo)>,
    pub(crate) run: fn() -> Result<(), NodeError>,
}

impl NodeProgram<'_> {
    /// Runs the node, or prints the help or the version if `arguments` (without those of ROS) ask for it.
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

/// Restarts the program in this process with a limit on the memory arenas of the C library, unless one is set already. The C
/// library reads the limit only from the environment at the start of a program. Every thread may have an arena, and each arena
/// reserves 64 MB of address space. If address space is limited (`ulimit -v`), arenas alone could use it up so that no further
/// thread can start.
fn limit_arenas() {
    const LIMIT: &str = "MALLOC_ARENA_MAX";
    if env::var_os(LIMIT).is_none()
        && let Ok(program) = env::current_exe()
    {
        // Returns only on failure; then there is no limit.
        let _ = Command::new(program).args(env::args_os().skip(1)).env(LIMIT, "2").exec();
    }
}

/// The arguments of the program, without those of ROS.
pub(crate) fn own_arguments() -> Vec<String> {
    let all = env::args_os().skip(1).map(|argument| argument.to_string_lossy().into_owned());
    all.filter(|argument| !argument.contains(":=")).collect()
}
