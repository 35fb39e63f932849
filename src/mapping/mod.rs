//! Maps: keyframes along the path, a graph of what is known of the motions between them, and what stands where.
//!
//! [`Mapper::add`] takes scan by scan what odometry makes of it. [`Mapper::improve`] looks for places of earlier and moves the keyframes to
//! where all edges fit best, one round at a call; [`Mapper::finish`] does it until nothing more is found. [`Mapper::trajectory`] and
//! [`Mapper::grid`] answer by what is known so far.
//!
//! | file | what |
//! |---|---|
//! | `keyframe` | a scan with its pose by odometry; when it is kept |
//! | `edges` | matches of two keyframes, with honest covariances |
//! | `pose_graph`, `sparse` | the poses that fit all edges best |
//! | `loops` | where to look for places of earlier, and what to believe |
//! | `joining` | where on the map a run begins of which nobody knows |
//! | `trajectory` | every scan between its keyframes |
//! | `grid` | what stands where |
//! | `live` | all of it while the robot drives |
//! | `self_hits` | rays that see the robot itself |
//! | `graph_file` | all of it in a file, to go on with |

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
pub mod sparse;
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
pub use keyframe::{Keyframe, Passage, Sighting};
pub use live::LiveMap;
use loops::{LoopSearch, WINDOWS, Ways};
pub use pose_graph::{Edge, EdgeKind, PoseGraph};
pub use self_hits::SelfHits;
use trajectory::Placer;
pub use trajectory::Step;

crate::knobs! {
    /// The mapper's map.
    pub struct MappingKnobs {
        /// Side of a cell.
        resolution: f64 = 0.05, in 0.005 to 1, unit "m";
        /// Folder that maps are saved in; relative to where the node was started, which for `roslaunch` is `~/.ros`.
        directory: String = ".".into();
        /// What a saved map is called: NAME.yaml, NAME.pgm and NAME.graph. A name, not a path.
        name: String = "map".into();
        /// Save the map when the node ends.
        save_on_exit: bool = false;
    }
}

/// A keyframe is matched to so many before it.
const SEQUENCE: usize = 3;
/// Least part of the rays that must agree in such a match.
const AGREEING: f64 = 0.6;
/// ... and is this many standard deviations at most from what odometry says: 99 % of three coordinates (chi-squared 11.3).
const CONTRADICTING: f64 = 3.4;
/// Rounds of looking for places of earlier at most: each finds some, or is of a greater window.
const MAX_ROUNDS: usize = 60;
/// Poses are found to this, m and rad, while more is to be found, ...
const ROUGHLY: f64 = 1e-3;
/// ... and to this in the end.
const FINALLY: f64 = 1e-5;
/// A step that is not known errs by this, m ...
const LOST_ERROR: f64 = 1.0;
/// ... and this, rad.
const LOST_TURN: f64 = 0.3;

/// A scan to be drawn: where its rays end, seen from the laser.
#[derive(Clone, Debug)]
struct Drawn {
    step: Step,
    /// None where newer scans have taken its place.
    points: Vec<[f32; 2]>,
    /// Where it is in a grid that is kept up to date.
    at: Option<Pose2>,
}

/// How far a map has come.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Progress {
    /// Loop edges.
    pub loops: usize,
    /// Those that all the others contradict: they weigh next to nothing.
    pub outvoted: usize,
    /// Root mean square of what the loop edges are off by odometry alone, m.
    pub residual_before: f64,
    /// The same on the map, of those that are not outvoted, m.
    pub residual_after: f64,
}

/// Makes a map of what odometry hands it.
pub struct Mapper {
    matcher: EdgeMatcher,
    keyframes: Vec<Keyframe>,
    /// Their poses on the map, by index, and what is known of the motions between them.
    graph: PoseGraph,
    /// Their poses by odometry and the runs' starts alone.
    by_odometry: Vec<Pose2>,
    /// Way from each keyframe to the next, as [`Step::way`] counts it, m.
    ways: Vec<f64>,
    steps: Vec<Step>,
    drawn: Vec<Drawn>,
    /// Of the last keyframe's pose by odometry, along the axes of its frame.
    last_covariance: PoseCovariance,
    is_lost: bool,
    last_drawn: Option<Pose2>,
    /// Between scans that are drawn.
    drawn_spacing: Spacing,
    loops: LoopSearch,
    /// Index into the windows to look through.
    window: usize,
}

impl Mapper {
    /// An empty map.
    pub fn new(matching: &MatchingKnobs, rejection: &RejectionKnobs) -> Self {
        Self {
            matcher: EdgeMatcher::new(matching, rejection),
            keyframes: Vec::new(),
            graph: PoseGraph::default(),
            by_odometry: Vec::new(),
            ways: Vec::new(),
            steps: Vec::new(),
            drawn: Vec::new(),
            last_covariance: PoseCovariance::zeros(),
            is_lost: false,
            last_drawn: None,
            drawn_spacing: Spacing::DRAWN,
            loops: LoopSearch::default(),
            window: 0,
        }
    }

    /// Takes a scan; answers whether it has become a keyframe.
    pub fn add(&mut self, sighting: Sighting) -> bool {
        let odom_from_laser = sighting.odom_from_laser();
        self.is_lost |= sighting.passage == Passage::Lost;
        let is_start = sighting.passage == Passage::Start || self.keyframes.is_empty();
        // Two lasers may take turns.
        let mut last = self.keyframes.iter().rev().take(2).map(|last| last.odom_from_laser.between(&odom_from_laser));
        let becomes_keyframe = is_start || self.is_lost || last.all(|motion| Spacing::KEYFRAMES.is_exceeded_by(&motion));
        self.add_step(sighting.scan.stamp(), sighting.odom_from_base, odom_from_laser, is_start, becomes_keyframe);
        let moved = self.last_drawn.map(|last| last.between(&odom_from_laser));
        if is_start || becomes_keyframe || moved.is_none_or(|moved| self.drawn_spacing.is_exceeded_by(&moved)) {
            self.last_drawn = Some(odom_from_laser);
            let points = end_points(&sighting.scan);
            self.drawn.extend(self.steps.last().map(|&step| Drawn { step, points, at: None }));
        }
        if becomes_keyframe {
            self.add_keyframe(sighting, is_start);
        }
        becomes_keyframe
    }

    /// Takes the pose of a scan that could not be used.
    pub fn add_unseen(&mut self, stamp: Stamp, odom_from_base: Pose2, base_from_laser: &Pose2) {
        self.add_step(stamp, odom_from_base, odom_from_base * *base_from_laser, false, false);
    }

    fn add_step(&mut self, stamp: Stamp, odom_from_base: Pose2, odom_from_laser: Pose2, is_start: bool, is_keyframe: bool) {
        if !is_start && let (Some(last), Some(way)) = (self.steps.last(), self.ways.last_mut()) {
            let motion = last.odom_from_laser.between(&odom_from_laser);
            *way += motion.distance() + motion.theta.abs();
        }
        let keyframe = if is_keyframe { self.keyframes.len() } else { self.keyframes.len().saturating_sub(1) };
        let way = if is_keyframe { 0.0 } else { self.ways.last().copied().unwrap_or_default() };
        self.steps.push(Step { stamp, keyframe, odom_from_base, odom_from_laser, way });
    }

    fn add_keyframe(&mut self, sighting: Sighting, is_start: bool) {
        let (odom_from_laser, covariance) = (sighting.odom_from_laser(), sighting.laser_covariance());
        let known = self.known_by_odometry(&odom_from_laser, &covariance);
        self.last_covariance = covariance;
        let stamp = sighting.scan.stamp();
        let view = self.matcher.view(sighting.scan);
        let last = self.keyframes.last().map(|last| (last.odom_from_laser.between(&odom_from_laser), last.run, last.way));
        let number = self.keyframes.len();
        let (motion, run, way) = match last {
            Some((motion, run, way)) if !is_start => (motion, run, way + motion.distance()),
            Some((_, run, way)) => (Pose2::IDENTITY, run + 1, way),
            None => (odom_from_laser, 0, 0.0),
        };
        let before = |poses: &[Pose2]| poses.last().copied().unwrap_or_default();
        let place = if is_start { odom_from_laser } else { before(&self.by_odometry) * motion };
        self.by_odometry.push(place);
        self.graph.add_pose(if is_start { odom_from_laser } else { before(self.graph.poses()) * motion });
        self.keyframes.push(Keyframe { stamp, odom_from_laser, view: Some(view), run, way });
        self.ways.push(0.0);
        if !is_start {
            let covariance = if self.is_lost { uncertainty::diagonal(LOST_ERROR, LOST_TURN) } else { of_step(&motion) };
            self.graph.add_edge(Edge { from: number - 1, to: number, motion, covariance, kind: EdgeKind::Odometry });
            self.forget_moved(number);
            let is_matched = self.add_sequence(number);
            if let Some(covariance) = known.filter(|_| !is_matched && !self.is_lost) {
                self.graph.add_edge(Edge { from: number - 1, to: number, motion, covariance, kind: EdgeKind::Sequence });
            }
        }
        self.is_lost = false;
        self.window = 0;
    }

    /// A keyframe and those before it forget what has moved between them.
    fn forget_moved(&mut self, number: usize) {
        let (before, later) = self.keyframes.split_at_mut(number);
        let Some(later) = later.first_mut() else { return };
        let first = number.saturating_sub(SEQUENCE);
        for earlier in before[first..].iter_mut().filter(|earlier| earlier.run == later.run) {
            let motion = earlier.odom_from_laser.between(&later.odom_from_laser);
            if let (Some(of_earlier), Some(of_later)) = (&mut earlier.view, &mut later.view) {
                View::forget_moved(of_earlier, of_later, &motion);
            }
        }
    }

    /// What odometry knows of the motion from the last keyframe to here, along its axes: what the pose's covariance has grown by. Most of it is
    /// by matches of the same scans, so that it counts only where keyframes do not match.
    fn known_by_odometry(&self, odom_from_laser: &Pose2, covariance: &PoseCovariance) -> Option<PoseCovariance> {
        let last = self.keyframes.last()?.odom_from_laser;
        let carried = uncertainty::carried(&self.last_covariance, odom_from_laser.translation() - last.translation());
        Some(uncertainty::turned(&uncertainty::positive(&(covariance - carried)), -last.theta) + edges::least())
    }

    /// Edges to the keyframes before one; answers whether it matches the one just before.
    fn add_sequence(&mut self, number: usize) -> bool {
        let mut is_matched = false;
        for earlier in (number.saturating_sub(SEQUENCE)..number).rev() {
            let (a, b) = (&self.keyframes[earlier], &self.keyframes[number]);
            if a.run != b.run {
                break;
            }
            let (Some(of_a), Some(of_b)) = (&a.view, &b.view) else { break };
            let told = self.told_by_odometry(earlier, number);
            let made = self.matcher.compare(of_a, of_b, told.pose);
            // Scans that fit in several places are of none that odometry contradicts.
            let holds = |made: &Match| made.agreement >= AGREEING && told.deviation(&made.motion) <= CONTRADICTING;
            if let Some(made) = made.filter(holds) {
                let (motion, covariance) = (made.motion, made.covariance);
                self.graph.add_edge(Edge { from: earlier, to: number, motion, covariance, kind: EdgeKind::Sequence });
                is_matched |= earlier + 1 == number;
            }
        }
        is_matched
    }

    /// The motion from one keyframe to a later one of the same run, by odometry alone.
    fn told_by_odometry(&self, earlier: usize, later: usize) -> Prior {
        let steps = self.graph.edges().iter().rev().filter(|edge| edge.kind == EdgeKind::Odometry && edge.to <= later);
        let begun = Prior { pose: Pose2::IDENTITY, covariance: PoseCovariance::zeros() };
        // From the last step back: what comes before is seen from its start.
        steps.take(later - earlier).fold(begun, |after, step| Prior {
            pose: step.motion * after.pose,
            covariance: uncertainty::compound(&step.motion, &step.covariance, &after.pose, &after.covariance),
        })
    }

    /// One round of looking for places of earlier, in small windows first, and the poses that fit; answers whether there is more to do.
    pub fn improve(&mut self) -> bool {
        let Some(&limit) = WINDOWS.get(self.window) else { return false };
        let found = self.loops.find(&self.keyframes, &Ways::new(&self.graph), &mut self.matcher, limit, 0);
        self.window = if found.is_empty() { self.window + 1 } else { 0 };
        if !found.is_empty() {
            for edge in found {
                self.graph.add_edge(edge);
            }
            self.graph.optimize(ROUGHLY);
        }
        self.window < WINDOWS.len()
    }

    /// Improves the map as long as anything is found.
    pub fn finish(&mut self) {
        self.graph.optimize(ROUGHLY);
        self.window = 0;
        while self.join_runs() || self.window < WINDOWS.len() {
            for _ in 0..MAX_ROUNDS {
                if !self.improve() {
                    break;
                }
            }
            self.window = WINDOWS.len();
        }
        self.graph.optimize(FINALLY);
    }

    /// Places runs on the map that do not hang together with it; answers whether any was placed.
    fn join_runs(&mut self) -> bool {
        let mut has_joined = false;
        for run in self.runs() {
            let is_placed = self.placed();
            if is_placed[run.start] || run.len() < joining::FEWEST {
                continue;
            }
            let known: Vec<usize> = (0..is_placed.len()).filter(|&k| is_placed[k] && self.keyframes[k].view.is_some()).collect();
            let poses = self.graph.poses();
            let Some(junction) = joining::find(&self.keyframes, poses, &known, run.clone(), &mut self.matcher) else { continue };
            self.graph.move_poses(run.clone(), &junction.correction);
            self.by_odometry[run].iter_mut().for_each(|pose| *pose = junction.correction * *pose);
            junction.edges.into_iter().for_each(|edge| self.graph.add_edge(edge));
            self.graph.optimize(ROUGHLY);
            (has_joined, self.window) = (true, 0);
        }
        has_joined
    }

    /// The keyframes of each run.
    fn runs(&self) -> Vec<Range<usize>> {
        let mut runs: Vec<Range<usize>> = Vec::new();
        for run in self.keyframes.chunk_by(|a, b| a.run == b.run) {
            let start = runs.last().map_or(0, |last| last.end);
            runs.push(start..start + run.len());
        }
        runs
    }

    /// Whether each keyframe is on the map: hangs together with the most others.
    fn placed(&self) -> Vec<bool> {
        let components = self.graph.components();
        let mut sizes = vec![0_usize; components.len()];
        for &first in &components {
            sizes[first] += 1;
        }
        let most = sizes.iter().copied().max().unwrap_or_default();
        let largest = sizes.iter().position(|&size| size == most);
        components.iter().map(|first| Some(*first) == largest).collect()
    }

    /// Runs whose place on the map is not known: they are not drawn. Those that led nowhere do not count.
    pub fn unplaced_runs(&self) -> usize {
        let is_placed = self.placed();
        self.runs().iter().filter(|run| !is_placed[run.start] && run.len() > 1).count()
    }

    /// Pose of the base at every scan, by what is known now.
    pub fn trajectory(&self) -> Vec<StampedPose> {
        if self.keyframes.is_empty() {
            return Vec::new();
        }
        let placer = self.placer();
        self.steps.iter().map(|step| StampedPose { stamp: step.stamp, pose: placer.place(step, &step.odom_from_base) }).collect()
    }

    /// Draws everything seen.
    pub fn grid(&self, resolution: f64) -> EvidenceGrid {
        let placer = self.placer();
        let mut grid = EvidenceGrid::new(resolution);
        let is_placed = self.placed();
        for Drawn { step, points, .. } in self.drawn.iter().filter(|drawn| is_placed[drawn.step.keyframe]) {
            grid.draw(points, &placer.place(step, &step.odom_from_laser));
        }
        grid
    }

    fn placer(&self) -> Placer<'_> {
        Placer { keyframes: &self.keyframes, poses: self.graph.poses(), ways: &self.ways }
    }

    /// The keyframes.
    pub fn keyframes(&self) -> &[Keyframe] {
        &self.keyframes
    }

    /// Poses of their lasers, and the edges between them.
    pub fn graph(&self) -> &PoseGraph {
        &self.graph
    }

    /// How far the map has come.
    pub fn progress(&self) -> Progress {
        let mut progress = Progress::default();
        let (mut before, mut after) = (0.0, 0.0);
        for (number, edge) in self.graph.edges().iter().enumerate().filter(|(_, edge)| edge.kind == EdgeKind::Loop) {
            progress.loops += 1;
            let off = |poses: &[Pose2]| poses[edge.from].between(&poses[edge.to]).between(&edge.motion).distance().powi(2);
            before += off(&self.by_odometry);
            if self.graph.weight(number) < OUTVOTED {
                progress.outvoted += 1;
            } else {
                after += off(self.graph.poses());
            }
        }
        let mean = |sum: f64, count: usize| (sum / count.max(1) as f64).sqrt();
        progress.residual_before = mean(before, progress.loops);
        progress.residual_after = mean(after, progress.loops - progress.outvoted);
        progress
    }
}

/// A loop edge with less of its weight left is contradicted by the others.
const OUTVOTED: f64 = 0.05;

/// Covariance of a motion between keyframes by odometry: that of wheels that drove it in any time, so that it counts where matches say
/// nothing, and only there.
fn of_step(motion: &Pose2) -> PoseCovariance {
    uncertainty::of_wheels(motion, f64::INFINITY)
}

#[allow(clippy::cast_possible_truncation)] // to single precision
fn end_points(scan: &Scan) -> Vec<[f32; 2]> {
    let point = |i: usize| scan.point(i).map_or([f32::NAN; 2], |point| [point.x as f32, point.y as f32]);
    (0..scan.len()).map(point).collect()
}
