//! The exit code of a run: 0 on success, 1 on failure, 2 on wrong usage.

use std::fmt::Display;
use std::process::ExitCode;

use anytime_scan_matcher::config::ConfigError;
use anytime_scan_matcher::output::SameFile;
use anytime_scan_matcher::profile::ProfileError;
use thiserror::Error;

/// The arguments are wrong.
#[derive(Debug, Error)]
#[error("{0}")]
struct Usage(String);

/// A failure that still has output to show.
#[derive(Debug, Error)]
#[error("{problem}")]
pub(crate) struct FailureWithOutput {
    /// The text for standard output.
    pub(crate) text: String,
    problem: String,
}

/// Creates an error for wrong arguments.
pub(crate) fn usage(problem: impl Display) -> anyhow::Error {
    Usage(problem.to_string()).into()
}

/// Returns `text` if there is no problem, else the failure with this output.
pub(crate) fn output_or_failure(text: String, problem: Option<String>) -> anyhow::Result<String> {
    match problem {
        None => Ok(text),
        Some(problem) => Err(FailureWithOutput { text, problem }.into()),
    }
}

/// The exit code of an error.
pub(crate) fn exit_code(error: &anyhow::Error) -> ExitCode {
    let config = error.downcast_ref::<ConfigError>().or(match error.downcast_ref() {
        Some(ProfileError::Config(error)) => Some(error),
        _ => None,
    });
    let of_config = config.is_some_and(|error| !matches!(error, ConfigError::Unreadable { .. }));
    let is_usage = of_config || error.is::<Usage>() || error.is::<SameFile>();
    ExitCode::from(if is_usage { 2 } else { 1 })
}
