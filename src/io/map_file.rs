//! Occupancy maps in the format of `map_server`: an image, and a YAML file that describes it.

use std::fmt::Display;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use serde::Deserialize;
use thiserror::Error;

use super::gray_image::GrayImage;
use super::yaml;
use crate::geometry::Pose2;
use crate::map::grid::{Cell, OccupancyGrid};

/// Why a map cannot be read. Every message names the file.
#[derive(Debug, Error)]
pub enum MapError {
    /// The YAML file cannot be read.
    #[error("cannot read the map {}: {error}", .path.display())]
    Unreadable {
        /// The YAML file.
        path: PathBuf,
        /// The error of the operating system.
        error: std::io::Error,
    },
    /// The YAML file does not describe a map.
    #[error(
        "map {}: {problem} (a map file needs image, resolution, origin, negate, occupied_thresh and free_thresh)",
        .path.display()
    )]
    NotAMap {
        /// The YAML file.
        path: PathBuf,
        /// What is wrong with it.
        problem: String,
    },
    /// A field has an invalid value.
    #[error("map {}: {field} is {value}: {remedy}", .path.display())]
    BadField {
        /// The YAML file.
        path: PathBuf,
        /// Name of the field.
        field: &'static str,
        /// Its value.
        value: String,
        /// What its value must be.
        remedy: &'static str,
    },
    /// The image cannot be read.
    #[error(
        "map {}: image {}: {problem} (the field `image` is the path of a PNG or PGM file, relative to the map file)",
        .path.display(),
        .image.display()
    )]
    BadImage {
        /// The YAML file.
        path: PathBuf,
        /// The image file.
        image: PathBuf,
        /// What is wrong.
        problem: String,
    },
}

/// Writes a map as `map_saver` does: the image in three shades of grey, and the YAML file. The YAML file refers to the image by
/// its file name only, so that both can be moved together.
pub fn write(map: &OccupancyGrid, image_path: &Path, yaml: &mut impl Write, image: &mut impl Write) -> io::Result<()> {
    let (resolution, origin) = (map.resolution(), map.origin());
    let name = image_path.file_name().unwrap_or_default().to_string_lossy();
    write!(
        yaml,
        "image: {name}\nresolution: {resolution:.6}\norigin: [{:.6}, {:.6}, {:.6}]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n\n",
        origin.x, origin.y, origin.theta
    )?;
    write!(image, "P5\n# CREATOR: map_saver.cpp {resolution:.3} m/pix\n{} {}\n255\n", map.width(), map.height())?;
    let shade = |cell: &Cell| match cell {
        Cell::Occupied => 0,
        Cell::Free => 254,
        Cell::Unknown => 205,
    };
    let shades: Vec<u8> = map.cells().chunks_exact(map.width()).rev().flatten().map(shade).collect();
    image.write_all(&shades)
}

/// Content of the YAML file. Fields that other programs add are ignored.
#[derive(Deserialize)]
struct Description {
    image: PathBuf,
    resolution: f64,
    origin: [f64; 3],
    negate: u8,
    occupied_thresh: f64,
    free_thresh: f64,
    mode: Option<String>,
}

/// Reads a map from its YAML file.
pub fn read(path: &Path) -> Result<OccupancyGrid, MapError> {
    let text = std::fs::read_to_string(path).map_err(|error| MapError::Unreadable { path: path.into(), error })?;
    let not_a_map = |problem: String| MapError::NotAMap { path: path.into(), problem };
    let description: Description = yaml::from_str(&text).map_err(not_a_map)?;
    check(&description, path)?;
    let (width, cells) = read_cells(&description, path)?;
    let [x, y, yaw] = description.origin;
    OccupancyGrid::new(width, description.resolution, Pose2::new(x, y, yaw), cells).map_err(|error| not_a_map(error.to_string()))
}

/// Path of the image of a map; `None` if the YAML file cannot be read or names no image.
pub fn image_of(path: &Path) -> Option<PathBuf> {
    #[derive(Deserialize)]
    struct Named {
        image: PathBuf,
    }
    let named: Named = yaml::from_str(&std::fs::read_to_string(path).ok()?).ok()?;
    Some(image_path(path, &named.image))
}

/// Path of the image that the YAML file `path` names: relative to the folder of the YAML file.
fn image_path(path: &Path, image: &Path) -> PathBuf {
    path.parent().unwrap_or(Path::new("")).join(image)
}

fn check(map: &Description, path: &Path) -> Result<(), MapError> {
    let bad = |field, value: &dyn Display, remedy| {
        Err(MapError::BadField { path: path.into(), field, value: value.to_string(), remedy })
    };
    if !(map.resolution.is_finite() && map.resolution > 0.0) {
        return bad("resolution", &map.resolution, "it must be the size of a pixel in metres, above 0");
    }
    if !map.origin.iter().all(|number| number.is_finite()) {
        return bad(
            "origin",
            &format!("{:?}", map.origin),
            "it must be [x, y, yaw] of the lower left pixel, in metres and radians",
        );
    }
    if map.negate > 1 {
        return bad("negate", &map.negate, "it must be 0 (dark is occupied) or 1 (light is occupied)");
    }
    for (field, threshold) in [("occupied_thresh", map.occupied_thresh), ("free_thresh", map.free_thresh)] {
        if !(0.0..=1.0).contains(&threshold) {
            return bad(field, &threshold, "it must be a probability between 0 and 1");
        }
    }
    if map.free_thresh >= map.occupied_thresh {
        return bad("free_thresh", &map.free_thresh, "it must be less than occupied_thresh");
    }
    match map.mode.as_deref() {
        None | Some("trinary") => Ok(()),
        Some(mode) => bad("mode", &mode, "only the mode trinary (free, occupied, unknown) is supported"),
    }
}

/// Reads the image: its width, and its pixels as cells, row by row from the lower left.
fn read_cells(map: &Description, path: &Path) -> Result<(usize, Vec<Cell>), MapError> {
    let image_path = image_path(path, &map.image);
    let image = GrayImage::read(&image_path).map_err(|problem| MapError::BadImage {
        path: path.into(),
        image: image_path.clone(),
        problem,
    })?;
    Ok((image.width(), image.rows().rev().flatten().map(|&shade| classify(shade, map)).collect()))
}

/// Classifies a pixel as `map_server` does: shades between the thresholds are unknown.
fn classify(shade: u8, map: &Description) -> Cell {
    let lightness = f64::from(shade) / 255.0;
    let occupancy = if map.negate == 1 { lightness } else { 1.0 - lightness };
    if occupancy > map.occupied_thresh {
        Cell::Occupied
    } else if occupancy < map.free_thresh {
        Cell::Free
    } else {
        Cell::Unknown
    }
}
