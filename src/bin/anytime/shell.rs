//! `anytime completions` and `anytime man`: shell completions and manual pages.

use anyhow::Context as _;
use clap::{Args, Command};
use clap_complete::Shell;

use crate::outcome::usage;

/// Print the completion script for a shell
#[derive(Args)]
pub(crate) struct Completions {
    shell: Shell,
}

/// Print the manual page of `anytime` or of one of its commands
#[derive(Args)]
pub(crate) struct Man {
    /// The command
    command: Option<String>,
}

pub(crate) fn completions(arguments: &Completions, mut program: Command) -> anyhow::Result<String> {
    let mut script = Vec::new();
    let name = program.get_name().to_owned();
    clap_complete::generate(arguments.shell, &mut program, name, &mut script);
    String::from_utf8(script).context("cannot write the completions")
}

pub(crate) fn man(arguments: &Man, mut program: Command) -> anyhow::Result<String> {
    program.build();
    let page = match &arguments.command {
        None => program,
        Some(name) => program.find_subcommand(name).cloned().ok_or_else(|| usage(format!("there is no command {name}")))?,
    };
    let mut text = Vec::new();
    let version = concat!("anytime ", env!("CARGO_PKG_VERSION"));
    clap_mangen::Man::new(page)
        .source(version)
        .manual("anytime_scan_matcher")
        .render(&mut text)
        .context("cannot write the manual page")?;
    String::from_utf8(text).context("cannot write the manual page")
}
