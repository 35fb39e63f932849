//! The offline tool; it does not need ROS.
#![allow(clippy::print_stderr)] // a program speaks to its user

mod configuration;
mod convert;
mod drive;
mod evaluate;
mod files;
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
mod shell;
mod simulate;
mod simulation_flags;
mod terminal;

use std::io::{self, Write};
use std::process::ExitCode;

use clap::error::ErrorKind;
use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};

/// Match, simulate and evaluate laser scans offline, without ROS
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
    Drive(Box<drive::Arguments>),
    Completions(shell::Completions),
    Man(shell::Man),
}

/// The command line interface. Negative numbers are parsed as values, not as flags, so that an error can name the value.
fn command() -> clap::Command {
    let allow_negative = |argument: clap::Arg| {
        let takes_value = argument.get_action().takes_values();
        if takes_value { argument.allow_negative_numbers(true) } else { argument }
    };
    let names: Vec<String> = Cli::command().get_subcommands().map(|command| command.get_name().to_owned()).collect();
    let with_numbers = |command: clap::Command, name| command.mut_subcommand(name, |command| command.mut_args(allow_negative));
    names.into_iter().fold(Cli::command(), with_numbers)
}

fn main() -> ExitCode {
    let cli = match command().try_get_matches().and_then(|matches| Cli::from_arg_matches(&matches)) {
        Ok(cli) => cli,
        Err(help) if help.kind() == ErrorKind::DisplayHelp => {
            return print(&terminal::colours(&help.render()), terminal::width());
        }
        Err(error) => error.exit(),
    };
    let is_for_programs = matches!(cli.command, Command::Completions(_) | Command::Man(_));
    let width = if is_for_programs { None } else { terminal::width() };
    let outcome = match cli.command {
        Command::Replay(arguments) => replay::run(&arguments),
        Command::Localize(arguments) => localize::run(&arguments),
        Command::Map(arguments) => map::run(&arguments),
        Command::Profile(arguments) => profile::run(&arguments),
        Command::Info(arguments) => info::run(&arguments),
        Command::Simulate(arguments) => simulate::run(&arguments),
        Command::Evaluate(arguments) => evaluate::run(&arguments),
        Command::Convert(arguments) => convert::run(&arguments),
        Command::Drive(arguments) => drive::run(&arguments),
        Command::Completions(arguments) => shell::completions(&arguments, Cli::command()),
        Command::Man(arguments) => shell::man(&arguments, Cli::command()),
    };
    match outcome {
        Ok(text) => print(&text, width),
        Err(error) => {
            let printed = error.downcast_ref::<outcome::FailureWithOutput>().map(|failure| print(&failure.text, width));
            eprintln!("anytime: {error:#}");
            printed.filter(|code| *code != ExitCode::SUCCESS).unwrap_or_else(|| outcome::exit_code(&error))
        }
    }
}

/// Prints the result. A reader that closes the pipe early (`anytime info X.bag | head`) is not an error.
fn print(text: &str, width: Option<usize>) -> ExitCode {
    match writeln!(io::stdout().lock(), "{}", terminal::wrap(text.trim_end(), width)) {
        Err(error) if error.kind() != io::ErrorKind::BrokenPipe => {
            eprintln!("anytime: cannot write the result: {error}");
            ExitCode::FAILURE
        }
        _ => ExitCode::SUCCESS,
    }
}
