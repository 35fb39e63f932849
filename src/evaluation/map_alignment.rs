//! Alignment of a map with another one: the transform that matches their walls.

use std::f64::consts::TAU;

use nalgebra::{Matrix3, Vector3};

use crate::geometry::{Point, Pose2, perpendicular};
use crate::map::distance::DistanceField;
use crate::map::grid::OccupancyGrid;

/// Successive limits of the distance between a point and a wall in the refinement, m.
const LIMITS: [f64; 4] = [2.0, 0.7, 0.3, 0.15];
/// Maximum number of Gauss-Newton steps with each limit.
const MAX_STEPS: usize = 30;
/// Number of headings of the initial guesses, 3 degrees apart.
const HEADINGS: usize = 120;
/// Spacing of the positions of the initial guesses, m.
const POSITION_SPACING: f64 = 1.0;
/// Number of points that rate the initial guesses.
const SAMPLE_POINTS: usize = 150;
/// Maximum number of initial guesses that are refined.
const MAX_GUESSES: usize = 10;
/// Minimum distance between two refined initial guesses: metres plus radians.
const MIN_SEPARATION: f64 = 1.5;

/// The transform that aligns points with the walls of the truth: least squares of the distances to the walls, with successively smaller
/// limits. It starts at the identity and at the best guesses of a global search. The distances are interpolated between cell centres,
/// because nearest-point distances would lock onto the cells.
pub(super) fn alignment(points: &[Point], truth: &OccupancyGrid) -> Pose2 {
    let field = Field::of(truth);
    let sample: Vec<Point> = points.iter().step_by(points.len().div_ceil(SAMPLE_POINTS).max(1)).copied().collect();
    let guesses = std::iter::once(Pose2::IDENTITY).chain(field.initial_guesses(&sample));
    let refined =
        guesses.map(|start| field.refined(points, start)).map(|motion| (field.cost(points, &motion, f64::INFINITY), motion));
    refined.reduce(|best, other| if other.0 < best.0 { other } else { best }).map_or(Pose2::IDENTITY, |(_, motion)| motion)
}

/// Distance field of the walls of a map, with a margin around the map.
struct Field<'a> {
    map: &'a OccupancyGrid,
    /// Number of cells added on every side.
    margin: i64,
    distances: DistanceField,
}

impl<'a> Field<'a> {
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, clippy::cast_possible_wrap)] // a few hundred cells
    fn of(map: &'a OccupancyGrid) -> Self {
        // A distance field is blocked beyond its edge.
        let margin = (2.0 * LIMITS[0] / map.resolution()).ceil() as usize;
        let (walls, width) = map.padded_walls(margin);
        Self { map, margin: margin as i64, distances: DistanceField::new(width, walls) }
    }

    /// Distance of a point's cell from the walls, m; infinite beyond the margin.
    #[allow(clippy::cast_possible_truncation, clippy::cast_possible_wrap)] // saturates
    fn cell_distance(&self, point: &Point) -> f64 {
        let place = self.map.coordinates(*point);
        let cell = |along: f64, size: usize| {
            let cell = (along.floor() as i64).saturating_add(self.margin);
            (0..size as i64 + 2 * self.margin).contains(&cell).then_some(cell)
        };
        match (cell(place.x, self.map.width()), cell(place.y, self.map.height())) {
            (Some(column), Some(row)) => self.distances.at(column, row) * self.map.resolution(),
            _ => f64::INFINITY,
        }
    }

    /// Interpolated distance of a point from the walls, m, and its gradient along the map's axes.
    #[allow(clippy::cast_possible_truncation)] // saturates
    fn distance_and_gradient(&self, point: &Point) -> (f64, Point) {
        let place = self.map.coordinates(*point) - Point::new(0.5, 0.5);
        let (column, row) = (place.x.floor(), place.y.floor());
        let (x, y) = (place.x - column, place.y - row);
        let value = |dx: i64, dy: i64| {
            let [column, row] = [(column as i64).saturating_add(dx), (row as i64).saturating_add(dy)];
            self.distances.at(column.saturating_add(self.margin), row.saturating_add(self.margin))
        };
        let [a, b, c, d] = [value(0, 0), value(1, 0), value(0, 1), value(1, 1)];
        let (low, high) = (a + x * (b - a), c + x * (d - c));
        let gradient = Point::new((1.0 - y) * (b - a) + y * (d - c), high - low);
        let turned = self.map.origin().transform().rotate(gradient);
        ((low + y * (high - low)) * self.map.resolution(), turned)
    }

    /// Sum of the points' distances, m, each truncated at the widest limit. Stops once the sum exceeds `max`.
    fn cost(&self, points: &[Point], motion: &Pose2, max: f64) -> f64 {
        let transform = motion.transform();
        let mut sum = 0.0;
        for point in points {
            sum += self.cell_distance(&transform.apply(*point)).min(LIMITS[0]);
            if sum > max {
                break;
            }
        }
        sum
    }

    /// Global search in coarse steps: the transforms that bring the points nearest to the walls, best first.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // places on a map
    fn initial_guesses(&self, points: &[Point]) -> Vec<Pose2> {
        let centre = points.iter().sum::<Point>() / points.len().max(1) as f64;
        let size = Point::new(self.map.width() as f64, self.map.height() as f64) * self.map.resolution();
        let (columns, rows) = ((size.x / POSITION_SPACING) as usize, (size.y / POSITION_SPACING) as usize);
        let place = |i: usize| Point::new((i % columns) as f64 + 0.5, (i / columns) as f64 + 0.5) * POSITION_SPACING;
        let mut best: Vec<(f64, Pose2)> = Vec::new();
        for heading in (0..HEADINGS).map(|i| i as f64 * TAU / HEADINGS as f64) {
            let rotation = Pose2::new(0.0, 0.0, heading).transform();
            for place in (0..columns * rows).map(place) {
                let offset = self.map.origin().transform().apply(place) - rotation.rotate(centre);
                let motion = Pose2::new(offset.x, offset.y, heading);
                let max = if best.len() < MAX_GUESSES { f64::INFINITY } else { best[MAX_GUESSES - 1].0 };
                let cost = self.cost(points, &motion, max);
                if cost >= max {
                    continue;
                }
                let is_separate = |other: &Pose2| {
                    let shift = other.transform().apply(centre) - rotation.apply(centre) - offset;
                    shift.norm() + other.between(&motion).theta.abs() > MIN_SEPARATION
                };
                if best.iter().all(|(other_cost, other)| is_separate(other) || cost < *other_cost) {
                    best.retain(|(_, other)| is_separate(other));
                    best.insert(best.partition_point(|(other_cost, _)| *other_cost <= cost), (cost, motion));
                    best.truncate(MAX_GUESSES);
                }
            }
        }
        best.into_iter().map(|(_, motion)| motion).collect()
    }

    /// Refines a transform by Gauss-Newton steps.
    fn refined(&self, points: &[Point], mut motion: Pose2) -> Pose2 {
        for limit in LIMITS {
            for _ in 0..MAX_STEPS {
                let Some(step) = self.step(points, &motion, limit) else { break };
                motion = Pose2::new(motion.x + step.x, motion.y + step.y, motion.theta + step.z);
                if step.amax() < 1e-5 {
                    break;
                }
            }
        }
        motion
    }

    /// The Gauss-Newton step for the points nearer to a wall than `limit`; `None` if they leave it undetermined.
    fn step(&self, points: &[Point], motion: &Pose2, limit: f64) -> Option<Vector3<f64>> {
        let transform = motion.transform();
        let (mut matrix, mut gradient) = (Matrix3::zeros(), Vector3::zeros());
        for point in points {
            let rotated = transform.rotate(*point);
            let (distance, slope) = self.distance_and_gradient(&(rotated + motion.translation()));
            if distance < limit {
                let jacobian = Vector3::new(slope.x, slope.y, slope.dot(&perpendicular(rotated)));
                matrix += jacobian * jacobian.transpose();
                gradient -= jacobian * distance;
            }
        }
        Some(matrix.cholesky()?.solve(&gradient))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::map::grid::Cell;

    /// The centres of the wall cells of an L-shaped room, 20 m x 12 m and 8 m x 6 m.
    fn walls() -> Vec<Point> {
        let corners = [(1.0, 1.0), (21.0, 1.0), (21.0, 13.0), (13.0, 13.0), (13.0, 7.0), (1.0, 7.0), (1.0, 1.0)];
        let mut walls = Vec::new();
        for ends in corners.windows(2) {
            let [from, to] = [ends[0], ends[1]].map(|(x, y)| Point::new(x + 0.025, y + 0.025));
            let steps = ((to - from).norm() / 0.05).round();
            walls.extend((0..400).map(f64::from).take_while(|i| *i < steps).map(|i| from + (to - from) * (i / steps)));
        }
        walls
    }

    #[allow(clippy::cast_precision_loss)] // a few hundred cells
    fn grid(walls: &[Point]) -> OccupancyGrid {
        let centre = |i: usize| Point::new((i % 440) as f64 + 0.5, (i / 440) as f64 + 0.5) * 0.05;
        let is_wall = |i: usize| walls.iter().any(|wall| (wall - centre(i)).norm() < 0.01);
        let cell = |i: usize| if is_wall(i) { Cell::Occupied } else { Cell::Free };
        OccupancyGrid::new(440, 0.05, Pose2::IDENTITY, (0..440 * 280).map(cell).collect()).unwrap()
    }

    #[test]
    fn a_map_is_aligned_from_any_frame() {
        let (walls, truth) = (walls(), grid(&walls()));
        for frame in [Pose2::IDENTITY, Pose2::new(8.0, -20.0, 2.4), Pose2::new(-300.0, 40.0, -1.0)] {
            let back = frame.inverse().transform();
            let seen: Vec<Point> = walls.iter().map(|wall| back.apply(*wall)).collect();
            let found = frame.between(&alignment(&seen, &truth));
            assert!(found.distance() < 0.05 && found.theta.abs() < 0.003, "{frame:?}: {found:?}");
        }
    }

    #[test]
    fn no_points_give_the_identity() {
        assert_eq!(alignment(&[], &grid(&walls())), Pose2::IDENTITY);
    }
}
