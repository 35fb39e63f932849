//! Conversion of maps from and to the message of `/map`.

use thiserror::Error;

use super::{InputError, planar_pose};
use crate::map::grid::{Cell, GridError, OccupancyGrid};
use crate::messages::nav_msgs;
use crate::messages::std_msgs::Header;

/// Minimum occupancy of a wall cell, %: the default threshold of `map_server`.
const MIN_OCCUPIED: i8 = 65;
/// Maximum occupancy of a free cell, %.
const MAX_FREE: i8 = 25;

/// Why a map message is unusable.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum MapMessageError {
    /// Its size or resolution is invalid.
    #[error("unusable map: {0}")]
    Grid(#[from] GridError),
    /// The number of cells does not match width and height.
    #[error("unusable map: {cells} cells do not make {width} x {height}")]
    Size {
        /// Number of columns.
        width: u32,
        /// Number of rows.
        height: u32,
        /// Number of cells.
        cells: usize,
    },
    /// The origin of the map is invalid.
    #[error("unusable map: invalid origin: {0}")]
    Origin(#[from] InputError),
}

/// Converts a message to a map.
pub fn grid(message: &nav_msgs::OccupancyGrid) -> Result<OccupancyGrid, MapMessageError> {
    let nav_msgs::MapMetaData { resolution, width, height, ref origin, .. } = message.info;
    let cells = message.data.len();
    if u64::from(width) * u64::from(height) != cells as u64 {
        return Err(MapMessageError::Size { width, height, cells });
    }
    let classify = |&occupancy: &i8| match occupancy {
        MIN_OCCUPIED.. => Cell::Occupied,
        0..=MAX_FREE => Cell::Free,
        _ => Cell::Unknown,
    };
    // The message carries the resolution in single precision: 0.050000000745 means 0.05.
    let resolution = (f64::from(resolution) * 1e7).round() / 1e7;
    let cells = message.data.iter().map(classify).collect();
    Ok(OccupancyGrid::new(width as usize, resolution, planar_pose(origin)?, cells)?)
}

/// Converts a map to a message in this frame. The stamp stays zero.
#[allow(clippy::cast_possible_truncation)] // the message carries 32 bits
pub fn message(grid: &OccupancyGrid, frame: &str) -> nav_msgs::OccupancyGrid {
    let occupancy = |cell: &Cell| match cell {
        Cell::Free => 0,
        Cell::Occupied => 100,
        Cell::Unknown => -1,
    };
    let info = nav_msgs::MapMetaData {
        resolution: grid.resolution() as f32,
        width: grid.width() as u32,
        height: grid.height() as u32,
        origin: grid.origin().into(),
        ..nav_msgs::MapMetaData::default()
    };
    let header = Header { frame_id: frame.into(), ..Header::default() };
    nav_msgs::OccupancyGrid { header, info, data: grid.cells().iter().map(occupancy).collect() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Point, Pose2};

    fn sample(resolution: f32, height: u32) -> nav_msgs::OccupancyGrid {
        let mut message = nav_msgs::OccupancyGrid { data: vec![0, 100, -1, 10, 50, 65], ..Default::default() };
        message.info = nav_msgs::MapMetaData { resolution, width: 3, height, ..Default::default() };
        message.info.origin = Pose2::new(1.0, 2.0, std::f64::consts::FRAC_PI_2).into();
        message
    }

    #[test]
    fn cells_of_a_map_with_a_rotated_origin_are_at_the_right_positions() {
        let grid = grid(&sample(0.05, 2)).unwrap();
        let [free, occupied, unknown] = [Cell::Free, Cell::Occupied, Cell::Unknown];
        assert_eq!(grid.cells(), [free, occupied, unknown, free, unknown, occupied]);
        assert!((grid.centre(1, 0) - Point::new(1.0 - 0.025, 2.0 + 0.075)).norm() < 1e-9);
        assert_eq!(grid.resolution().to_bits(), 0.05_f64.to_bits());
    }

    #[test]
    fn a_map_survives_the_conversion_to_a_message_and_back() {
        let map = grid(&sample(0.05, 2)).unwrap();
        let message = super::message(&map, "map");
        assert_eq!((message.header.frame_id.as_str(), &message.data[..]), ("map", &[0, 100, -1, 0, -1, 100][..]));
        assert_eq!(grid(&message).unwrap(), map);
    }

    #[test]
    fn errors_name_the_problem() {
        let problem = |message: &nav_msgs::OccupancyGrid| grid(message).unwrap_err().to_string();
        assert!(problem(&sample(0.0, 2)).contains("resolution is 0"));
        assert!(problem(&sample(f32::NAN, 2)).contains("resolution is NaN"));
        assert!(problem(&sample(0.05, 7)).contains("6 cells do not make 3 x 7"));
        assert!(problem(&nav_msgs::OccupancyGrid::default()).contains("unusable"));
        let mut rotated = sample(0.05, 2);
        rotated.info.origin.orientation.w = 9.0;
        assert!(problem(&rotated).contains("normalised"));
    }
}
