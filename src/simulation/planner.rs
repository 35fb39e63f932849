//! Finds a route in a map: the shortest well clear loop round its largest island, which is what a race track is.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use thiserror::Error;

use crate::geometry::Point;

use super::grid_world::GridWorld;
use super::route::smooth_way;
use super::world::World;

/// Distance that the route keeps from every wall, m.
pub const MARGIN: f64 = 0.4;
/// Going nearer to a wall than this costs noticeably more than going round, m.
const COMFORT: f64 = 0.6;
/// Distance between the nodes of the search, m; less than [`MARGIN`], so that the way from node to node is clear too.
const NODE_SPACING: f64 = 0.2;
/// Radius that a car goes round where there is nothing to go round, m.
const TURNING_RADIUS: f64 = 1.0;

/// There is no way to drive on and on in a map.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum NoLoop {
    /// No cell is far enough from the walls.
    #[error("no place is {MARGIN} m clear of walls and unknown cells: check the resolution and the thresholds of the map")]
    NoRoom,
    /// The free space has no loop and is too narrow to turn in.
    #[error(
        "there is no loop to drive: the free space next to the map's origin has no island to go round and no place to turn in"
    )]
    NothingToGoRound,
}

/// There is no way from one place to another.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum NoWay {
    /// One of the places has no room for a car.
    #[error("({x:.2}, {y:.2}) is within {MARGIN} m of a wall, of what is unknown, or outside the map")]
    NoRoom {
        /// Where, m.
        x: f64,
        /// Where, m.
        y: f64,
    },
    /// No way leads from the one to the other.
    #[error("no way that is {MARGIN} m clear of walls leads there")]
    Separate,
}

/// The way from one place to another, well clear of walls where there is room, and smooth. It begins and ends there.
pub fn find_way(world: &GridWorld, from: Point, to: Point) -> Result<Vec<Point>, NoWay> {
    let lattice = Lattice::new(world);
    let node_at = |place: Point| {
        let no_room = NoWay::NoRoom { x: place.x, y: place.y };
        lattice.nearest_to(place).filter(|&node| (lattice.positions[node] - place).norm() <= 2.0 * NODE_SPACING).ok_or(no_room)
    };
    let nodes = lattice.shortest_way(node_at(from)?, node_at(to)?).ok_or(NoWay::Separate)?;
    let corners: Vec<Point> =
        std::iter::once(from).chain(nodes.into_iter().map(|node| lattice.positions[node])).chain([to]).collect();
    Ok(smooth_way(&corners, world, MARGIN))
}

/// Corners of a closed way through the free space nearest to the map's origin, round the largest island in it.
pub fn find_loop(world: &GridWorld) -> Result<Vec<Point>, NoLoop> {
    let mut lattice = Lattice::new(world);
    // Cars start at the origin of a map by custom.
    let start = lattice.nearest_to(Point::zeros()).ok_or(NoLoop::NoRoom)?;
    lattice.keep_only_what_connects_to(start);
    let hub = lattice.largest_island().or_else(|| lattice.make_island()).ok_or(NoLoop::NothingToGoRound)?;
    let gate = lattice.clearest_on_the_cut(hub).ok_or(NoLoop::NothingToGoRound)?;
    let first = lattice.shortest_loop(hub, gate).ok_or(NoLoop::NothingToGoRound)?;
    // That loop had to pass the gate, wherever it lies; one through the point opposite is free to take the best way there too.
    let opposite = first[first.len() / 2];
    let nodes = lattice.shortest_loop(hub, opposite).ok_or(NoLoop::NothingToGoRound)?;
    Ok(nodes.into_iter().map(|node| lattice.positions[node]).collect())
}

/// The nodes of the search, row by row, and how clear each one is.
struct Lattice {
    columns: usize,
    positions: Vec<Point>,
    /// 0 where the car cannot go.
    clearance: Vec<f64>,
}

/// One move of the search.
struct Move {
    to: usize,
    cost: u64,
    /// Whether it passes from one side of the cut to the other.
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

    /// The open node nearest to a place.
    fn nearest_to(&self, place: Point) -> Option<usize> {
        let open = (0..self.positions.len()).filter(|&node| self.is_open(node));
        let distance = |node: usize| (self.positions[node] - place).norm();
        open.min_by(|&a, &b| distance(a).total_cmp(&distance(b)))
    }

    /// The nodes next to one, up to eight.
    fn neighbours(&self, node: usize) -> impl Iterator<Item = usize> + '_ {
        let (column, row) = (node % self.columns, node / self.columns);
        let rows = self.positions.len() / self.columns;
        let columns = column.saturating_sub(1)..=(column + 1).min(self.columns - 1);
        (row.saturating_sub(1)..=(row + 1).min(rows - 1))
            .flat_map(move |r| columns.clone().map(move |c| r * self.columns + c))
            .filter(move |&other| other != node)
    }

    /// Whether two neighbours share a row or a column.
    fn are_straight(&self, a: usize, b: usize) -> bool {
        a % self.columns == b % self.columns || a / self.columns == b / self.columns
    }

    /// The nodes that can be reached from `start` through nodes that `pass`, by moves along the rows and columns, and if `diagonal`
    /// also across.
    fn region(&self, start: usize, diagonal: bool, pass: impl Fn(usize) -> bool, seen: &mut [bool]) -> Vec<usize> {
        let mut region = vec![start];
        seen[start] = true;
        let mut next = 0;
        while next < region.len() {
            let node = region[next];
            for other in self.neighbours(node) {
                if !seen[other] && pass(other) && (diagonal || self.are_straight(node, other)) {
                    seen[other] = true;
                    region.push(other);
                }
            }
            next += 1;
        }
        region
    }

    fn keep_only_what_connects_to(&mut self, start: usize) {
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

    /// A node inside the largest closed area with open nodes all round.
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

    /// Closes a disc in the clearest place, if there is room to go round it.
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

    /// The cut runs from the hub along its row to the right, just above the nodes. A closed way that crosses it an odd number of
    /// times goes round the hub.
    fn crosses_the_cut(&self, hub: usize, a: usize, b: usize) -> bool {
        let lower = a.min(b);
        a / self.columns != b / self.columns && lower / self.columns == hub / self.columns && lower > hub
    }

    /// The clearest node of the first open stretch right of the island: every way round the island that keeps to it passes there.
    fn clearest_on_the_cut(&self, hub: usize) -> Option<usize> {
        let row_end = (hub / self.columns + 1) * self.columns;
        let first = (hub..row_end).find(|&node| self.is_open(node))?;
        (first..row_end).take_while(|&node| self.is_open(node)).max_by(|&a, &b| self.clearance[a].total_cmp(&self.clearance[b]))
    }

    fn moves(&self, hub: usize, from: usize) -> impl Iterator<Item = Move> + '_ {
        self.neighbours(from).filter(|&to| self.is_open(to)).map(move |to| {
            let length = (self.positions[to] - self.positions[from]).norm();
            let tightness = COMFORT / self.clearance[to];
            #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // micrometres of a positive, finite length
            let cost = (1e6 * length * (1.0 + tightness * tightness)).round() as u64;
            Move { to, cost, crosses: self.crosses_the_cut(hub, from, to) }
        })
    }

    /// The cheapest way from one node to another: [`Self::cheapest`] between nodes that do not mind the cut.
    fn shortest_way(&self, from: usize, to: usize) -> Option<Vec<usize>> {
        // A cut beyond the last node is never crossed.
        let mut way = self.cheapest(self.positions.len(), 2 * from, 2 * to)?;
        way.reverse();
        Some(way)
    }

    /// The cheapest way from `gate` back to it that crosses the cut an odd number of times.
    fn shortest_loop(&self, hub: usize, gate: usize) -> Option<Vec<usize>> {
        self.cheapest(hub, 2 * gate, 2 * gate + 1)
    }

    /// The nodes of the cheapest way between two states, from its end to its beginning, which is left out: Dijkstra's search over pairs
    /// of node and parity of the crossings of the cut.
    fn cheapest(&self, hub: usize, start: usize, goal: usize) -> Option<Vec<usize>> {
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
