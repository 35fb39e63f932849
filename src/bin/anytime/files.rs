//! The files that a run reads and writes.

use std::ffi::OsStr;
use std::fs;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use anytime_scan_matcher::config::Config;
use anytime_scan_matcher::io::map_file;
use anytime_scan_matcher::output::{NamedPath, OutputFile, check_no_overwrite};
use serde_json::Value;

use crate::input_flags::InputFlags;

/// The files that a run reads and writes.
#[derive(Default)]
pub(crate) struct Files<'a> {
    inputs: Vec<NamedPath<'a>>,
    outputs: Vec<NamedPath<'a>>,
}

impl<'a> Files<'a> {
    pub(crate) fn read(mut self, role: &'a str, path: Option<&'a Path>) -> Self {
        self.inputs.extend(path.map(|path| (role, path.into())));
        self
    }

    /// Adds a map and its image.
    pub(crate) fn read_map(mut self, role: &'a str, path: Option<&'a Path>) -> Self {
        self.inputs.extend(path.and_then(map_file::image_of).map(|image| ("the image of the map", image.into())));
        self.read(role, path)
    }

    pub(crate) fn written(mut self, role: &'a str, path: Option<&'a Path>) -> Self {
        self.outputs.extend(path.map(|path| (role, path.into())));
        self
    }

    /// Adds the files named by the flags and the parameters.
    pub(crate) fn with_flags(self, flags: &'a InputFlags, config: &'a Config) -> Self {
        let path = |name: &'a Option<String>| name.as_deref().map(Path::new);
        self.read("--truth", path(&flags.truth))
            .read("--config", flags.configuration.file())
            .read("contract.profile", path(&config.contract.profile))
            .read_map("localization.map", path(&config.localization.map))
    }

    /// The output of a run that has written its files: `value` as JSON, or `text`. Lists the written files on standard error.
    pub(crate) fn output(&self, as_json: bool, value: impl FnOnce() -> Value, text: impl FnOnce() -> String) -> String {
        self.outputs.iter().for_each(|(_, path)| eprintln!("wrote {}", path.display()));
        if as_json { value().to_string() } else { text() }
    }

    /// Rejects an output that is also an input or another output.
    pub(crate) fn check(&self) -> anyhow::Result<()> {
        Ok(check_no_overwrite(&self.inputs, &self.outputs)?)
    }
}

/// Creates an output file. It gets its name when it is complete.
pub(crate) fn create(path: &Path) -> anyhow::Result<OutputFile> {
    OutputFile::create(path).with_context(|| format!("cannot create {}", path.display()))
}

/// Creates a folder for output files, unless it exists.
pub(crate) fn create_folder(path: &Path) -> anyhow::Result<()> {
    fs::create_dir_all(path).with_context(|| format!("cannot create the folder {}", path.display()))
}

/// Parses the name of an SVG file.
pub(crate) fn svg_path(text: &str) -> Result<PathBuf, String> {
    let path = PathBuf::from(text);
    match path.extension().and_then(OsStr::to_str) {
        Some(kind) if !kind.eq_ignore_ascii_case("svg") => {
            Err(format!("only SVG plots are supported, not {kind}: use a name that ends in .svg"))
        }
        _ => Ok(path),
    }
}
