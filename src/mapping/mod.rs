//! Mapping by graph SLAM: keyframes along the path, a pose graph of the motions between them, and an occupancy grid.
//!
//! [`Mapper::add`] receives each scan with its odometry pose. [`Mapper::improve`] runs one round of loop closure search and graph
//! optimization; [`Mapper::finish`] repeats it until no more loop closures are found. [`Mapper::trajectory`] and [`Mapper::grid`]
//! return the current result.
//!
//! | file | what |
//! |---|---|
//! | `keyframe` | a scan with its odometry pose; when a keyframe is added |
//! | `edges` | matches of keyframe pairs, with honest covariances |
//! | `pose_graph`, `sparse` | the pose graph and its robust optimization |
//! | `loops` | loop closure candidates, search windows and consistency checks |
//! | `joining` | localizes a run with an unknown start on the map |
//! | `trajectory` | poses of all scans, interpolated between keyframes |
//! | `grid` | the occupancy grid |
//! | `live` | online mapping while the robot drives |
//! | `self_hits` | rays that hit the robot itself |
//! | `graph_file` | saves and loads the graph, to extend a map |

mod edges;
#[cfg(feature = "cli")]
mod graph_file;
mod grid;
mod joining;
mod keyframe;
mod live;
mod loops;
mod pose_graph;
mod self_hits;
mod sparse;
mod trajectory;

use std::ops::Range;

use crate::evaluation::trajectory::StampedPose;
use crate::geometry::{Pose2, PoseCovariance};
use crate::matching::classic::rejection::RejectionKnobs;
use crate::matching::{MatchingKnobs, Prior, View};
use crate::odometry::uncertainty;
use crate::scan::Scan;
use crate::time::Stamp;
use edges::{EdgeMatcher, Match};
#[cfg(feature = "cli")]
pub use graph_file::GraphFileError;
pub use grid::{Evidence, EvidenceGrid};
use keyframe::Spacing;
pub use keyframe::{Keyframe, MotionStatus, PosedScan};
pub use live::LiveMap;
use loops::{LoopSearch, RelativeUncertainty, WINDOWS};
pub use pose_graph::{Edge, EdgeKind, PoseGraph};
pub use self_hits::SelfHits;
use trajectory::{TrajectoryInterpolator, TrajectoryNode};

crate::knobs! {
    /// Parameters of the map.
    pub struct MappingKnobs {
        /// Side length of a cell.
        resolution: f64 = 0.05, in 0.005 to 1, unit "m";
        /// Folder to save maps in. Relative paths start at the node's working directory, which is `~/.ros` under `roslaunch`.
        directory: String = ".".into();
        /// Name of the saved map: NAME.yaml, NAME.pgm and NAME.graph. A name, not a path.
        name: String = "map".into();
        /// Whether to save the map when the node shuts down.
        save_on_exit: bool = false;
    }
}

/// Number of preceding keyframes that each new keyframe is matched against.
const SEQUENTIAL_MATCHES: usize = 3;
/// Minimum fraction of rays that must agree in such a match.
const MIN_AGREEMENT: f64 = 0.6;
/// Maximum deviation of such a match from odometry, standard deviations: 99 % for three coordinates (chi-squared 11.3).
const MAX_DEVIATION: f64 = 3.4;
/// Maximum number of rounds of loop closure search. Each round either finds loop closures or moves on to a larger window.
const MAX_ROUNDS: usize = 60;
/// Convergence tolerance of the optimization while the search for loop closures goes on, m and rad.
const COARSE_TOLERANCE: f64 = 1e-3;
/// Convergence tolerance of the final optimization, m and rad.
const FINAL_TOLERANCE: f64 = 1e-5;
/// Lever arm that converts heading errors to position errors, m.
const LEVER_ARM: f64 = 5.0;

/// A scan for the grid: the end points of its rays, in the laser's frame.
#[derive(Clone, Debug)]
struct GridScan {
    node: TrajectoryNode,
    /// Empty if newer scans have replaced it.
    points: Vec<[f32; 2]>,
    /// Pose at which the scan is currently inserted in the live grid, if it is.
    inserted_at: Option<Pose2>,
}

/// Statistics of the loop closures.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Progress {
    /// Number of loop edges.
    pub loops: usize,
    /// Number of loop edges that contradict the others; the robust kernel gives them almost no weight.
    pub outvoted: usize,
    /// Root mean square position error of the loop edges by odometry alone, m.
    pub residual_before: f64,
    /// The same after optimization, without the outvoted edges, m.
    pub residual_after: f64,
}

/// Builds a map from scans with odometry poses.
pub struct Mapper {
    matcher: EdgeMatcher,
    keyframes: Vec<Keyframe>,
    /// Poses of the keyframes' lasers on the map, in the order of `keyframes`, and the edges between them.
    graph: PoseGraph,
    /// Poses of the keyframes by odometry alone, from the start of each run.
    dead_reckoned: Vec<Pose2>,
    /// Path length from each keyframe to the next, counted like [`TrajectoryNode::distance`], m.
    distances_to_next: Vec<f64>,
    nodes: Vec<TrajectoryNode>,
    grid_scans: Vec<GridScan>,
    /// Covariance of the last keyframe's odometry pose, along the axes of the odometry frame.
    last_covariance: PoseCovariance,
    is_lost: bool,
    last_grid_pose: Option<Pose2>,
    /// Spacing of the scans inserted into the grid.
    grid_spacing: Spacing,
    loops: LoopSearch,
    /// Index into [`WINDOWS`] of the search window that is next.
    window_index: usize,
}

impl Mapper {
    /// An empty map.
    pub fn new(matching: &MatchingKnobs, rejection: &RejectionKnobs) -> Self {
        Self {
            matcher: EdgeMatcher::new(matching, rejection),
            keyframes: Vec::new(),
            graph: PoseGraph::default(),
            dead_reckoned: Vec::new(),
            distances_to_next: Vec::new(),
            nodes: Vec::new(),
            grid_scans: Vec::new(),
            last_covariance: PoseCovariance::zeros(),
            is_lost: false,
            last_grid_pose: None,
            grid_spacing: Spacing::GRID_SCANS,
            loops: LoopSearch::default(),
            window_index: 0,
        }
    }

    /// Adds a scan; returns whether it has become a keyframe.
    pub fn add(&mut self, posed_scan: PosedScan) -> bool {
        let odom_from_laser = posed_scan.odom_from_laser();
        self.is_lost |= posed_scan.motion_status == MotionStatus::Lost;
        let is_start = posed_scan.motion_status == MotionStatus::Start || self.keyframes.is_empty();
        // Scans of two lasers may alternate, so compare with the last two keyframes.
        let mut last = self.keyframes.iter().rev().take(2).map(|last| last.odom_from_laser.between(&odom_from_laser));
        let becomes_keyframe = is_start || self.is_lost || last.all(|motion| Spacing::KEYFRAMES.is_exceeded_by(&motion));
        self.add_node(posed_scan.scan.stamp(), posed_scan.odom_from_base, odom_from_laser, is_start, becomes_keyframe);
        let moved = self.last_grid_pose.map(|last| last.between(&odom_from_laser));
        if is_start || becomes_keyframe || moved.is_none_or(|moved| self.grid_spacing.is_exceeded_by(&moved)) {
            self.last_grid_pose = Some(odom_from_laser);
            let points = end_points(&posed_scan.scan);
            self.grid_scans.extend(self.nodes.last().map(|&node| GridScan { node, points, inserted_at: None }));
        }
        if becomes_keyframe {
            self.add_keyframe(posed_scan, is_start);
        }
        becomes_keyframe
    }

    /// Adds the pose of a scan that could not be used, for the trajectory.
    pub fn add_pose_only(&mut self, stamp: Stamp, odom_from_base: Pose2, base_from_laser: &Pose2) {
        self.add_node(stamp, odom_from_base, odom_from_base * *base_from_laser, false, false);
    }

    fn add_node(&mut self, stamp: Stamp, odom_from_base: Pose2, odom_from_laser: Pose2, is_start: bool, is_keyframe: bool) {
        if !is_start && let (Some(last), Some(distance)) = (self.nodes.last(), self.distances_to_next.last_mut()) {
            *distance += last.odom_from_laser.between(&odom_from_laser).magnitude();
        }
        let keyframe = if is_keyframe { self.keyframes.len() } else { self.keyframes.len().saturating_sub(1) };
        let distance = if is_keyframe { 0.0 } else { self.distances_to_next.last().copied().unwrap_or_default() };
        self.nodes.push(TrajectoryNode { stamp, keyframe, odom_from_base, odom_from_laser, distance });
    }

    fn add_keyframe(&mut self, posed_scan: PosedScan, is_start: bool) {
        let (odom_from_laser, covariance) = (posed_scan.odom_from_laser(), posed_scan.laser_covariance());
        let motion_covariance = self.odometry_covariance(&odom_from_laser, &covariance);
        self.last_covariance = covariance;
        let stamp = posed_scan.scan.stamp();
        let view = self.matcher.view(posed_scan.scan);
        let last = self.keyframes.last().map(|last| (last.odom_from_laser.between(&odom_from_laser), last.run, last.path_length));
        let number = self.keyframes.len();
        let (motion, run, path_length) = match last {
            Some((motion, run, path_length)) if !is_start => (motion, run, path_length + motion.distance()),
            Some((_, run, path_length)) => (Pose2::IDENTITY, run + 1, path_length),
            None => (odom_from_laser, 0, 0.0),
        };
        let previous = |poses: &[Pose2]| poses.last().copied().unwrap_or_default();
        let pose = if is_start { odom_from_laser } else { previous(&self.dead_reckoned) * motion };
        self.dead_reckoned.push(pose);
        self.graph.add_pose(if is_start { odom_from_laser } else { previous(self.graph.poses()) * motion });
        self.keyframes.push(Keyframe { stamp, odom_from_laser, view: Some(view), run, path_length });
        self.distances_to_next.push(0.0);
        if !is_start {
            let covariance = if self.is_lost { uncertainty::unknown_motion() } else { odometry_edge_covariance(&motion) };
            self.graph.add_edge(Edge { from: number - 1, to: number, motion, covariance, kind: EdgeKind::Odometry });
            self.remove_moved_surfaces(number);
            let is_matched = self.add_sequence(number);
            if let Some(covariance) = motion_covariance.filter(|_| !is_matched && !self.is_lost) {
                self.graph.add_edge(Edge { from: number - 1, to: number, motion, covariance, kind: EdgeKind::Sequence });
            }
        }
        self.is_lost = false;
        self.window_index = 0;
    }

    /// Removes from a keyframe and its predecessors the surfaces that have moved between them.
    fn remove_moved_surfaces(&mut self, number: usize) {
        let (before, later) = self.keyframes.split_at_mut(number);
        let Some(later) = later.first_mut() else { return };
        let first = number.saturating_sub(SEQUENTIAL_MATCHES);
        for earlier in before[first..].iter_mut().filter(|earlier| earlier.run == later.run) {
            let motion = earlier.odom_from_laser.between(&later.odom_from_laser);
            if let (Some(of_earlier), Some(of_later)) = (&mut earlier.view, &mut later.view) {
                View::remove_moved(of_earlier, of_later, &motion);
            }
        }
    }

    /// Covariance of the motion since the last keyframe, along its axes: the growth of the odometry covariance. It is used only if the
    /// keyframes do not match, because most of this information comes from matches of the same scans.
    fn odometry_covariance(&self, odom_from_laser: &Pose2, covariance: &PoseCovariance) -> Option<PoseCovariance> {
        let last = self.keyframes.last()?.odom_from_laser;
        let previous = uncertainty::propagated(&self.last_covariance, odom_from_laser.translation() - last.translation());
        Some(uncertainty::rotated(&uncertainty::positive_part(&(covariance - previous)), -last.theta) + edges::min_covariance())
    }

    /// Adds edges to the preceding keyframes; returns whether the keyframe matches the one just before it.
    fn add_sequence(&mut self, number: usize) -> bool {
        let mut is_matched = false;
        for earlier in (number.saturating_sub(SEQUENTIAL_MATCHES)..number).rev() {
            let (a, b) = (&self.keyframes[earlier], &self.keyframes[number]);
            if a.run != b.run {
                break;
            }
            let (Some(of_a), Some(of_b)) = (&a.view, &b.view) else { break };
            let predicted = self.predicted_motion(earlier, number);
            let result = self.matcher.compare(of_a, of_b, predicted.pose);
            // Odometry resolves ambiguous matches: one that contradicts it is rejected.
            let is_consistent = |result: &Match| {
                result.agreement >= MIN_AGREEMENT && predicted.mahalanobis_distance(&result.motion) <= MAX_DEVIATION
            };
            if let Some(matched) = result.filter(is_consistent) {
                let (motion, covariance) = (matched.motion, matched.covariance);
                self.graph.add_edge(Edge { from: earlier, to: number, motion, covariance, kind: EdgeKind::Sequence });
                is_matched |= earlier + 1 == number;
            }
        }
        is_matched
    }

    /// Motion from one keyframe to a later one of the same run, by odometry alone.
    fn predicted_motion(&self, earlier: usize, later: usize) -> Prior {
        let edges = self.graph.edges().iter().rev().filter(|edge| edge.kind == EdgeKind::Odometry && edge.to <= later);
        let start = Prior { pose: Pose2::IDENTITY, covariance: PoseCovariance::zeros() };
        // Compound from the last edge backwards; `after` is expressed in the frame where the edge ends.
        edges.take(later - earlier).fold(start, |after, edge| Prior {
            pose: edge.motion * after.pose,
            covariance: uncertainty::compound(&edge.motion, &edge.covariance, &after.pose, &after.covariance),
        })
    }

    /// Runs one round of loop closure search, small windows first, and optimizes the graph; returns whether there is more to do.
    pub fn improve(&mut self) -> bool {
        let Some(&limit) = WINDOWS.get(self.window_index) else { return false };
        let found = self.loops.find(&self.keyframes, &RelativeUncertainty::new(&self.graph), &mut self.matcher, limit, 0);
        self.window_index = if found.is_empty() { self.window_index + 1 } else { 0 };
        if !found.is_empty() {
            for edge in found {
                self.graph.add_edge(edge);
            }
            self.graph.optimize(COARSE_TOLERANCE);
        }
        self.window_index < WINDOWS.len()
    }

    /// Improves the map until no more loop closures are found, then optimizes it to the final tolerance.
    pub fn finish(&mut self) {
        self.graph.optimize(COARSE_TOLERANCE);
        self.window_index = 0;
        while self.join_runs() || self.window_index < WINDOWS.len() {
            for _ in 0..MAX_ROUNDS {
                if !self.improve() {
                    break;
                }
            }
            self.window_index = WINDOWS.len();
        }
        self.graph.optimize(FINAL_TOLERANCE);
    }

    /// Connects runs to the map that have no edge to it yet; returns whether any was connected.
    fn join_runs(&mut self) -> bool {
        let mut has_joined = false;
        for run in self.runs() {
            let is_on_map = self.is_on_map();
            if is_on_map[run.start] || run.len() < joining::MIN_KEYFRAMES {
                continue;
            }
            let known: Vec<usize> = (0..is_on_map.len()).filter(|&k| is_on_map[k] && self.keyframes[k].view.is_some()).collect();
            let poses = self.graph.poses();
            let Some(alignment) = joining::find(&self.keyframes, poses, &known, run.clone(), &mut self.matcher) else { continue };
            self.graph.move_poses(run.clone(), &alignment.correction);
            self.dead_reckoned[run].iter_mut().for_each(|pose| *pose = alignment.correction * *pose);
            alignment.edges.into_iter().for_each(|edge| self.graph.add_edge(edge));
            self.graph.optimize(COARSE_TOLERANCE);
            (has_joined, self.window_index) = (true, 0);
        }
        has_joined
    }

    /// Indices of the keyframes of each run.
    fn runs(&self) -> Vec<Range<usize>> {
        let mut runs: Vec<Range<usize>> = Vec::new();
        for run in self.keyframes.chunk_by(|a, b| a.run == b.run) {
            let start = runs.last().map_or(0, |last| last.end);
            runs.push(start..start + run.len());
        }
        runs
    }

    /// Whether each keyframe is on the map, which is the largest connected component of the graph.
    fn is_on_map(&self) -> Vec<bool> {
        let components = self.graph.components();
        let mut sizes = vec![0_usize; components.len()];
        for &first in &components {
            sizes[first] += 1;
        }
        let most = sizes.iter().copied().max().unwrap_or_default();
        let largest = sizes.iter().position(|&size| size == most);
        components.iter().map(|first| Some(*first) == largest).collect()
    }

    /// Number of runs that are not connected to the map, and hence missing from the grid. Runs of a single keyframe do not count.
    pub fn unplaced_runs(&self) -> usize {
        let is_on_map = self.is_on_map();
        self.runs().iter().filter(|run| !is_on_map[run.start] && run.len() > 1).count()
    }

    /// Current estimate of the base's pose on the map at every scan.
    pub fn trajectory(&self) -> Vec<StampedPose> {
        if self.keyframes.is_empty() {
            return Vec::new();
        }
        let interpolator = self.interpolator();
        self.nodes
            .iter()
            .map(|node| StampedPose { stamp: node.stamp, pose: interpolator.map_pose(node, &node.odom_from_base) })
            .collect()
    }

    /// Builds the grid from all scans at their current poses.
    pub fn grid(&self, resolution: f64) -> EvidenceGrid {
        let interpolator = self.interpolator();
        let mut grid = EvidenceGrid::new(resolution);
        let is_on_map = self.is_on_map();
        for GridScan { node, points, .. } in self.grid_scans.iter().filter(|scan| is_on_map[scan.node.keyframe]) {
            grid.insert(points, &interpolator.map_pose(node, &node.odom_from_laser));
        }
        grid
    }

    fn interpolator(&self) -> TrajectoryInterpolator<'_> {
        TrajectoryInterpolator {
            keyframes: &self.keyframes,
            poses: self.graph.poses(),
            distances_to_next: &self.distances_to_next,
        }
    }

    /// The keyframes.
    pub fn keyframes(&self) -> &[Keyframe] {
        &self.keyframes
    }

    /// The pose graph: poses of the keyframes' lasers on the map, and the edges between them.
    pub fn graph(&self) -> &PoseGraph {
        &self.graph
    }

    /// Statistics of the loop closures so far.
    pub fn progress(&self) -> Progress {
        let mut progress = Progress::default();
        let (mut before, mut after) = (0.0, 0.0);
        for (number, edge) in self.graph.edges().iter().enumerate().filter(|(_, edge)| edge.kind == EdgeKind::Loop) {
            progress.loops += 1;
            let squared_error =
                |poses: &[Pose2]| poses[edge.from].between(&poses[edge.to]).between(&edge.motion).distance().powi(2);
            before += squared_error(&self.dead_reckoned);
            if self.graph.weight(number) < OUTVOTED_WEIGHT {
                progress.outvoted += 1;
            } else {
                after += squared_error(self.graph.poses());
            }
        }
        let mean = |sum: f64, count: usize| (sum / count.max(1) as f64).sqrt();
        progress.residual_before = mean(before, progress.loops);
        progress.residual_after = mean(after, progress.loops - progress.outvoted);
        progress
    }
}

/// A loop edge with a robust weight below this is contradicted by the others.
const OUTVOTED_WEIGHT: f64 = 0.05;

/// Covariance of an odometry edge: that of wheel odometry for this motion in unlimited time. It is large, so the edge matters only
/// where matches leave the motion unconstrained.
fn odometry_edge_covariance(motion: &Pose2) -> PoseCovariance {
    uncertainty::wheel_covariance(motion, f64::INFINITY)
}

/// End points of the rays in the laser's frame; NaN for rays without a return.
#[allow(clippy::cast_possible_truncation)] // to single precision
fn end_points(scan: &Scan) -> Vec<[f32; 2]> {
    let point = |i: usize| scan.point(i).map_or([f32::NAN; 2], |point| [point.x as f32, point.y as f32]);
    (0..scan.len()).map(point).collect()
}
