//! The arguments for the parameters, shared by the subcommands.

use std::path::{Path, PathBuf};

use anytime_scan_matcher::config::{Config, ConfigError};
use clap::Args;

#[derive(Args)]
pub(crate) struct Configuration {
    /// Read parameters from a YAML file, as the node does
    #[arg(long, value_name = "FILE.yaml")]
    config: Option<PathBuf>,
    /// Set one parameter, such as `matching.max_iterations=8`; may be repeated
    #[arg(long, value_name = "NAME=VALUE")]
    set: Vec<String>,
}

impl Configuration {
    /// The YAML file, if one is given.
    pub(crate) fn file(&self) -> Option<&Path> {
        self.config.as_deref()
    }

    pub(crate) fn load(&self) -> Result<Config, ConfigError> {
        let mut config = Config::default();
        if let Some(path) = &self.config {
            config.set_file(path)?;
        }
        for assignment in &self.set {
            config.set_assignment(assignment)?;
        }
        config.check_frames(&self.config.as_deref().map_or("--set".into(), |path| path.display().to_string()))?;
        config.warnings().iter().for_each(|warning| eprintln!("anytime: {warning}"));
        Ok(config)
    }
}
