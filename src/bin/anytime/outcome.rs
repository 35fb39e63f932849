//! How a run ends: exit code 0 when it has done what it was asked, 1 when it failed, 2 when it was asked for what makes no sense.

use std::fmt::Display;
use std::process::ExitCode;

use anytime_scan_matcher::config::ConfigError;
use anytime_scan_matcher::output::SameFile;
use anytime_scan_matcher::profile::ProfileError;
use thiserror::Error;

/// The arguments make no sense.
#[derive(Debug, Error)]
#[error("{0}")]
struct Usage(String);

/// A failure that has something to show.
#[derive(Debug, Error)]
#[error("{problem}")]
pub(crate) struct Hollow {
    /// For standard output.
    pub(crate) text: String,
    problem: String,
}

/// The error for arguments that make no sense.
pub(crate) fn usage(problem: impl Display) -> anyhow::Error {
    Usage(problem.to_string()).into()
}

/// `text` if there is nothing wrong with it; else the error that shows it all the same.
pub(crate) fn shown(text: String, problem: Option<String>) -> anyhow::Result<String> {
    match problem {
        None => Ok(text),
        Some(problem) => Err(Hollow { text, problem }.into()),
    }
}

/// The exit code that an error asks for.
pub(crate) fn exit_code(error: &anyhow::Error) -> ExitCode {
    let config = error.downcast_ref::<ConfigError>().or(match error.downcast_ref() {
        Some(ProfileError::Config(error)) => Some(error),
        _ => None,
    });
    let of_config = config.is_some_and(|error| !matches!(error, ConfigError::Unreadable { .. }));
    let is_usage = of_config || error.is::<Usage>() || error.is::<SameFile>();
    ExitCode::from(if is_usage { 2 } else { 1 })
}
