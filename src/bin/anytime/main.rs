//! The offline tool: needs no ROS at all.
#![allow(clippy::print_stdout, clippy::print_stderr)] // a program speaks to its user

mod configuration;
mod evaluate;
mod info;
mod replay;
mod simulate;

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
enum Command {
    Replay(replay::Arguments),
    Info(info::Arguments),
    Simulate(simulate::Arguments),
    Evaluate(evaluate::Arguments),
}

fn main() -> ExitCode {
    let outcome = match Cli::parse().command {
        Command::Replay(arguments) => replay::run(&arguments),
        Command::Info(arguments) => info::run(&arguments),
        Command::Simulate(arguments) => simulate::run(&arguments),
        Command::Evaluate(arguments) => evaluate::run(&arguments),
    };
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("anytime: {error:#}");
            ExitCode::FAILURE
        }
    }
}
