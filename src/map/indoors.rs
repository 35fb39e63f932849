//! Where in a map a robot can be.

use super::distance::DistanceField;
use super::grid::{Cell, OccupancyGrid};

/// Free places smaller than this are gaps within walls, m^2.
const SMALLEST_ROOM: f64 = 1.0;

/// Gaps in walls are closed up to twice this, m: the ends of corridors where somebody stopped mapping, too.
const GAP: f64 = 1.0;

/// The free cells, by index, that walls part from the outside of the map, but for gaps. Many maps are free all round the building, and
/// no robot is there. All free cells, if nothing is walled in.
pub fn indoor_cells(grid: &OccupancyGrid) -> Vec<usize> {
    let mut seen = outdoors(grid);
    for (seen, &cell) in seen.iter_mut().zip(grid.cells()) {
        *seen |= cell == Cell::Occupied;
    }
    let least = SMALLEST_ROOM / (grid.resolution() * grid.resolution());
    let mut indoors = Vec::new();
    for index in 0..seen.len() {
        let room = flood(index, grid.width(), &mut seen);
        if room.len() as f64 >= least {
            indoors.extend(room);
        }
    }
    indoors.retain(|&index| grid.cells()[index] == Cell::Free);
    if indoors.is_empty() {
        indoors = (0..seen.len()).filter(|&index| grid.cells()[index] == Cell::Free).collect();
    }
    indoors.sort_unstable();
    indoors
}

/// Where something twice as wide as [`GAP`] gets to from the border of the map.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, clippy::cast_possible_wrap)] // numbers of cells
fn outdoors(grid: &OccupancyGrid) -> Vec<bool> {
    // Around a distance field all is blocked, around the map it is outdoors: so much of that is added that it makes no difference.
    let margin = (GAP / grid.resolution()).ceil() as usize + 2;
    let (width, height) = (grid.width() + 4 * margin, grid.height() + 4 * margin);
    let padded = |index: usize| (index / grid.width() + 2 * margin) * width + index % grid.width() + 2 * margin;
    let within = |cells: Vec<bool>, gap: f64| -> Vec<bool> {
        let distances = DistanceField::new(width, cells);
        let near = |index: usize| distances.at((index % width) as i64, (index / width) as i64) * grid.resolution() <= gap;
        (0..width * height).map(near).collect()
    };
    let mut walls = vec![false; width * height];
    for (index, _) in grid.cells().iter().enumerate().filter(|(_, cell)| **cell == Cell::Occupied) {
        walls[padded(index)] = true;
    }
    let mut seen = within(walls, GAP);
    let mut reached = vec![false; width * height];
    for index in flood(margin * width + margin, width, &mut seen) {
        reached[index] = true;
    }
    let reached = within(reached, GAP + grid.resolution());
    (0..grid.cells().len()).map(|index| reached[padded(index)]).collect()
}

/// The cells not seen yet that can be reached from one, sideways and up and down; all are seen then.
fn flood(start: usize, width: usize, seen: &mut [bool]) -> Vec<usize> {
    let mut reached = Vec::new();
    if !std::mem::replace(&mut seen[start], true) {
        reached.push(start);
    }
    let mut next = 0;
    while let Some(&index) = reached.get(next) {
        next += 1;
        let left = (index % width > 0).then(|| index - 1);
        let right = (index % width + 1 < width).then_some(index + 1);
        for neighbour in [left, right, index.checked_sub(width), Some(index + width)].into_iter().flatten() {
            if neighbour < seen.len() && !std::mem::replace(&mut seen[neighbour], true) {
                reached.push(neighbour);
            }
        }
    }
    reached
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Pose2;

    /// A map of 20 m x 20 m, a room of 10 m x 10 m in its middle, with a gap of so many cells in its wall.
    fn room(wall: bool, gap: usize) -> OccupancyGrid {
        let is_wall = |x: usize, y: usize| {
            let around = (50..=150).contains(&x) && (50..=150).contains(&y) && (x % 100 == 50 || y % 100 == 50);
            wall && around && !(y == 50 && (80..80 + gap).contains(&x))
        };
        let cells = (0..40_000).map(|i| if is_wall(i % 200, i / 200) { Cell::Occupied } else { Cell::Free }).collect();
        OccupancyGrid::new(200, 0.1, Pose2::IDENTITY, cells).unwrap()
    }

    #[test]
    fn a_robot_is_within_the_walls_if_there_are_any_around_it() {
        for gap in [0, 3, 15] {
            let indoors = indoor_cells(&room(true, gap));
            let inside = indoors.iter().filter(|&i| (51..150).contains(&(i % 200)) && (51..150).contains(&(i / 200))).count();
            // In the gap, and just before it, either is right.
            assert!(inside >= 99 * 99 - 20 * gap && indoors.len() <= 99 * 99 + 20 * gap, "{gap}: {inside} of {}", indoors.len());
        }
        assert_eq!(indoor_cells(&room(false, 0)).len(), 40_000);
        assert!(indoor_cells(&room(true, 40)).len() > 30_000, "open to all sides");
    }
}
