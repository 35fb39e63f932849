//! A map as a picture: what stands where, the path coloured by time, its ends, and where it has met itself.

use std::io::{self, BufWriter, Write};

use crate::geometry::Point;
use crate::map::grid::{Cell, OccupancyGrid};

/// Colours of the path, from its start to its end.
const SHADES: usize = 64;
/// Side of the squares at the ends of the path, pixels to either side.
const MARK: i64 = 4;
/// Numbers of the colours.
const OCCUPIED: u8 = 0;
const FREE: u8 = 1;
const UNKNOWN: u8 = 2;
const LOOP: u8 = 3;
const START: u8 = 4;
const END: u8 = 5;
const FIRST_SHADE: u8 = 6;

/// What is drawn.
pub struct Picture<'a> {
    /// The map.
    pub map: &'a OccupancyGrid,
    /// Places along the path, m.
    pub path: &'a [Point],
    /// Pairs of places that were recognised as near each other, m.
    pub loops: &'a [(Point, Point)],
}

impl Picture<'_> {
    /// Writes a PNG file, a pixel for each cell.
    pub fn write_png(&self, writer: impl Write) -> io::Result<()> {
        let mut canvas = Canvas::of(self.map);
        for (from, to) in self.loops {
            canvas.line(from, to, LOOP);
        }
        for (i, pair) in self.path.windows(2).enumerate() {
            canvas.line(&pair[0], &pair[1], shade(i, self.path.len()));
        }
        for (place, colour) in [(self.path.first(), START), (self.path.last(), END)] {
            if let Some(place) = place {
                canvas.mark(place, colour);
            }
        }
        canvas.write_png(writer)
    }
}

/// Number of the colour of a place along a path of `count`.
#[allow(clippy::cast_possible_truncation)] // fewer than 256
fn shade(i: usize, count: usize) -> u8 {
    FIRST_SHADE + (i * SHADES / count.max(1)).min(SHADES - 1) as u8
}

/// Red, green and blue of all colours: the path's go from blue over green to red.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // within 0 to 255
fn palette() -> Vec<u8> {
    let mut colours = vec![[0, 0, 0], [254, 254, 254], [205, 205, 205], [190, 120, 220], [0, 140, 0], [200, 0, 0]];
    colours.extend((0..SHADES).map(|i| {
        let part = i as f64 / (SHADES - 1) as f64;
        let rise = |from: f64| (255.0 * (1.5 - (4.0 * (part - from)).abs()).clamp(0.0, 1.0)) as u8;
        [rise(0.75), rise(0.5), rise(0.25)]
    }));
    colours.concat()
}

struct Canvas<'a> {
    map: &'a OccupancyGrid,
    /// From the bottom up, as the map's cells.
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
        // What is longer than the map is wide leads nowhere.
        let steps = span.amax().min((self.map.width() + self.map.height()) as f64).ceil().max(1.0);
        for i in 0..=steps as i64 {
            let place = from + span * (i as f64 / steps);
            self.set(place.x.floor() as i64, place.y.floor() as i64, colour);
        }
    }

    #[allow(clippy::cast_possible_truncation)] // saturates
    fn mark(&mut self, place: &Point, colour: u8) {
        let centre = self.map.coordinates(*place);
        for (x, y) in (-MARK..=MARK).flat_map(|x| (-MARK..=MARK).map(move |y| (x, y))) {
            self.set((centre.x.floor() as i64).saturating_add(x), (centre.y.floor() as i64).saturating_add(y), colour);
        }
    }

    fn write_png(&self, writer: impl Write) -> io::Result<()> {
        let size = |pixels: usize| u32::try_from(pixels).map_err(io::Error::other);
        let mut encoder = png::Encoder::new(BufWriter::new(writer), size(self.map.width())?, size(self.map.height())?);
        encoder.set_color(png::ColorType::Indexed);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_palette(palette());
        let mut writer = encoder.write_header()?;
        let rows: Vec<u8> = self.pixels.chunks_exact(self.map.width()).rev().flatten().copied().collect();
        writer.write_image_data(&rows)?;
        Ok(writer.finish()?)
    }
}
