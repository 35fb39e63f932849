//! The offline tool: needs no ROS at all.
#![allow(clippy::print_stderr)] // a program speaks to its user

mod configuration;
mod convert;
mod evaluate;
mod info;
mod input_flags;
mod knob_flags;
mod localize;
mod map;
mod outcome;
mod profile;
mod profile_flags;
mod progress;
mod replay;
mod replay_flags;
mod simulate;
mod simulation_flags;

use std::io::{self, ErrorKind, Write};
use std::process::ExitCode;

use clap::{Parser, Subcommand};

/// Match, simulate and evaluate laser scans from bags.
#[derive(Parser)]
#[command(name = "anytime", version)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
#[allow(clippy::large_enum_variant)] // parsed once
enum Command {
    Replay(Box<replay_flags::Arguments>),
    Localize(Box<localize::Arguments>),
    Map(Box<map::Arguments>),
    Profile(Box<profile_flags::Arguments>),
    Info(info::Arguments),
    Simulate(Box<simulate::Arguments>),
    Evaluate(evaluate::Arguments),
    Convert(convert::Arguments),
}

fn main() -> ExitCode {
    let outcome = match Cli::parse().command {
        Command::Replay(arguments) => replay::run(&arguments),
        Command::Localize(arguments) => localize::run(&arguments),
        Command::Map(arguments) => map::run(&arguments),
        Command::Profile(arguments) => profile::run(&arguments),
        Command::Info(arguments) => info::run(&arguments),
        Command::Simulate(arguments) => simulate::run(&arguments),
        Command::Evaluate(arguments) => evaluate::run(&arguments),
        Command::Convert(arguments) => convert::run(&arguments),
    };
    match outcome {
        Ok(text) => print(&text),
        Err(error) => {
            let shown = error.downcast_ref::<outcome::Hollow>().map(|hollow| print(&hollow.text));
            eprintln!("anytime: {error:#}");
            shown.filter(|code| *code != ExitCode::SUCCESS).unwrap_or_else(|| outcome::exit_code(&error))
        }
    }
}

/// A reader that has seen enough (`anytime info X.bag | head`) is no failure.
fn print(text: &str) -> ExitCode {
    match writeln!(io::stdout().lock(), "{}", text.trim_end()) {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => {
            eprintln!("anytime: cannot write the result: {error}");
            ExitCode::FAILURE
        }
        _ => ExitCode::SUCCESS,
    }
}
