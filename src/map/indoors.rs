//! Where in a map a robot can be.

use super::grid::{Cell, OccupancyGrid};

/// Free places smaller than this are gaps within walls, m^2.
const SMALLEST_ROOM: f64 = 1.0;

/// The free cells, by index, that walls part from the outside of the map. Many maps are free all round the building, and no robot
/// is there. All free cells, if nothing is walled in.
pub fn indoor_cells(grid: &OccupancyGrid) -> Vec<usize> {
    let mut seen: Vec<bool> = grid.cells().iter().map(|&cell| cell == Cell::Occupied).collect();
    let (width, height) = (grid.width(), grid.height());
    let border = (0..width).flat_map(|x| [x, (height - 1) * width + x]);
    let border = border.chain((0..height).flat_map(|y| [y * width, (y + 1) * width - 1]));
    border.for_each(|index| drop(flood(index, width, &mut seen)));
    let least = SMALLEST_ROOM / (grid.resolution() * grid.resolution());
    let mut indoors = Vec::new();
    for index in 0..seen.len() {
        let room = flood(index, width, &mut seen);
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

    #[test]
    fn a_robot_is_within_the_walls_if_there_are_any_around_it() {
        let walled = |x: usize, y: usize| (10..=30).contains(&x) && (10..=30).contains(&y) && (x % 20 == 10 || y % 20 == 10);
        let cells =
            |wall: bool| (0..1600).map(|i| if wall && walled(i % 40, i / 40) { Cell::Occupied } else { Cell::Free }).collect();
        let grid = |wall| OccupancyGrid::new(40, 0.1, Pose2::IDENTITY, cells(wall)).unwrap();
        let indoors = indoor_cells(&grid(true));
        assert_eq!(indoors.len(), 19 * 19);
        assert!(indoors.iter().all(|i| (11..30).contains(&(i % 40)) && (11..30).contains(&(i / 40))));
        assert_eq!(indoor_cells(&grid(false)).len(), 1600);
    }
}
