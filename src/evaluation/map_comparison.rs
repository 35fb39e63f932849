//! Comparison of a map with the true map: false walls, missed walls, false free space; and quality measures without a true map.
//!
//! Distances are from the centre of an occupied cell to that of the nearest one of the other map (J. Santos, D. Portugal, R. Rocha: An
//! evaluation of 2D SLAM techniques available in Robot Operating System, SSRR 2013); two identical maps with cells of 5 cm and
//! different origins are about 2 cm apart. The numbers of occupied cells, corners and enclosed areas reveal double walls without a true map
//! (A. Filatov et al.: 2D SLAM quality evaluation methods, FRUCT 2017).

use std::fmt;

use comfy_table::{CellAlignment, Table, presets};
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use serde::Serialize;
use serde_json::{Value, json};

use super::map_alignment::alignment;
use crate::geometry::{Point, Pose2, RigidTransform};
use crate::map::grid::{Cell, OccupancyGrid};
use crate::map::indoors::flood;
use crate::quantile;

/// Distances above this count as errors, m.
pub const MAX_WALL_ERROR: f64 = 0.1;
/// A true wall counts as visible if the map has a free cell within this distance, m.
const VISIBLE_DISTANCE: f64 = 0.15;

/// Distances from the occupied cells of one map to those of another.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Distances {
    /// Number of cells.
    pub count: usize,
    /// Mean, m.
    pub mean_m: f64,
    /// 95th percentile, m.
    pub p95_m: f64,
    /// Fraction above [`MAX_WALL_ERROR`].
    pub over_10_cm: f64,
}

impl Distances {
    fn of(mut distances: Vec<f64>) -> Option<Self> {
        distances.sort_by(f64::total_cmp);
        let count = distances.len();
        Some(Self {
            count,
            mean_m: distances.iter().sum::<f64>() / count as f64,
            p95_m: quantile::of_sorted(&distances, 0.95)?,
            over_10_cm: distances.iter().filter(|&&distance| distance > MAX_WALL_ERROR).count() as f64 / count as f64,
        })
    }
}

/// Quality measures of a map that need no true map.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Shape {
    /// Fraction of the known cells that are occupied.
    pub occupied: f64,
    /// Number of corners of the walls (Harris and Stephens 1988).
    pub corners: usize,
    /// Number of areas enclosed by occupied cells.
    pub enclosed_areas: usize,
}

/// Results of a map comparison.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MapComparison {
    /// Transforms the map to the frame of the truth.
    pub truth_from_map: Pose2,
    /// Distances from the map's occupied cells to the nearest true wall; `None` if one of the maps has no walls.
    pub to_truth: Option<Distances>,
    /// Distances from the visible true walls to the nearest occupied cell of the map; `None` if there are none.
    pub to_map: Option<Distances>,
    /// Fraction of the map's free cells that contain no true wall.
    pub truly_free: f64,
    /// Shape of the map.
    pub shape: Shape,
    /// Shape of the true map.
    pub true_shape: Shape,
}

impl MapComparison {
    /// Compares a map with the true map. Both must have the same frame, unless `align` is set.
    ///
    /// `hit` marks the cells of the truth that rays have hit: only these walls can be missed. Without it, the walls near free cells of
    /// the map count as visible.
    pub fn new(map: &OccupancyGrid, truth: &OccupancyGrid, align: bool, hit: Option<&[bool]>) -> Self {
        let (walls, true_walls) = (map.centres(Cell::Occupied), truth.centres(Cell::Occupied));
        let truth_from_map = if align { alignment(&walls, truth) } else { Pose2::IDENTITY };
        let transform = truth_from_map.transform();
        let moved = |points: Vec<Point>| points.into_iter().map(|point| transform.apply(point)).collect::<Vec<_>>();
        let (walls, free) = (moved(walls), moved(map.centres(Cell::Free)));
        let is_wall = |point: &Point| cell_at(truth, point) == Some(Cell::Occupied);
        let visible = hit.map_or_else(|| visible_walls(truth, map, &transform), |hit| walls_hit(truth, hit));
        Self {
            truth_from_map,
            to_truth: Distances::of(distances(&walls, &true_walls)),
            to_map: Distances::of(distances(&visible, &walls)),
            truly_free: 1.0 - free.iter().filter(|point| is_wall(point)).count() as f64 / free.len().max(1) as f64,
            shape: Shape::of(map),
            true_shape: Shape::of(truth),
        }
    }

    /// The results as one JSON object.
    pub fn to_json(&self) -> Value {
        let Pose2 { x, y, theta } = self.truth_from_map;
        json!({
            "truth_from_map": [x, y, theta],
            "occupied_to_truth": self.to_truth,
            "truth_to_occupied": self.to_map,
            "free_truly_free": self.truly_free,
            "map": self.shape,
            "truth": self.true_shape,
        })
    }
}

/// The results as tables.
impl fmt::Display for MapComparison {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let table = |header: [&str; 5]| {
            let mut table = Table::new();
            table.load_style(presets::UTF8_FULL_CONDENSED);
            table.set_header(header);
            table
        };
        let mut walls = table(["distance from", "cells", "mean", "95 %", "over 10 cm"]);
        for (name, distances) in [("occupied cells to true walls", self.to_truth), ("true walls to occupied cells", self.to_map)]
        {
            if let Some(Distances { count, mean_m, p95_m, over_10_cm }) = distances {
                let figures = [
                    format!("{:.2} cm", 100.0 * mean_m),
                    format!("{:.2} cm", 100.0 * p95_m),
                    format!("{:.3} %", 100.0 * over_10_cm),
                ];
                let [mean, p95, over] = figures;
                walls.add_row([name.into(), count.to_string(), mean, p95, over]);
            }
        }
        let mut shapes = table(["of", "free cells correct", "occupied", "corners", "enclosed areas"]);
        let free = format!("{:.3} %", 100.0 * self.truly_free);
        for (name, free, shape) in [("the map", free.as_str(), self.shape), ("the truth", "", self.true_shape)] {
            let occupied = format!("{:.2} %", 100.0 * shape.occupied);
            shapes.add_row([name, free, &occupied, &shape.corners.to_string(), &shape.enclosed_areas.to_string()]);
        }
        for table in [&mut walls, &mut shapes] {
            table.column_iter_mut().skip(1).for_each(|column| column.set_cell_alignment(CellAlignment::Right));
            writeln!(f, "{table}")?;
        }
        let Pose2 { x, y, theta } = self.truth_from_map;
        write!(f, "aligned by x {x:.3} m, y {y:.3} m, {:.3} degrees", theta.to_degrees())
    }
}

#[allow(clippy::cast_possible_truncation)] // saturates
fn cell_at(map: &OccupancyGrid, point: &Point) -> Option<Cell> {
    let place = map.coordinates(*point);
    map.cell(place.x.floor() as i64, place.y.floor() as i64)
}

/// Centres of the true walls that rays have hit.
fn walls_hit(truth: &OccupancyGrid, hit: &[bool]) -> Vec<Point> {
    let walls = truth.cells().iter().zip(hit).enumerate().filter(|(_, (cell, hit))| **cell == Cell::Occupied && **hit);
    walls.map(|(i, _)| truth.centre(i % truth.width(), i / truth.width())).collect()
}

/// Centres of the true walls near free cells of the map.
#[allow(clippy::cast_possible_truncation)] // a few cells
fn visible_walls(truth: &OccupancyGrid, map: &OccupancyGrid, truth_from_map: &RigidTransform) -> Vec<Point> {
    let inverse = |p: &Point| {
        let offset = p - truth_from_map.apply(Point::zeros());
        let axis = truth_from_map.rotate(Point::x());
        Point::new(axis.dot(&offset), axis.perp(&offset))
    };
    let reach = (VISIBLE_DISTANCE / map.resolution()).ceil() as i64;
    let around: Vec<Point> = (-reach..=reach)
        .flat_map(|x| (-reach..=reach).map(move |y| Point::new(x as f64, y as f64) * map.resolution()))
        .filter(|offset| offset.norm() <= VISIBLE_DISTANCE)
        .collect();
    // The inside of walls is never visible.
    let is_surface = |wall: &Point| {
        let beside = [Point::x(), -Point::x(), Point::y(), -Point::y()].map(|step| wall + step * truth.resolution());
        beside.iter().any(|place| cell_at(truth, place) != Some(Cell::Occupied))
    };
    let mut walls = truth.centres(Cell::Occupied);
    walls.retain(is_surface);
    walls.retain(|wall| {
        let place = inverse(wall);
        around.iter().any(|offset| cell_at(map, &(place + offset)) == Some(Cell::Free))
    });
    walls
}

fn tree(points: &[Point]) -> Option<ImmutableKdTree<f64, 2>> {
    let points: Vec<[f64; 2]> = points.iter().map(|p| [p.x, p.y]).collect();
    ImmutableKdTree::new_from_slice(&points).ok().filter(|_| !points.is_empty())
}

/// Distance from each point to the nearest of the others, m; empty if there are no others.
fn distances(points: &[Point], others: &[Point]) -> Vec<f64> {
    let Some(tree) = tree(others) else { return Vec::new() };
    let nearest = |p: &Point| tree.query(&[p.x, p.y]).nearest_one::<SquaredEuclidean<f64>>().execute();
    points.iter().map(|point| nearest(point).distance.sqrt()).collect()
}

impl Shape {
    /// Computes the measures of a map.
    pub fn of(map: &OccupancyGrid) -> Self {
        let count = |kind: Cell| map.cells().iter().filter(|cell| **cell == kind).count();
        let (occupied, free) = (count(Cell::Occupied), count(Cell::Free));
        let walls = Walls::of(map);
        Self {
            occupied: occupied as f64 / (occupied + free).max(1) as f64,
            corners: walls.corners(),
            enclosed_areas: walls.enclosed_areas(),
        }
    }
}

/// The occupied cells, with an empty margin.
struct Walls {
    width: usize,
    cells: Vec<bool>,
}

impl Walls {
    /// Width of the margin, cells.
    const MARGIN: usize = 3;
    /// Minimum response of Harris and Stephens' corner detector: half of that of a right angle of two thin walls.
    const MIN_CORNER_RESPONSE: f64 = 2.0;

    fn of(map: &OccupancyGrid) -> Self {
        let (cells, width) = map.padded_walls(Self::MARGIN);
        Self { width, cells }
    }

    /// Number of corners: local maxima of the Harris response.
    fn corners(&self) -> usize {
        let w = self.width;
        let inside = |margin: usize| {
            let rows = margin..(self.cells.len() / w).saturating_sub(margin);
            rows.flat_map(move |row| (margin..w - margin).map(move |column| row * w + column))
        };
        let value = |i: usize| f64::from(u8::from(self.cells[i]));
        let mut gradients = vec![[0.0; 2]; self.cells.len()];
        inside(1).for_each(|i| gradients[i] = [0.5 * (value(i + 1) - value(i - 1)), 0.5 * (value(i + w) - value(i - w))]);
        let mut response = vec![0.0; self.cells.len()];
        for i in inside(3) {
            let mut sums = [0.0; 3];
            for j in (0..5).flat_map(|row| (0..5).map(move |column| i + row * w + column - 2 * w - 2)) {
                let [x, y] = gradients[j];
                sums = [sums[0] + x * x, sums[1] + x * y, sums[2] + y * y];
            }
            let [xx, xy, yy] = sums;
            response[i] = xx * yy - xy * xy - 0.05 * (xx + yy).powi(2);
        }
        let around = [1, w - 1, w, w + 1];
        let is_maximum = |i: usize| around.iter().all(|&by| response[i] > response[i - by] && response[i] >= response[i + by]);
        inside(3).filter(|&i| response[i] > Self::MIN_CORNER_RESPONSE && is_maximum(i)).count()
    }

    /// Number of areas that are not 4-connected to the outside.
    fn enclosed_areas(&self) -> usize {
        let mut visited = self.cells.clone();
        let areas = (0..visited.len()).filter(|&start| !flood(start, self.width, &mut visited).is_empty()).count();
        areas - 1 // without the outside, to which the margin belongs
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A room of 8 m x 6 m with walls one cell thick and its lower left corner at (1, 1). `shift`: displacement of one wall, m;
    /// `is_seen`: mapped from inside, with unknown cells outside.
    fn room(origin: Pose2, shift: f64, is_seen: bool) -> OccupancyGrid {
        let cell = |i: usize| {
            let (x, y) = (0.05 * (i % 200) as f64 + 0.025, 0.05 * (i / 200) as f64 + 0.025);
            let right = 9.0 + shift;
            let within = (1.0..right).contains(&x) && (1.0..7.0).contains(&y);
            let deep = (1.05..right - 0.05).contains(&x) && (1.05..6.95).contains(&y);
            match (within, deep) {
                (true, false) => Cell::Occupied,
                (false, _) if is_seen => Cell::Unknown,
                _ => Cell::Free,
            }
        };
        OccupancyGrid::new(200, 0.05, origin, (0..200 * 160).map(cell).collect()).unwrap()
    }

    #[test]
    fn identical_maps_have_no_errors() {
        let truth = room(Pose2::IDENTITY, 0.0, false);
        let found = MapComparison::new(&room(Pose2::IDENTITY, 0.0, true), &truth, false, None);
        let (to_truth, to_map) = (found.to_truth.unwrap(), found.to_map.unwrap());
        assert_eq!(
            (to_truth.mean_m, to_truth.over_10_cm, to_map.mean_m, to_map.over_10_cm, found.truly_free),
            (0.0, 0.0, 0.0, 0.0, 1.0)
        );
        assert_eq!((to_truth.count, to_map.count), (556, 556));
        assert_eq!((found.shape.corners, found.shape.enclosed_areas), (4, 1));
        assert_eq!(found.shape.corners, found.true_shape.corners);
    }

    #[test]
    fn a_displaced_wall_counts_in_both_directions() {
        let truth = room(Pose2::IDENTITY, 0.0, false);
        let found = MapComparison::new(&room(Pose2::IDENTITY, 0.3, true), &truth, false, None);
        let (to_truth, to_map) = (found.to_truth.unwrap(), found.to_map.unwrap());
        assert!(to_truth.over_10_cm > 0.15 && to_map.over_10_cm > 0.15 && found.truly_free < 0.999, "{found}");
        assert!(to_truth.mean_m > 0.03 && to_truth.p95_m > 0.2, "{found}");
    }

    #[test]
    fn walls_that_no_ray_hit_are_not_missed() {
        let (truth, map) = (room(Pose2::IDENTITY, 0.0, false), room(Pose2::IDENTITY, 0.3, true));
        let over = |hit: &dyn Fn(usize) -> bool| {
            let hit: Vec<bool> = (0..truth.cells().len()).map(hit).collect();
            let found = MapComparison::new(&map, &truth, false, Some(&hit)).to_map.unwrap();
            (found.count, found.over_10_cm)
        };
        // First all walls except the right one, which is displaced by 0.3 m in the map; then all.
        assert_eq!(over(&|i| i % 200 < 178), (434, 0.0));
        assert_eq!(over(&|_| true).0, 556);
        assert!(over(&|_| true).1 > 0.15);
    }

    #[test]
    fn a_map_with_another_frame_is_aligned() {
        let (truth, map_frame) = (room(Pose2::IDENTITY, 0.0, false), Pose2::new(0.6, -0.4, 0.08));
        let found = MapComparison::new(&room(map_frame, 0.0, true), &truth, true, None);
        let back = found.truth_from_map * map_frame;
        assert!(back.distance() < 0.02 && back.theta.abs() < 0.003, "{back:?}");
        assert!(found.to_truth.unwrap().mean_m < 0.01 && found.to_json()["free_truly_free"].as_f64().unwrap() > 0.99);
    }

    #[test]
    fn maps_without_walls_have_no_distances() {
        let empty = OccupancyGrid::new(10, 0.05, Pose2::IDENTITY, vec![Cell::Unknown; 100]).unwrap();
        let found = MapComparison::new(&empty, &empty, true, None);
        assert_eq!((found.to_truth, found.to_map, found.shape.enclosed_areas), (None, None, 0));
    }
}
