//! Records a replay: the summary in memory, and the requested files.

use std::io;
use std::path::{Path, PathBuf};

use thiserror::Error;

use super::map_sketch::MapSketch;
use super::row::MatchRow;
use super::summary::Summary;
use crate::app::sensed::SensorMessage;
use crate::app::{App, Estimate};
use crate::geometry::Point;
use crate::io::bag::BagError;
use crate::io::csv_file::CsvFile;
use crate::io::tum::TumWriter;
use crate::output::OutputFile;

/// Why a replay failed.
#[derive(Debug, Error)]
pub enum RecordError {
    /// The bag cannot be read.
    #[error(transparent)]
    Bag(#[from] BagError),
    /// A file cannot be written.
    #[error("cannot write {path}: {error}")]
    Write {
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        error: io::Error,
    },
}

/// The files to write.
#[derive(Clone, Debug, Default)]
pub struct OutputFiles {
    /// TUM file with the pose of every scan.
    pub tum: Option<PathBuf>,
    /// CSV file with a row for every scan.
    pub csv: Option<PathBuf>,
}

/// Records every answer of a replay. Each is written at once; existing files are replaced by [`Self::finish`].
pub struct Recorder {
    files: OutputFiles,
    tum: Option<TumWriter<OutputFile>>,
    csv: Option<CsvFile<OutputFile, MatchRow>>,
    sketch: Option<MapSketch>,
    summary: Summary,
}

impl Recorder {
    /// Opens the files. With `sketch`, also collects points of the scans for a plot.
    pub fn create(files: OutputFiles, sketch: bool) -> Result<Self, RecordError> {
        let tum = files.tum.as_deref().map(create).transpose()?.map(TumWriter::new);
        let csv = match files.csv.as_deref() {
            Some(path) => Some(CsvFile::new(create(path)?, MatchRow::COLUMNS).map_err(|error| failed(path, error.into()))?),
            None => None,
        };
        Ok(Self { files, tum, csv, sketch: sketch.then(MapSketch::default), summary: Summary::default() })
    }

    /// Records the answer to a scan.
    pub fn add(&mut self, scan: &SensorMessage, estimate: &Estimate, app: &mut App) -> Result<(), RecordError> {
        let row = MatchRow::new(estimate, app);
        let pose = self.summary.add(&row);
        if let (Some(tum), Some(path)) = (&mut self.tum, &self.files.tum) {
            tum.write(&pose).map_err(|error| failed(path, error))?;
        }
        if let (Some(csv), Some(path)) = (&mut self.csv, &self.files.csv) {
            csv.write(&row).map_err(|error| failed(path, error.into()))?;
        }
        if let Some(sketch) = &mut self.sketch {
            sketch.add(scan, estimate, app);
        }
        Ok(())
    }

    /// Moves the complete files to their paths.
    pub fn finish(&mut self) -> Result<(), RecordError> {
        if let (Some(tum), Some(path)) = (self.tum.take(), &self.files.tum) {
            tum.into_sink().commit().map_err(|error| failed(path, error))?;
        }
        if let (Some(csv), Some(path)) = (self.csv.take(), &self.files.csv) {
            csv.into_sink().and_then(|mut file| file.commit()).map_err(|error| failed(path, error))?;
        }
        Ok(())
    }

    /// The summary so far.
    pub fn summary(&self) -> &Summary {
        &self.summary
    }

    /// Points of the scans in the map frame, m, if they are collected.
    pub fn points(&self) -> Option<&[Point]> {
        self.sketch.as_ref().map(MapSketch::points)
    }
}

fn create(path: &Path) -> Result<OutputFile, RecordError> {
    OutputFile::create_growing(path).map_err(|error| failed(path, error))
}

fn failed(path: &Path, error: io::Error) -> RecordError {
    RecordError::Write { path: path.into(), error }
}
