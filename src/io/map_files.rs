//! The files of a map: `PREFIX.yaml` and `PREFIX.pgm` as `map_saver` writes them, and `PREFIX.graph`, from which mapping can
//! continue.

use std::io::{self, Write};
use std::path::{Path, PathBuf};

use thiserror::Error;

use super::map_file;
use crate::map::grid::OccupancyGrid;
use crate::output::OutputFile;

/// A map file cannot be written.
#[derive(Debug, Error)]
#[error("cannot {action} {}: {error}", .path.display())]
pub struct MapFilesError {
    action: &'static str,
    path: PathBuf,
    error: io::Error,
}

fn failed(action: &'static str, path: &Path) -> impl FnOnce(io::Error) -> MapFilesError {
    move |error| MapFilesError { action, path: path.into(), error }
}

/// Paths of the files of a map.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MapPaths {
    /// The YAML file that describes the map.
    pub yaml: PathBuf,
    /// The image of the map.
    pub image: PathBuf,
    /// The pose graph with the scans of the keyframes.
    pub graph: PathBuf,
}

impl MapPaths {
    /// Paths of the map `prefix`, a path without an extension.
    pub fn new(prefix: &Path) -> Self {
        Self { yaml: append(prefix, ".yaml"), image: append(prefix, ".pgm"), graph: append(prefix, ".graph") }
    }
}

/// Appends an extension to a path, without replacing one that is there.
pub fn append(prefix: &Path, extension: &str) -> PathBuf {
    let mut name = prefix.as_os_str().to_owned();
    name.push(extension);
    name.into()
}

/// The files of a map being written: existing files are kept until all of the new ones are complete.
#[derive(Debug)]
pub struct MapFiles {
    paths: MapPaths,
    yaml: OutputFile,
    image: OutputFile,
    graph: OutputFile,
}

impl MapFiles {
    /// Begins the files; fails at once if the folder is not writable.
    pub fn create(paths: MapPaths) -> Result<Self, MapFilesError> {
        let create = |path: &Path| OutputFile::create(path).map_err(failed("create", path));
        let [yaml, image, graph] = [create(&paths.yaml)?, create(&paths.image)?, create(&paths.graph)?];
        Ok(Self { paths, yaml, image, graph })
    }

    /// Writes a map and its serialized graph.
    pub fn write(&mut self, map: &OccupancyGrid, graph: &[u8]) -> Result<(), MapFilesError> {
        let image = &self.paths.image;
        map_file::write(map, image, &mut self.yaml, &mut self.image).map_err(failed("write", image))?;
        self.graph.write_all(graph).map_err(failed("write", &self.paths.graph))
    }

    /// Moves the complete files to their paths.
    pub fn commit(&mut self) -> Result<(), MapFilesError> {
        let MapPaths { yaml, image, graph } = &self.paths;
        for (file, path) in [(&mut self.graph, graph), (&mut self.image, image), (&mut self.yaml, yaml)] {
            file.commit().map_err(failed("move the new file to", path))?;
        }
        Ok(())
    }
}
