//! Loop closure candidates: where to search for earlier places along the path, and which matches to accept.
//!
//! The relative pose covariance of two keyframes is that of the best path between them along the graph's edges (E. Olson, "Robust and
//! efficient robotic mapping", 2008: Dijkstra's algorithm over covariances). It defines the search window. Small windows come first:
//! their matches are unambiguous, and they shrink the other windows. In a large window a single match proves nothing, because other
//! places may fit, too. There, several consecutive keyframes must agree on the same correction, and no other place in the window may
//! fit as well. Between two corridors that look alike, a loop is closed only once the window is smaller than their distance.

use std::collections::{BTreeMap, BinaryHeap};
use std::ops::Range;

use super::LEVER_ARM;
use super::edges::{EdgeMatcher, Match};
use super::keyframe::Keyframe;
use super::pose_graph::{Edge, EdgeKind, PoseGraph, jacobians};
use crate::geometry::{Pose2, PoseCovariance};
use crate::matching::SearchWindow;
use crate::odometry::uncertainty::{propagated, rotated};

/// Minimum difference of the indices of two keyframes of different visits.
const MIN_INDEX_DIFFERENCE: usize = 8;
/// Maximum difference of two views (see [`Pose2::magnitude`]), m; beyond it two keyframes overlap too little.
const MAX_DISTANCE: f64 = 1.5;
/// Maximum number of loop edges from a keyframe to earlier ones.
const MAX_EDGES: usize = 2;
/// Half-width of a search window, standard deviations.
const WINDOW_SIGMAS: f64 = 3.0;
/// Largest half-width of a small window, m. There a match started at the centre finds the right pose, and nothing else fits.
const SMALL_WINDOW: f64 = 0.3;
/// Largest half-width of a small window, rad.
const SMALL_WINDOW_ANGLE: f64 = 0.1;
/// Half-widths of the windows that are searched, m; a larger one only when the smaller ones yield nothing more.
pub(super) const WINDOWS: [f64; 5] = [SMALL_WINDOW, 1.0, 2.5, 5.0, 10.0];
/// Maximum half-width of a window, rad.
const MAX_WINDOW_ANGLE: f64 = 0.35;
/// Minimum fraction of rays that must agree in a small window.
const MIN_AGREEMENT: f64 = 0.6;
/// Minimum fraction of rays that must agree in larger windows.
const MIN_AGREEMENT_IN_LARGE_WINDOWS: f64 = 0.75;
/// Maximum condition number of a match; beyond it the position along a wall is poorly constrained.
const MAX_CONDITION_NUMBER: f64 = 50.0;
/// Minimum number of consecutive keyframes that must agree on a correction.
const MIN_MATCHES: usize = 3;
/// Maximum distance between the corrected poses of keyframes that agree, m.
const CONSISTENT_DISTANCE: f64 = 0.15;
/// Maximum rotation between the corrected poses of keyframes that agree, rad.
const CONSISTENT_ANGLE: f64 = 0.02;
/// A competing hypothesis whose fraction of agreeing rays is within this margin of the best one's makes the result ambiguous.
const AMBIGUITY_MARGIN: f64 = 0.1;
/// A pair of keyframes is matched again when its initial guess has changed by this, m and rad.
const RETRY_CHANGE: f64 = 0.05;
/// Length of a segment of the path, m. All its keyframes share one search window.
const SEGMENT_LENGTH: f64 = 2.0;
/// Minimum path length between two visits to a place, m.
const MIN_VISIT_GAP: f64 = 15.0;

/// Searches for loop closures, and remembers previous attempts.
#[derive(Clone, Debug, Default)]
pub(super) struct LoopSearch {
    /// By later and earlier keyframe: initial guess and result of the last attempt.
    attempts: BTreeMap<(usize, usize), (Pose2, Option<Match>)>,
    /// By later keyframe: the earlier keyframes that it has loop edges to.
    loop_edges: BTreeMap<usize, Vec<usize>>,
}

/// Search window: bounds on the pose of one keyframe relative to another.
#[derive(Clone, Copy, Debug)]
struct Window {
    /// Half-width, m.
    distance: f64,
    /// Half-width, rad.
    angle: f64,
}

impl Window {
    fn of(covariance: &PoseCovariance) -> Self {
        let (mean, half) = (0.5 * (covariance.m11 + covariance.m22), 0.5 * (covariance.m11 - covariance.m22));
        let variance = mean + half.hypot(covariance.m12);
        Self { distance: WINDOW_SIGMAS * variance.max(0.0).sqrt(), angle: WINDOW_SIGMAS * covariance.m33.max(0.0).sqrt() }
    }

    fn is_small(self) -> bool {
        self.distance <= SMALL_WINDOW && self.angle <= SMALL_WINDOW_ANGLE
    }
}

impl LoopSearch {
    /// Returns new loop edges, searched in windows of at most `limit` metres, for the segments of the path that end after keyframe `since`.
    pub(super) fn find(
        &mut self,
        keyframes: &[Keyframe],
        uncertainty: &RelativeUncertainty,
        matcher: &mut EdgeMatcher,
        limit: f64,
        since: usize,
    ) -> Vec<Edge> {
        let mut found = Vec::new();
        let mut start = 0;
        while start < keyframes.len() {
            let is_in_segment =
                |k: &Keyframe| k.run == keyframes[start].run && k.path_length - keyframes[start].path_length < SEGMENT_LENGTH;
            let end = start + keyframes[start..].iter().take_while(|k| is_in_segment(k)).count();
            let mut segment = Segment { keyframes, poses: uncertainty.poses, later: start..end, candidates: Vec::new(), limit };
            if end <= since {
                start = end;
                continue;
            }
            if limit <= SMALL_WINDOW {
                segment.find_candidates(uncertainty);
                self.match_small_windows(&segment, matcher, &mut found);
            } else if !(start..end).any(|k| self.loop_edges.contains_key(&k)) {
                segment.find_candidates(uncertainty);
                self.search_large_windows(&segment, matcher, &mut found);
            }
            start = end;
        }
        found
    }

    /// Drops the attempts of a keyframe whose scan was released.
    pub(super) fn forget(&mut self, later: usize) {
        let earlier: Vec<usize> = self.attempts.range((later, 0)..(later + 1, 0)).map(|(&(_, earlier), _)| earlier).collect();
        for earlier in earlier {
            self.attempts.remove(&(later, earlier));
        }
    }

    /// Matches the keyframes of a segment against the nearest ones of earlier visits, if their windows are small.
    fn match_small_windows(&mut self, segment: &Segment, matcher: &mut EdgeMatcher, found: &mut Vec<Edge>) {
        for later in segment.later.clone() {
            let small =
                segment.candidates.iter().filter(|(earlier, window)| window.is_small() && earlier + MIN_INDEX_DIFFERENCE < later);
            let mut nearest: Vec<(f64, usize)> = small
                .map(|&(earlier, _)| (segment.view_difference(earlier, later), earlier))
                .filter(|(difference, _)| *difference < MAX_DISTANCE)
                .collect();
            nearest.sort_by(|a, b| a.0.total_cmp(&b.0));
            for (_, earlier) in nearest.into_iter().take(MAX_EDGES) {
                if self.loop_edges.get(&later).is_some_and(|edges| edges.len() >= MAX_EDGES || edges.contains(&earlier)) {
                    continue;
                }
                let guess = segment.guess(earlier, later);
                let matched = self.compare(segment, matcher, (earlier, later), guess, SearchWindow::default());
                let is_in_window = |matched: &Match| guess.between(&matched.motion).distance() <= 2.0 * SMALL_WINDOW;
                if let Some(matched) = matched.filter(|matched| matched.agreement >= MIN_AGREEMENT && is_in_window(matched)) {
                    self.add(earlier, later, &matched, found);
                }
            }
        }
    }

    /// Searches for a segment without loop edges in all earlier visits whose windows reach it.
    fn search_large_windows(&mut self, segment: &Segment, matcher: &mut EdgeMatcher, found: &mut Vec<Edge>) {
        let mut hypotheses: Vec<Hypothesis> =
            segment.visits().iter().filter_map(|visit| self.hypothesis(segment, matcher, visit)).collect();
        hypotheses.sort_by(|a, b| b.agreement.total_cmp(&a.agreement));
        let Some(best) = hypotheses.first() else { return };
        let middle = segment.poses[segment.middle()];
        let is_competing = |other: &Hypothesis| {
            other.agreement > best.agreement - AMBIGUITY_MARGIN
                && !is_consistent(&(other.correction * middle), &(best.correction * middle))
        };
        if best.is_reliable() && !hypotheses[1..].iter().any(is_competing) {
            for &(earlier, later, matched) in &best.matches {
                self.add(earlier, later, &matched, found);
            }
        }
    }

    /// The correction that the keyframes of a segment agree on when matched against one visit; `None` if they disagree.
    fn hypothesis(&mut self, segment: &Segment, matcher: &mut EdgeMatcher, visit: &[(usize, Window)]) -> Option<Hypothesis> {
        let mut hypothesis: Option<Hypothesis> = None;
        for later in segment.later.clone() {
            let before = visit.iter().filter(|(earlier, _)| earlier + MIN_INDEX_DIFFERENCE < later);
            let difference = |earlier: usize| segment.view_difference(earlier, later);
            let &(earlier, Window { distance, angle }) = before.min_by(|a, b| difference(a.0).total_cmp(&difference(b.0)))?;
            let window = SearchWindow {
                distance: distance.max(SMALL_WINDOW),
                angle: angle.clamp(SMALL_WINDOW_ANGLE, MAX_WINDOW_ANGLE),
                min_agreement: f64::INFINITY,
            };
            let hypothesis_so_far = hypothesis.as_ref().filter(|_| later + 1 < segment.later.end);
            let (guess, window) = match hypothesis_so_far {
                // The first and the last keyframe search the whole window; those between only have to confirm.
                Some(hypothesis) => {
                    let corrected = hypothesis.correction * segment.poses[later];
                    (segment.poses[earlier].between(&corrected), SearchWindow::default())
                }
                None => (segment.guess(earlier, later), window),
            };
            let matched = self.compare(segment, matcher, (earlier, later), guess, window)?;
            if matched.agreement < MIN_AGREEMENT || matched.condition_number > MAX_CONDITION_NUMBER {
                break;
            }
            let correction = segment.poses[earlier] * matched.motion * segment.poses[later].inverse();
            let hypothesis = hypothesis.get_or_insert_with(|| Hypothesis { correction, agreement: 1.0, matches: Vec::new() });
            if !is_consistent(&(hypothesis.correction * segment.poses[later]), &(correction * segment.poses[later])) {
                return None;
            }
            hypothesis.agreement = hypothesis.agreement.min(matched.agreement);
            hypothesis.matches.push((earlier, later, matched));
        }
        hypothesis.filter(|hypothesis| hypothesis.matches.len() >= MIN_MATCHES)
    }

    fn add(&mut self, from: usize, to: usize, matched: &Match, found: &mut Vec<Edge>) {
        self.loop_edges.entry(to).or_default().push(from);
        found.push(Edge { from, to, motion: matched.motion, covariance: matched.covariance, kind: EdgeKind::Loop });
    }

    /// Matches two keyframes; `None` if they overlap too little. Reuses the last result while the initial guess has hardly changed.
    fn compare(
        &mut self,
        segment: &Segment,
        matcher: &mut EdgeMatcher,
        (earlier, later): (usize, usize),
        guess: Pose2,
        window: SearchWindow,
    ) -> Option<Match> {
        if let Some((last_guess, matched)) = self.attempts.get(&(later, earlier))
            && last_guess.is_near(&guess, RETRY_CHANGE, RETRY_CHANGE)
        {
            return *matched;
        }
        let [of_earlier, of_later] = [earlier, later].map(|k| segment.keyframes[k].view.as_ref());
        let matched = matcher.compare_visits(of_earlier?, of_later?, guess, window);
        self.attempts.insert((later, earlier), (guess, matched));
        matched
    }
}

/// Whether two corrected poses of a keyframe are consistent.
fn is_consistent(a: &Pose2, b: &Pose2) -> bool {
    a.is_near(b, CONSISTENT_DISTANCE, CONSISTENT_ANGLE)
}

/// A hypothesis for the pose of a segment.
struct Hypothesis {
    /// Transforms the segment's current poses to the hypothesis.
    correction: Pose2,
    /// Fraction of agreeing rays, the minimum over the matches.
    agreement: f64,
    /// Earlier keyframe, later keyframe, and their match.
    matches: Vec<(usize, usize, Match)>,
}

impl Hypothesis {
    fn is_reliable(&self) -> bool {
        self.agreement >= MIN_AGREEMENT_IN_LARGE_WINDOWS
    }
}

/// A segment of the path.
struct Segment<'a> {
    keyframes: &'a [Keyframe],
    poses: &'a [Pose2],
    /// Its keyframes, by index.
    later: Range<usize>,
    /// Loop closure candidates: keyframes of earlier visits that may be near, with their search windows.
    candidates: Vec<(usize, Window)>,
    /// Maximum half-width of the search windows, m.
    limit: f64,
}

impl Segment<'_> {
    fn middle(&self) -> usize {
        usize::midpoint(self.later.start, self.later.end)
    }

    fn guess(&self, earlier: usize, later: usize) -> Pose2 {
        self.poses[earlier].between(&self.poses[later])
    }

    fn view_difference(&self, earlier: usize, later: usize) -> f64 {
        self.guess(earlier, later).magnitude()
    }

    /// Finds the loop closure candidates: first all keyframes within the limit, then those of them whose windows reach this segment.
    fn find_candidates(&mut self, uncertainty: &RelativeUncertainty) {
        let position = self.poses[self.middle()].translation();
        let gap = |earlier: usize| (self.poses[earlier].translation() - position).norm() - MAX_DISTANCE - SEGMENT_LENGTH;
        let is_candidate = |&earlier: &usize| self.keyframes[earlier].view.is_some() && gap(earlier) < self.limit;
        let within_limit: Vec<usize> = (0..self.later.end.saturating_sub(MIN_INDEX_DIFFERENCE)).filter(is_candidate).collect();
        if within_limit.is_empty() {
            return;
        }
        let known = uncertainty.from(self.middle(), self.limit);
        let window = |earlier: usize| Some((earlier, Window::of(known[earlier].as_ref()?)));
        let candidates = within_limit.into_iter().filter_map(window);
        self.candidates = candidates.filter(|&(earlier, w)| w.distance <= self.limit && gap(earlier) < w.distance).collect();
    }

    /// The candidates grouped by visit, without visits whose windows are all small.
    fn visits(&self) -> Vec<&[(usize, Window)]> {
        let path_length = |candidate: &(usize, Window)| self.keyframes[candidate.0].path_length;
        let visits = self.candidates.chunk_by(|a, b| path_length(b) - path_length(a) < MIN_VISIT_GAP);
        visits.filter(|visit| visit.iter().any(|(_, window)| !window.is_small())).collect()
    }
}

/// Relative pose covariances of keyframes, along the best paths in the graph.
pub(super) struct RelativeUncertainty<'a> {
    poses: &'a [Pose2],
    /// By keyframe: its neighbours in the graph, and the covariances of the motions to them, along the axes of the map.
    neighbours: Vec<Vec<(usize, PoseCovariance)>>,
}

/// Entry of the priority queue of Dijkstra's algorithm; the smallest variance comes first.
#[derive(PartialEq)]
struct QueueEntry {
    variance: f64,
    keyframe: usize,
}

impl Eq for QueueEntry {}

impl Ord for QueueEntry {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        other.variance.total_cmp(&self.variance).then(other.keyframe.cmp(&self.keyframe))
    }
}

impl PartialOrd for QueueEntry {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl<'a> RelativeUncertainty<'a> {
    pub(super) fn new(graph: &'a PoseGraph) -> Self {
        let poses = graph.poses();
        let mut neighbours = vec![Vec::new(); poses.len()];
        for ((from, to), covariance) in combined_covariances(graph) {
            let motion = poses[from].between(&poses[to]);
            neighbours[from].push((to, rotated(&covariance, poses[from].theta)));
            neighbours[to].push((from, rotated(&inverse_covariance(&motion, &covariance), poses[to].theta)));
        }
        Self { poses, neighbours }
    }

    /// Covariance of every keyframe's pose relative to `source`, along the axes of the map, by the best path to it. `None` if there is
    /// no path, or none with a window of at most `limit` metres.
    fn from(&self, source: usize, limit: f64) -> Vec<Option<PoseCovariance>> {
        // Trace of the covariance at the limit: both coordinates, and the heading at the lever arm.
        let angle = if limit <= SMALL_WINDOW { SMALL_WINDOW_ANGLE } else { MAX_WINDOW_ANGLE };
        let max_variance = (2.0 * limit.powi(2) + (LEVER_ARM * angle).powi(2)) / WINDOW_SIGMAS.powi(2);
        let mut known: Vec<Option<PoseCovariance>> = vec![None; self.neighbours.len()];
        let mut min_variance = vec![f64::INFINITY; self.neighbours.len()];
        let mut queue = BinaryHeap::from([QueueEntry { variance: 0.0, keyframe: source }]);
        (known[source], min_variance[source]) = (Some(PoseCovariance::zeros()), 0.0);
        while let Some(QueueEntry { keyframe, variance }) = queue.pop() {
            if variance > max_variance {
                break;
            }
            let Some(here) = known[keyframe].filter(|_| variance <= min_variance[keyframe]) else { continue };
            for (next, step) in &self.neighbours[keyframe] {
                let there = propagated(&here, self.poses[*next].translation() - self.poses[keyframe].translation()) + step;
                let variance = there.m11 + there.m22 + LEVER_ARM * LEVER_ARM * there.m33;
                if variance < min_variance[*next] {
                    (min_variance[*next], known[*next]) = (variance, Some(there));
                    queue.push(QueueEntry { variance, keyframe: *next });
                }
            }
        }
        known
    }
}

/// By pair of keyframes: covariance of the motion between them, from all edges of the pair together, each with its robust weight. In a
/// corridor, for example, a match constrains the heading, and odometry the distance.
fn combined_covariances(graph: &PoseGraph) -> BTreeMap<(usize, usize), PoseCovariance> {
    let mut known: BTreeMap<(usize, usize), PoseCovariance> = BTreeMap::new();
    for (number, edge) in graph.edges().iter().enumerate() {
        *known.entry((edge.from, edge.to)).or_default() += graph.weight(number) * graph.information(number);
    }
    known.into_iter().filter_map(|(pair, information)| Some((pair, information.try_inverse()?))).collect()
}

/// Covariance of the inverse motion, along the axes at the end of `motion`.
fn inverse_covariance(motion: &Pose2, covariance: &PoseCovariance) -> PoseCovariance {
    // The inverse motion leads from the end of `motion` back to its start, which has no error.
    let [by_end, _] = jacobians(motion, &Pose2::IDENTITY);
    by_end * covariance * by_end.transpose()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::odometry::uncertainty::{compound, diagonal};

    fn is_near(a: &PoseCovariance, b: &PoseCovariance) -> bool {
        (a - b).amax() < 1e-9
    }

    #[test]
    fn covariances_propagate_along_edges_as_through_poses() {
        let (a, b) = (Pose2::new(3.0, -2.0, 0.7), Pose2::new(1.5, 0.4, -0.3));
        let (of_a, of_b) =
            (rotated(&diagonal(0.1, 0.05), 0.3), PoseCovariance::new(0.04, 0.01, 0.0, 0.01, 0.02, 0.001, 0.0, 0.001, 0.003));
        let expected = compound(&a, &of_a, &b, &of_b);
        let step = (a * b).translation() - a.translation();
        assert!(is_near(&(propagated(&of_a, step) + rotated(&of_b, a.theta)), &expected));
        assert!(is_near(&inverse_covariance(&b.inverse(), &inverse_covariance(&b, &of_b)), &of_b), "inverted twice");
    }

    #[test]
    fn a_loop_closure_shrinks_the_windows() {
        let mut graph = PoseGraph::default();
        let covariance = diagonal(0.02, 0.01);
        for i in 0..100 {
            graph.add_pose(Pose2::new(f64::from(i), 0.0, 0.0));
        }
        let mut edge = |from: usize, to: usize| {
            let motion = Pose2::new(to as f64 - from as f64, 0.0, 0.0);
            graph.add_edge(Edge { from, to, motion, covariance, kind: EdgeKind::Sequence });
        };
        (1..100).for_each(|to| edge(to - 1, to));
        let free = Window::of(&RelativeUncertainty::new(&graph).from(99, 1e3)[0].unwrap());
        let motion = Pose2::new(99.0, 0.0, 0.0);
        graph.add_edge(Edge { from: 0, to: 99, motion, covariance, kind: EdgeKind::Loop });
        let closed = Window::of(&RelativeUncertainty::new(&graph).from(99, 1e3)[0].unwrap());
        assert!(free.distance > 10.0 && free.angle > 0.25 && !free.is_small(), "{free:?}");
        assert!(closed.distance < 3.0 && closed.angle < 0.04, "{closed:?}");
        graph.add_pose(Pose2::IDENTITY);
        assert!(RelativeUncertainty::new(&graph).from(99, 1e3)[100].is_none(), "no path leads there");
        assert!(RelativeUncertainty::new(&graph).from(50, 0.3)[0].is_none(), "the path exceeds the limit");
    }
}
