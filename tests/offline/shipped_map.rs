//! The map that ships with the package shows the built-in corridor, and the demo is localized on it.

use std::fs;
use std::path::Path;

use anytime_scan_matcher::geometry::{Point, Pose2};
use anytime_scan_matcher::io::gray_image::GrayImage;
use anytime_scan_matcher::io::map_file;
use anytime_scan_matcher::map::grid::{Cell, OccupancyGrid};
use anytime_scan_matcher::simulation::built_in::BuiltIn;
use anytime_scan_matcher::simulation::shapes::Shapes;
use anytime_scan_matcher::simulation::world::World as _;

use crate::common::program::json;

const FOLDER: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/maps");
const RESOLUTION: f64 = 0.05;
const WIDTH: usize = 680;
const HEIGHT: usize = 340;
const ORIGIN: Point = Point::new(-15.025, -8.525);

fn centre(cell: usize) -> Point {
    ORIGIN + Point::new((cell % WIDTH) as f64 + 0.5, (cell / WIDTH) as f64 + 0.5) * RESOLUTION
}

/// The ideal map of the walls: a cell is occupied if a wall passes through it, free if it can be reached from `start` without crossing a
/// wall, and otherwise unknown.
fn draw(walls: &Shapes, start: Point) -> OccupancyGrid {
    let is_wall = |cell: usize| walls.clearance(centre(cell)) < 0.501 * RESOLUTION;
    let mut cells: Vec<Cell> =
        (0..WIDTH * HEIGHT).map(|cell| if is_wall(cell) { Cell::Occupied } else { Cell::Unknown }).collect();
    let offset = (start - ORIGIN) / RESOLUTION;
    let mut reached = vec![offset.y as usize * WIDTH + offset.x as usize];
    while let Some(cell) = reached.pop() {
        if cells[cell] == Cell::Unknown {
            cells[cell] = Cell::Free;
            reached.extend([cell - 1, cell + 1, cell - WIDTH, cell + WIDTH]);
        }
    }
    OccupancyGrid::new(WIDTH, RESOLUTION, Pose2::new(ORIGIN.x, ORIGIN.y, 0.0), cells).unwrap()
}

fn image(map: &OccupancyGrid) -> GrayImage {
    let shade = |&cell: &Cell| match cell {
        Cell::Free => 254,
        Cell::Occupied => 0,
        Cell::Unknown => 205,
    };
    GrayImage::new(WIDTH, map.cells().chunks_exact(WIDTH).rev().flatten().map(shade).collect()).unwrap()
}

#[test]
fn the_shipped_map_is_of_the_built_in_corridor_and_small() {
    let (walls, route) = BuiltIn::Corridor.build();
    let map = draw(&walls, route[0]);
    let file = Path::new(FOLDER).join("corridor.png");
    if std::env::var_os("UPDATE_GOLDEN").is_some() {
        image(&map).write_png(fs::File::create(&file).unwrap()).unwrap();
    }
    assert!(map_file::read(&Path::new(FOLDER).join("corridor.yaml")).unwrap() == map, "UPDATE_GOLDEN=1 redraws it");
    assert!(fs::metadata(file).unwrap().len() < 50_000);
}

#[test]
fn the_demo_is_localized_on_the_shipped_map() {
    let summary = json(&["localize", "bags/demo.bag", "--map", "maps/corridor.yaml", "--truth", "bags/demo.tum", "--json"]);
    assert!(summary["localized"] == 400 && summary["position_rmse_m"].as_f64().unwrap() < 0.06, "{summary}");
}
