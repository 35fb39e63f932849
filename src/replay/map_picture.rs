//! Renders a map with the path coloured by time, the ends of the path, and the loop closures.

use std::io::{self, Write};

use crate::geometry::Point;
use crate::io::gray_image::write_png;
use crate::map::grid::{Cell, OccupancyGrid};

/// Number of colours of the path, from its start to its end.
const PATH_COLOURS: usize = 64;
/// Half the side of the squares at the ends of the path, pixels.
const MARK_RADIUS: i64 = 4;

/// Palette index of occupied cells.
const OCCUPIED: u8 = 0;
/// Palette index of free cells.
const FREE: u8 = 1;
/// Palette index of unknown cells.
const UNKNOWN: u8 = 2;
/// Palette index of loop closures.
const LOOP: u8 = 3;
/// Palette index of the start of the path.
const START: u8 = 4;
/// Palette index of the end of the path.
const END: u8 = 5;
/// Palette index of the first colour of the path.
const FIRST_PATH_COLOUR: u8 = 6;

/// A map, with a path to render on it.
pub struct Picture<'a> {
    /// The map.
    pub map: &'a OccupancyGrid,
    /// Positions along the path, m.
    pub path: &'a [Point],
    /// Loop closures: pairs of positions, m.
    pub loops: &'a [(Point, Point)],
}

impl Picture<'_> {
    /// Writes a PNG file with one pixel for each cell.
    pub fn write_png(&self, writer: impl Write) -> io::Result<()> {
        let mut canvas = Canvas::of(self.map);
        for (from, to) in self.loops {
            canvas.line(from, to, LOOP);
        }
        for (i, pair) in self.path.windows(2).enumerate() {
            canvas.line(&pair[0], &pair[1], path_colour(i, self.path.len()));
        }
        for (position, colour) in [(self.path.first(), START), (self.path.last(), END)] {
            if let Some(position) = position {
                canvas.mark(position, colour);
            }
        }
        write_png(writer, self.map.width(), &canvas.rows(), Some(palette()))
    }
}

/// Palette index of position `i` of a path of `count` positions.
#[allow(clippy::cast_possible_truncation)] // fewer than 256
fn path_colour(i: usize, count: usize) -> u8 {
    FIRST_PATH_COLOUR + (i * PATH_COLOURS / count.max(1)).min(PATH_COLOURS - 1) as u8
}

/// Red, green and blue of all colours. Those of the path go from blue over green to red.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // within 0 to 255
fn palette() -> Vec<u8> {
    let mut colours = vec![[0, 0, 0], [254, 254, 254], [205, 205, 205], [190, 120, 220], [0, 140, 0], [200, 0, 0]];
    colours.extend((0..PATH_COLOURS).map(|i| {
        let fraction = i as f64 / (PATH_COLOURS - 1) as f64;
        let channel = |centre: f64| (255.0 * (1.5 - (4.0 * (fraction - centre)).abs()).clamp(0.0, 1.0)) as u8;
        [channel(0.75), channel(0.5), channel(0.25)]
    }));
    colours.concat()
}

struct Canvas<'a> {
    map: &'a OccupancyGrid,
    /// Palette indices, in the order of the map's cells: row by row from the bottom.
    pixels: Vec<u8>,
}

impl<'a> Canvas<'a> {
    fn of(map: &'a OccupancyGrid) -> Self {
        let colour = |cell: &Cell| match cell {
            Cell::Occupied => OCCUPIED,
            Cell::Free => FREE,
            Cell::Unknown => UNKNOWN,
        };
        Self { map, pixels: map.cells().iter().map(colour).collect() }
    }

    fn set(&mut self, column: i64, row: i64, colour: u8) {
        if let (Ok(column), Ok(row)) = (usize::try_from(column), usize::try_from(row))
            && column < self.map.width()
            && row < self.map.height()
        {
            self.pixels[row * self.map.width() + column] = colour;
        }
    }

    #[allow(clippy::cast_possible_truncation)] // saturates
    fn line(&mut self, from: &Point, to: &Point, colour: u8) {
        let (from, to) = (self.map.coordinates(*from), self.map.coordinates(*to));
        let span = to - from;
        // Limits the work for a line that leads far out of the map.
        let steps = span.amax().min((self.map.width() + self.map.height()) as f64).ceil().max(1.0);
        for i in 0..=steps as i64 {
            let cell = from + span * (i as f64 / steps);
            self.set(cell.x.floor() as i64, cell.y.floor() as i64, colour);
        }
    }

    #[allow(clippy::cast_possible_truncation)] // saturates
    fn mark(&mut self, position: &Point, colour: u8) {
        let centre = self.map.coordinates(*position);
        for (x, y) in (-MARK_RADIUS..=MARK_RADIUS).flat_map(|x| (-MARK_RADIUS..=MARK_RADIUS).map(move |y| (x, y))) {
            self.set((centre.x.floor() as i64).saturating_add(x), (centre.y.floor() as i64).saturating_add(y), colour);
        }
    }

    /// The pixels row by row from the top.
    fn rows(&self) -> Vec<u8> {
        self.pixels.chunks_exact(self.map.width()).rev().flatten().copied().collect()
    }
}
