//! Indoor areas of a map, where a robot can be.

use super::distance::DistanceField;
use super::grid::{Cell, OccupancyGrid};

/// Minimum area of a room, m^2; smaller free areas are gaps within walls.
const MIN_ROOM_AREA: f64 = 1.0;

/// Half the width of the gaps in walls that are closed, m; among them are corridors at which mapping stopped.
const HALF_GAP: f64 = 1.0;

/// Indices of the free cells that walls separate from the outside of the map, except for gaps. Many maps are free all around the
/// building, where no robot is. Returns all free cells if no area is enclosed.
pub fn indoor_cells(grid: &OccupancyGrid) -> Vec<usize> {
    let mut visited = outdoors(grid);
    for (visited, &cell) in visited.iter_mut().zip(grid.cells()) {
        *visited |= cell == Cell::Occupied;
    }
    let min_cells = MIN_ROOM_AREA / (grid.resolution() * grid.resolution());
    let mut indoors = Vec::new();
    for index in 0..visited.len() {
        let room = flood(index, grid.width(), &mut visited);
        if room.len() as f64 >= min_cells {
            indoors.extend(room);
        }
    }
    indoors.retain(|&index| grid.cells()[index] == Cell::Free);
    if indoors.is_empty() {
        indoors = (0..visited.len()).filter(|&index| grid.cells()[index] == Cell::Free).collect();
    }
    indoors.sort_unstable();
    indoors
}

/// The cells that an object twice as wide as [`HALF_GAP`] can reach from the border of the map.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, clippy::cast_possible_wrap)] // numbers of cells
fn outdoors(grid: &OccupancyGrid) -> Vec<bool> {
    // A distance field is blocked all around, but the surroundings of the map are outdoors. The margin is wide enough to hide the
    // difference.
    let margin = (HALF_GAP / grid.resolution()).ceil() as usize + 2;
    let (walls, width) = grid.padded_walls(2 * margin);
    let padded = |index: usize| (index / grid.width() + 2 * margin) * width + index % grid.width() + 2 * margin;
    let within = |cells: Vec<bool>, gap: f64| -> Vec<bool> {
        let indices = 0..cells.len();
        let distances = DistanceField::new(width, cells);
        let near = |index: usize| distances.at((index % width) as i64, (index / width) as i64) * grid.resolution() <= gap;
        indices.map(near).collect()
    };
    let mut visited = within(walls, HALF_GAP);
    let mut reached = vec![false; visited.len()];
    for index in flood(margin * width + margin, width, &mut visited) {
        reached[index] = true;
    }
    let reached = within(reached, HALF_GAP + grid.resolution());
    (0..grid.cells().len()).map(|index| reached[padded(index)]).collect()
}

/// Flood fill: returns the cells not yet visited that are 4-connected to `start`, and marks them as visited.
pub fn flood(start: usize, width: usize, visited: &mut [bool]) -> Vec<usize> {
    let mut reached = Vec::new();
    if !std::mem::replace(&mut visited[start], true) {
        reached.push(start);
    }
    let mut next = 0;
    while let Some(&index) = reached.get(next) {
        next += 1;
        let left = (index % width > 0).then(|| index - 1);
        let right = (index % width + 1 < width).then_some(index + 1);
        for neighbour in [left, right, index.checked_sub(width), Some(index + width)].into_iter().flatten() {
            if neighbour < visited.len() && !std::mem::replace(&mut visited[neighbour], true) {
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

    /// A map of 20 m x 20 m with a room of 10 m x 10 m in its middle; `gap`: width of a gap in its wall, cells.
    fn room(wall: bool, gap: usize) -> OccupancyGrid {
        let is_wall = |x: usize, y: usize| {
            let around = (50..=150).contains(&x) && (50..=150).contains(&y) && (x % 100 == 50 || y % 100 == 50);
            wall && around && !(y == 50 && (80..80 + gap).contains(&x))
        };
        let cells = (0..40_000).map(|i| if is_wall(i % 200, i / 200) { Cell::Occupied } else { Cell::Free }).collect();
        OccupancyGrid::new(200, 0.1, Pose2::IDENTITY, cells).unwrap()
    }

    #[test]
    fn indoor_cells_are_those_enclosed_by_walls() {
        for gap in [0, 3, 15] {
            let indoors = indoor_cells(&room(true, gap));
            let inside = indoors.iter().filter(|&i| (51..150).contains(&(i % 200)) && (51..150).contains(&(i / 200))).count();
            // Cells in the gap and just in front of it may count either way.
            assert!(inside >= 99 * 99 - 20 * gap && indoors.len() <= 99 * 99 + 20 * gap, "{gap}: {inside} of {}", indoors.len());
        }
        assert_eq!(indoor_cells(&room(false, 0)).len(), 40_000);
        assert!(indoor_cells(&room(true, 40)).len() > 30_000, "a wide gap opens the room");
    }
}
