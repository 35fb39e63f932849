//! Plans routes in a map: paths between two points, and the cheapest loop around the largest island, as on a race track.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use thiserror::Error;

use crate::geometry::Point;

use super::grid_world::GridWorld;
use super::route::smooth_path;
use super::world::World;

/// Minimum distance of the route from every wall, m.
pub const MARGIN: f64 = 0.4;
/// Scale of the clearance cost, m: a detour is cheaper than driving closer to a wall than this for long.
const COMFORTABLE_CLEARANCE: f64 = 0.6;
/// Distance between the nodes of the search, m; less than [`MARGIN`], so that the path between nodes is clear, too.
const NODE_SPACING: f64 = 0.2;
/// Radius of the artificial island in maps without one, m.
const TURNING_RADIUS: f64 = 1.0;

/// Why a map has no loop to drive.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum NoLoop {
    /// No cell is far enough from the walls.
    #[error(
        "no cell is at least {MARGIN} m away from walls and unknown cells: check the resolution and the thresholds of the map"
    )]
    NoRoom,
    /// The free space has no island and is too narrow for a loop.
    #[error(
        "there is no loop to drive: the free space next to the map's origin has no obstacle to drive around and no room for a turn"
    )]
    NoIsland,
}

/// Why there is no path between two points.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum NoPath {
    /// A car does not fit at one of the points.
    #[error("({x:.2}, {y:.2}) is less than {MARGIN} m away from a wall or unknown cells, or outside the map")]
    NoRoom {
        /// x of the point, m.
        x: f64,
        /// y of the point, m.
        y: f64,
    },
    /// The points are not connected.
    #[error("no path leads there that keeps {MARGIN} m away from walls")]
    Separate,
}

/// Plans a smooth path from one point to another that keeps clear of walls where there is room. It begins and ends exactly at
/// these points.
pub fn find_path(world: &GridWorld, from: Point, to: Point) -> Result<Vec<Point>, NoPath> {
    let lattice = Lattice::new(world);
    let node_at = |point: Point| {
        let no_room = NoPath::NoRoom { x: point.x, y: point.y };
        lattice.nearest_to(point).filter(|&node| (lattice.positions[node] - point).norm() <= 2.0 * NODE_SPACING).ok_or(no_room)
    };
    let nodes = lattice.cheapest_path(node_at(from)?, node_at(to)?).ok_or(NoPath::Separate)?;
    let corners: Vec<Point> =
        std::iter::once(from).chain(nodes.into_iter().map(|node| lattice.positions[node])).chain([to]).collect();
    Ok(smooth_path(&corners, world, MARGIN))
}

/// Plans the corners of a loop around the largest island in the free space next to the map's origin.
pub fn find_loop(world: &GridWorld) -> Result<Vec<Point>, NoLoop> {
    let mut lattice = Lattice::new(world);
    // By convention cars start at the origin of a map.
    let start = lattice.nearest_to(Point::zeros()).ok_or(NoLoop::NoRoom)?;
    lattice.close_unreachable_nodes(start);
    let hub = lattice.largest_island().or_else(|| lattice.make_island()).ok_or(NoLoop::NoIsland)?;
    let gate = lattice.clearest_node_on_cut(hub).ok_or(NoLoop::NoIsland)?;
    let first = lattice.cheapest_loop(hub, gate).ok_or(NoLoop::NoIsland)?;
    // That loop was forced through the gate. A second one through the opposite point can take the best route on the gate's side,
    // too.
    let opposite = first[first.len() / 2];
    let nodes = lattice.cheapest_loop(hub, opposite).ok_or(NoLoop::NoIsland)?;
    Ok(nodes.into_iter().map(|node| lattice.positions[node]).collect())
}

/// The nodes of the search, row by row, with their clearances.
struct Lattice {
    columns: usize,
    positions: Vec<Point>,
    /// Clearance, m; 0 if the car does not fit.
    clearance: Vec<f64>,
}

/// One move of the search.
struct Move {
    to: usize,
    cost: u64,
    /// Whether it crosses the cut.
    crosses: bool,
}

impl Lattice {
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a small positive number, or saturated
    fn new(world: &GridWorld) -> Self {
        let grid = world.grid();
        let stride = ((NODE_SPACING / grid.resolution()).round() as usize).max(1);
        let columns = grid.width().div_ceil(stride);
        let positions: Vec<Point> = (0..grid.height())
            .step_by(stride)
            .flat_map(|row| (0..grid.width()).step_by(stride).map(move |column| grid.centre(column, row)))
            .collect();
        let clearance = positions.iter().map(|&p| Some(world.clearance(p)).filter(|c| *c >= MARGIN).unwrap_or(0.0)).collect();
        Self { columns, positions, clearance }
    }

    fn is_open(&self, node: usize) -> bool {
        self.clearance[node] > 0.0
    }

    /// The open node nearest to a point.
    fn nearest_to(&self, point: Point) -> Option<usize> {
        let open = (0..self.positions.len()).filter(|&node| self.is_open(node));
        let distance = |node: usize| (self.positions[node] - point).norm();
        open.min_by(|&a, &b| distance(a).total_cmp(&distance(b)))
    }

    /// The up to eight neighbours of a node.
    fn neighbours(&self, node: usize) -> impl Iterator<Item = usize> + '_ {
        let (column, row) = (node % self.columns, node / self.columns);
        let rows = self.positions.len() / self.columns;
        let columns = column.saturating_sub(1)..=(column + 1).min(self.columns - 1);
        (row.saturating_sub(1)..=(row + 1).min(rows - 1))
            .flat_map(move |r| columns.clone().map(move |c| r * self.columns + c))
            .filter(move |&other| other != node)
    }

    /// Whether two neighbours share a row or a column.
    fn are_in_line(&self, a: usize, b: usize) -> bool {
        a % self.columns == b % self.columns || a / self.columns == b / self.columns
    }

    /// The nodes that can be reached from `start` through nodes that satisfy `pass`, by moves along rows and columns and, if
    /// `diagonal`, also by diagonal moves.
    fn region(&self, start: usize, diagonal: bool, pass: impl Fn(usize) -> bool, seen: &mut [bool]) -> Vec<usize> {
        let mut region = vec![start];
        seen[start] = true;
        let mut next = 0;
        while next < region.len() {
            let node = region[next];
            for other in self.neighbours(node) {
                if !seen[other] && pass(other) && (diagonal || self.are_in_line(node, other)) {
                    seen[other] = true;
                    region.push(other);
                }
            }
            next += 1;
        }
        region
    }

    /// Closes all nodes that cannot be reached from `start`.
    fn close_unreachable_nodes(&mut self, start: usize) {
        let mut reached = vec![false; self.positions.len()];
        self.region(start, true, |node| self.is_open(node), &mut reached);
        for (clearance, reached) in self.clearance.iter_mut().zip(reached) {
            *clearance = if reached { *clearance } else { 0.0 };
        }
    }

    fn is_at_border(&self, node: usize) -> bool {
        let (column, row) = (node % self.columns, node / self.columns);
        column == 0 || row == 0 || column + 1 == self.columns || (row + 1) * self.columns == self.positions.len()
    }

    /// A node inside the largest blocked area that is surrounded by open nodes.
    fn largest_island(&self) -> Option<usize> {
        let mut seen = vec![false; self.positions.len()];
        let mut largest = Vec::new();
        for node in 0..self.positions.len() {
            if seen[node] || self.is_open(node) {
                continue;
            }
            let mut island = self.region(node, false, |node| !self.is_open(node), &mut seen);
            if island.len() > largest.len() && !island.iter().any(|&node| self.is_at_border(node)) {
                island.sort_unstable();
                largest = island;
            }
        }
        largest.get(largest.len() / 2).copied()
    }

    /// Creates an island: closes a disc around the node with the largest clearance, if there is room to drive around it.
    fn make_island(&mut self) -> Option<usize> {
        let hub = (0..self.positions.len()).max_by(|&a, &b| self.clearance[a].total_cmp(&self.clearance[b]))?;
        if self.clearance[hub] < TURNING_RADIUS + 2.0 * MARGIN {
            return None;
        }
        let centre = self.positions[hub];
        for (clearance, position) in self.clearance.iter_mut().zip(&self.positions) {
            *clearance = if (position - centre).norm() < TURNING_RADIUS { 0.0 } else { *clearance };
        }
        Some(hub)
    }

    /// Whether a move crosses the cut, which runs from the hub along its row to the right, just above the nodes. A closed path
    /// that crosses it an odd number of times goes around the hub.
    fn crosses_cut(&self, hub: usize, a: usize, b: usize) -> bool {
        let lower = a.min(b);
        a / self.columns != b / self.columns && lower / self.columns == hub / self.columns && lower > hub
    }

    /// The node with the largest clearance in the first open section right of the island: every loop close to the island passes
    /// this section.
    fn clearest_node_on_cut(&self, hub: usize) -> Option<usize> {
        let row_end = (hub / self.columns + 1) * self.columns;
        let first = (hub..row_end).find(|&node| self.is_open(node))?;
        (first..row_end).take_while(|&node| self.is_open(node)).max_by(|&a, &b| self.clearance[a].total_cmp(&self.clearance[b]))
    }

    fn moves(&self, hub: usize, from: usize) -> impl Iterator<Item = Move> + '_ {
        self.neighbours(from).filter(|&to| self.is_open(to)).map(move |to| {
            let length = (self.positions[to] - self.positions[from]).norm();
            let tightness = COMFORTABLE_CLEARANCE / self.clearance[to];
            #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // micrometres of a positive, finite length
            let cost = (1e6 * length * (1.0 + tightness * tightness)).round() as u64;
            Move { to, cost, crosses: self.crosses_cut(hub, from, to) }
        })
    }

    /// The cheapest path from one node to another, regardless of the cut.
    fn cheapest_path(&self, from: usize, to: usize) -> Option<Vec<usize>> {
        // A cut beyond the last node is never crossed.
        let mut path = self.search(self.positions.len(), 2 * from, 2 * to)?;
        path.reverse();
        Some(path)
    }

    /// The cheapest loop through `gate` that crosses the cut an odd number of times.
    fn cheapest_loop(&self, hub: usize, gate: usize) -> Option<Vec<usize>> {
        self.search(hub, 2 * gate, 2 * gate + 1)
    }

    /// Dijkstra's algorithm over states of node and parity of the cut crossings. Returns the nodes of the cheapest path between
    /// two states in reverse order, without the first one.
    fn search(&self, hub: usize, start: usize, goal: usize) -> Option<Vec<usize>> {
        let mut costs = vec![u64::MAX; 2 * self.positions.len()];
        let mut came_from = vec![start; costs.len()];
        let mut queue = BinaryHeap::from([Reverse((0, start))]);
        costs[start] = 0;
        while let Some(Reverse((cost, state))) = queue.pop() {
            if state == goal {
                let back = std::iter::successors(Some(goal), |&state| Some(came_from[state])).take_while(|&state| state != start);
                return Some(back.map(|state| state / 2).collect());
            }
            if cost > costs[state] {
                continue;
            }
            for step in self.moves(hub, state / 2) {
                let parity = (state + usize::from(step.crosses)) % 2;
                let (next, total) = (2 * step.to + parity, cost + step.cost);
                if total < costs[next] {
                    costs[next] = total;
                    came_from[next] = state;
                    queue.push(Reverse((total, next)));
                }
            }
        }
        None
    }
}
