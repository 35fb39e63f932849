//! The files that a map is kept in: `PREFIX.yaml` and `PREFIX.pgm` as `map_saver` writes them, and `PREFIX.graph` to go on with.

use std::io::{self, Write};
use std::path::{Path, PathBuf};

use thiserror::Error;

use super::map_file;
use crate::map::grid::OccupancyGrid;
use crate::output::OutputFile;

/// A file that cannot be written.
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

/// What the files are called.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MapPaths {
    /// The map.
    pub yaml: PathBuf,
    /// Its image.
    pub image: PathBuf,
    /// What it was made of.
    pub graph: PathBuf,
}

impl MapPaths {
    /// Of a map that is called `prefix`, a path without an ending.
    pub fn new(prefix: &Path) -> Self {
        Self { yaml: ending(prefix, ".yaml"), image: ending(prefix, ".pgm"), graph: ending(prefix, ".graph") }
    }
}

/// A path with something after it.
pub fn ending(prefix: &Path, ending: &str) -> PathBuf {
    let mut name = prefix.as_os_str().to_owned();
    name.push(ending);
    name.into()
}

/// The files, being written: older ones stay until all of the new ones are whole.
#[derive(Debug)]
pub struct MapFiles {
    paths: MapPaths,
    yaml: OutputFile,
    image: OutputFile,
    graph: OutputFile,
}

impl MapFiles {
    /// Begins them; fails at once if the folder cannot be written to.
    pub fn create(paths: MapPaths) -> Result<Self, MapFilesError> {
        let create = |path: &Path| OutputFile::create(path).map_err(failed("create", path));
        let [yaml, image, graph] = [create(&paths.yaml)?, create(&paths.image)?, create(&paths.graph)?];
        Ok(Self { paths, yaml, image, graph })
    }

    /// Writes a map and the bytes of its graph.
    pub fn write(&mut self, map: &OccupancyGrid, graph: &[u8]) -> Result<(), MapFilesError> {
        let image = &self.paths.image;
        map_file::write(map, image, &mut self.yaml, &mut self.image).map_err(failed("write", image))?;
        self.graph.write_all(graph).map_err(failed("write", &self.paths.graph))
    }

    /// The files are whole: moves them to their places.
    pub fn commit(&mut self) -> Result<(), MapFilesError> {
        let MapPaths { yaml, image, graph } = &self.paths;
        for (file, path) in [(&mut self.graph, graph), (&mut self.image, image), (&mut self.yaml, yaml)] {
            file.commit().map_err(failed("put in its place", path))?;
        }
        Ok(())
    }
}
