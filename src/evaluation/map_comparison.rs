//! Maps against the true map: walls that are not there, walls that are missed, space that is not free; and what can be told of a map by
//! itself.
//!
//! Distances are from the centre of an occupied cell to that of the nearest one of the other map (J. Santos, D. Portugal, R. Rocha: An
//! evaluation of 2D SLAM techniques available in Robot Operating System, SSRR 2013); two maps of 5 cm cells that are the same but for
//! where their cells begin are about 2 cm apart. Occupied cells, corners and enclosed areas tell of double walls without any truth (A.
//! Filatov et al.: 2D SLAM quality evaluation methods, FRUCT 2017).

use std::fmt;

use comfy_table::{CellAlignment, Table, presets};
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use serde::Serialize;
use serde_json::{Value, json};

use super::map_alignment::alignment;
use crate::geometry::{Point, Pose2, RigidTransform};
use crate::map::grid::{Cell, OccupancyGrid};
use crate::quantile;

/// A distance above this counts as an error, m.
pub const FAR: f64 = 0.1;
/// Walls count as seen where free space was seen this near, m.
const BESIDE: f64 = 0.15;

/// Distances from one map's occupied cells to another's.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Distances {
    /// How many.
    pub count: usize,
    /// Mean, m.
    pub mean_m: f64,
    /// That so many of a hundred do not exceed, m.
    pub p95_m: f64,
    /// Part that is above [`FAR`].
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
            over_10_cm: distances.iter().filter(|&&distance| distance > FAR).count() as f64 / count as f64,
        })
    }
}

/// What a map shows without a true one.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Shape {
    /// Part of the known cells that is occupied.
    pub occupied: f64,
    /// Corners of what is occupied (Harris and Stephens 1988).
    pub corners: usize,
    /// Areas that occupied cells enclose.
    pub enclosed_areas: usize,
}

/// What a comparison has found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MapComparison {
    /// Takes the map to the truth.
    pub truth_from_map: Pose2,
    /// From what the map says to the nearest true wall; `None` where it says that there is nothing.
    pub to_truth: Option<Distances>,
    /// From the true walls that could be seen to the nearest one of the map.
    pub to_map: Option<Distances>,
    /// Part of the map's free cells where truly no wall is.
    pub truly_free: f64,
    /// Of the map.
    pub shape: Shape,
    /// Of the truth.
    pub true_shape: Shape,
}

impl MapComparison {
    /// Compares a map with the true one, which has its frame; or, with `align`, one that has any other.
    ///
    /// The map can miss the walls that rays `met`, by the numbers of their cells in the truth; where that is not known, those that it says it
    /// is free beside.
    pub fn new(map: &OccupancyGrid, truth: &OccupancyGrid, align: bool, met: Option<&[bool]>) -> Self {
        let (walls, true_walls) = (centres(map, Cell::Occupied), centres(truth, Cell::Occupied));
        let truth_from_map = if align { alignment(&walls, truth) } else { Pose2::IDENTITY };
        let transform = truth_from_map.transform();
        let moved = |points: Vec<Point>| points.into_iter().map(|point| transform.apply(point)).collect::<Vec<_>>();
        let (walls, free) = (moved(walls), moved(centres(map, Cell::Free)));
        let is_wall = |point: &Point| at(truth, point) == Some(Cell::Occupied);
        let seen = met.map_or_else(|| seen_walls(truth, map, &transform), |met| walls_met(truth, met));
        Self {
            truth_from_map,
            to_truth: Distances::of(distances(&walls, &true_walls)),
            to_map: Distances::of(distances(&seen, &walls)),
            truly_free: 1.0 - free.iter().filter(|point| is_wall(point)).count() as f64 / free.len().max(1) as f64,
            shape: Shape::of(map),
            true_shape: Shape::of(truth),
        }
    }

    /// One object.
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

/// The tables for people.
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
        let mut shapes = table(["of", "truly free", "occupied", "corners", "enclosed areas"]);
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

/// Centres of all cells of a kind, m.
fn centres(map: &OccupancyGrid, kind: Cell) -> Vec<Point> {
    let cells = map.cells().iter().enumerate().filter(|(_, cell)| **cell == kind);
    cells.map(|(i, _)| map.centre(i % map.width(), i / map.width())).collect()
}

#[allow(clippy::cast_possible_truncation)] // saturates
fn at(map: &OccupancyGrid, point: &Point) -> Option<Cell> {
    let place = map.coordinates(*point);
    map.cell(place.x.floor() as i64, place.y.floor() as i64)
}

/// True walls that rays met.
fn walls_met(truth: &OccupancyGrid, met: &[bool]) -> Vec<Point> {
    let walls = truth.cells().iter().zip(met).enumerate().filter(|(_, (cell, met))| **cell == Cell::Occupied && **met);
    walls.map(|(i, _)| truth.centre(i % truth.width(), i / truth.width())).collect()
}

/// True walls beside which the map says it is free.
#[allow(clippy::cast_possible_truncation)] // a few cells
fn seen_walls(truth: &OccupancyGrid, map: &OccupancyGrid, truth_from_map: &RigidTransform) -> Vec<Point> {
    let inverse = |p: &Point| {
        let offset = p - truth_from_map.apply(Point::zeros());
        let axis = truth_from_map.rotate(Point::x());
        Point::new(axis.dot(&offset), axis.perp(&offset))
    };
    let reach = (BESIDE / map.resolution()).ceil() as i64;
    let around: Vec<Point> = (-reach..=reach)
        .flat_map(|x| (-reach..=reach).map(move |y| Point::new(x as f64, y as f64) * map.resolution()))
        .filter(|offset| offset.norm() <= BESIDE)
        .collect();
    // The inside of walls is never seen.
    let is_side = |wall: &Point| {
        let beside = [Point::x(), -Point::x(), Point::y(), -Point::y()].map(|step| wall + step * truth.resolution());
        beside.iter().any(|place| at(truth, place) != Some(Cell::Occupied))
    };
    let mut walls = centres(truth, Cell::Occupied);
    walls.retain(is_side);
    walls.retain(|wall| {
        let place = inverse(wall);
        around.iter().any(|offset| at(map, &(place + offset)) == Some(Cell::Free))
    });
    walls
}

fn tree(points: &[Point]) -> Option<ImmutableKdTree<f64, 2>> {
    let points: Vec<[f64; 2]> = points.iter().map(|p| [p.x, p.y]).collect();
    ImmutableKdTree::new_from_slice(&points).ok().filter(|_| !points.is_empty())
}

/// From each point to the nearest of the others, m; none where there are no others.
fn distances(points: &[Point], others: &[Point]) -> Vec<f64> {
    let Some(tree) = tree(others) else { return Vec::new() };
    let nearest = |p: &Point| tree.query(&[p.x, p.y]).nearest_one::<SquaredEuclidean<f64>>().execute();
    points.iter().map(|point| nearest(point).distance.sqrt()).collect()
}

impl Shape {
    /// Of a map.
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

/// What is occupied, with three cells of nothing all around.
struct Walls {
    width: usize,
    cells: Vec<bool>,
}

impl Walls {
    const MARGIN: usize = 3;
    /// Harris and Stephens' measure must be above this for a corner: half of what a right angle of two thin walls has.
    const CORNER: f64 = 2.0;

    fn of(map: &OccupancyGrid) -> Self {
        let width = map.width() + 2 * Self::MARGIN;
        let mut cells = vec![false; width * (map.height() + 2 * Self::MARGIN)];
        for (i, _) in map.cells().iter().enumerate().filter(|(_, cell)| **cell == Cell::Occupied) {
            cells[(i / map.width() + Self::MARGIN) * width + i % map.width() + Self::MARGIN] = true;
        }
        Self { width, cells }
    }

    /// Places where walls turn: greatest of Harris' measure within a cell around.
    fn corners(&self) -> usize {
        let w = self.width;
        let inside = |margin: usize| {
            let rows = margin..(self.cells.len() / w).saturating_sub(margin);
            rows.flat_map(move |row| (margin..w - margin).map(move |column| row * w + column))
        };
        let value = |i: usize| f64::from(u8::from(self.cells[i]));
        let mut slopes = vec![[0.0; 2]; self.cells.len()];
        inside(1).for_each(|i| slopes[i] = [0.5 * (value(i + 1) - value(i - 1)), 0.5 * (value(i + w) - value(i - w))]);
        let mut measure = vec![0.0; self.cells.len()];
        for i in inside(3) {
            let mut sums = [0.0; 3];
            for j in (0..5).flat_map(|row| (0..5).map(move |column| i + row * w + column - 2 * w - 2)) {
                let [x, y] = slopes[j];
                sums = [sums[0] + x * x, sums[1] + x * y, sums[2] + y * y];
            }
            let [xx, xy, yy] = sums;
            measure[i] = xx * yy - xy * xy - 0.05 * (xx + yy).powi(2);
        }
        let around = [1, w - 1, w, w + 1];
        let is_greatest = |i: usize| around.iter().all(|&by| measure[i] > measure[i - by] && measure[i] >= measure[i + by]);
        inside(3).filter(|&i| measure[i] > Self::CORNER && is_greatest(i)).count()
    }

    /// What cannot be reached from outside, sideways and up and down, without crossing what is occupied.
    fn enclosed_areas(&self) -> usize {
        let mut seen = self.cells.clone();
        let mut areas = 0;
        for start in 0..seen.len() {
            if std::mem::replace(&mut seen[start], true) {
                continue;
            }
            areas += 1;
            let mut next = vec![start];
            while let Some(i) = next.pop() {
                for neighbour in [i.checked_sub(1), Some(i + 1), i.checked_sub(self.width), Some(i + self.width)] {
                    if let Some(j) = neighbour.filter(|&j| j < seen.len())
                        && !std::mem::replace(&mut seen[j], true)
                    {
                        next.push(j);
                    }
                }
            }
        }
        areas - usize::from(!self.cells.is_empty())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A room of 8 m x 6 m with walls of a cell, its lower left corner at (1, 1); `shift`: of one wall, m. Seen from inside, if so.
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
    fn a_map_is_like_itself() {
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
    fn a_wall_that_is_off_is_told_both_ways() {
        let truth = room(Pose2::IDENTITY, 0.0, false);
        let found = MapComparison::new(&room(Pose2::IDENTITY, 0.3, true), &truth, false, None);
        let (to_truth, to_map) = (found.to_truth.unwrap(), found.to_map.unwrap());
        assert!(to_truth.over_10_cm > 0.15 && to_map.over_10_cm > 0.15 && found.truly_free < 0.999, "{found}");
        assert!(to_truth.mean_m > 0.03 && to_truth.p95_m > 0.2, "{found}");
    }

    #[test]
    fn walls_that_no_ray_met_are_not_missed() {
        let (truth, map) = (room(Pose2::IDENTITY, 0.0, false), room(Pose2::IDENTITY, 0.3, true));
        let over = |met: &dyn Fn(usize) -> bool| {
            let met: Vec<bool> = (0..truth.cells().len()).map(met).collect();
            let found = MapComparison::new(&map, &truth, false, Some(&met)).to_map.unwrap();
            (found.count, found.over_10_cm)
        };
        // All but the right wall, which the map has 0.3 m farther off; then all.
        assert_eq!(over(&|i| i % 200 < 178), (434, 0.0));
        assert_eq!(over(&|_| true).0, 556);
        assert!(over(&|_| true).1 > 0.15);
    }

    #[test]
    fn a_map_from_elsewhere_is_laid_on_the_truth() {
        let (truth, away) = (room(Pose2::IDENTITY, 0.0, false), Pose2::new(0.6, -0.4, 0.08));
        let found = MapComparison::new(&room(away, 0.0, true), &truth, true, None);
        let back = found.truth_from_map * away;
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
