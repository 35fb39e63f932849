//! Places of earlier along the path: where to look for them, and which of what is found to believe.
//!
//! Where two keyframes are relative to each other is known as well as the best way between them along the graph's edges (E. Olson, "Robust and efficient robotic
//! mapping", 2008: Dijkstra's algorithm over covariances). That is the window to look in. Small windows come first: what is found there is
//! sure, and makes others smaller. In a window that other places fit into, one match proves nothing: there several keyframes in a row have
//! to agree on the same correction, and no other place in the window may fit as well. In two corridors that look alike the right one is
//! found once the window is less than what they are apart, and before that none.

use std::collections::{BTreeMap, BinaryHeap};
use std::ops::Range;

use super::edges::{EdgeMatcher, Match};
use super::keyframe::Keyframe;
use super::pose_graph::{Edge, EdgeKind, PoseGraph};
use crate::geometry::{Pose2, PoseCovariance};
use crate::matching::{FirstGuess, SearchWindow};
use crate::odometry::uncertainty::{carried, turned};

/// Keyframes must be so many apart to be of two visits.
const APART: usize = 8;
/// Laser places farther apart than this, m, see too little of the same.
const REACH: f64 = 1.5;
/// Loop edges that a keyframe begins at most.
const EDGES: usize = 2;
/// The window is this many standard deviations.
const SIGMAS: f64 = 3.0;
/// In a window of this, m, ...
const SMALL: f64 = 0.3;
/// ... and this, rad, a match from its middle finds what is there, and nothing else fits.
const SMALL_TURN: f64 = 0.1;
/// Windows are looked through up to this to either side, m, each only when nothing more is found in those before ...
pub(super) const WINDOWS: [f64; 5] = [SMALL, 1.0, 2.5, 5.0, 10.0];
/// ... and up to this turn, rad.
const MOST_TURN: f64 = 0.35;
/// Least part of the rays that must agree in a small window, ...
const AGREEING: f64 = 0.6;
/// ... and in others.
const SURE: f64 = 0.75;
/// Least part of the rays that must see what the other keyframe has seen.
const OVERLAP: f64 = 0.4;
/// Of a match of a greater condition number it is not clear where along a wall it belongs.
const GREATEST_CONDITION: f64 = 50.0;
/// Keyframes in a row that must agree on a correction ...
const IN_A_ROW: usize = 3;
/// ... to within this, m, ...
const CONSISTENT: f64 = 0.15;
/// ... and rad.
const CONSISTENT_TURN: f64 = 0.02;
/// Another place whose part of agreeing rays is within this of the best one's is a rival.
const RIVAL: f64 = 0.1;
/// A keyframe is tried again when its guess has moved by this, m and rad.
const NEWS: f64 = 0.05;
/// Over this way the window is taken to be the same, m.
const STRETCH: f64 = 2.0;
/// Keyframes with a way of more than this between them are of two visits to a place, m.
const VISIT: f64 = 15.0;
/// Errors of the heading count by what they do at this distance, m.
const LEVER: f64 = 5.0;

/// Looks for places of earlier; remembers what it has tried.
#[derive(Clone, Debug, Default)]
pub(super) struct LoopSearch {
    /// By later and earlier keyframe: the guess of the last try, and what it has come to.
    tried: BTreeMap<(usize, usize), (Pose2, Option<Match>)>,
    /// The earlier keyframes of the loop edges, by the later ones.
    begun: BTreeMap<usize, Vec<usize>>,
}

/// What is known of the place of one keyframe seen from another.
#[derive(Clone, Copy, Debug)]
struct Window {
    /// m.
    distance: f64,
    /// rad.
    angle: f64,
}

impl Window {
    fn of(covariance: &PoseCovariance) -> Self {
        let (mean, half) = (0.5 * (covariance.m11 + covariance.m22), 0.5 * (covariance.m11 - covariance.m22));
        let variance = mean + half.hypot(covariance.m12);
        Self { distance: SIGMAS * variance.max(0.0).sqrt(), angle: SIGMAS * covariance.m33.max(0.0).sqrt() }
    }

    fn is_small(self) -> bool {
        self.distance <= SMALL && self.angle <= SMALL_TURN
    }
}

impl LoopSearch {
    /// Edges to places of earlier, found in windows of `limit` metres at most, for the stretches of the path that end after the keyframe
    /// `since`.
    pub(super) fn find(
        &mut self,
        keyframes: &[Keyframe],
        ways: &Ways,
        matcher: &mut EdgeMatcher,
        limit: f64,
        since: usize,
    ) -> Vec<Edge> {
        let mut found = Vec::new();
        let mut start = 0;
        while start < keyframes.len() {
            let is_of_stretch = |k: &Keyframe| k.run == keyframes[start].run && k.way - keyframes[start].way < STRETCH;
            let end = start + keyframes[start..].iter().take_while(|k| is_of_stretch(k)).count();
            let mut stretch = Stretch { keyframes, poses: ways.poses, later: start..end, near: Vec::new(), limit };
            if end <= since {
                start = end;
                continue;
            }
            if limit <= SMALL {
                stretch.find_near(ways);
                self.track(&stretch, matcher, &mut found);
            } else if !(start..end).any(|k| self.begun.contains_key(&k)) {
                stretch.find_near(ways);
                self.seek(&stretch, matcher, &mut found);
            }
            start = end;
        }
        found
    }

    /// Forgets what was tried for a keyframe that lets go of what it saw.
    pub(super) fn forget(&mut self, later: usize) {
        let tried: Vec<usize> = self.tried.range((later, 0)..(later + 1, 0)).map(|(&(_, earlier), _)| earlier).collect();
        for earlier in tried {
            self.tried.remove(&(later, earlier));
        }
    }

    /// Matches keyframes to the nearest ones of other visits, where these can only be where they seem to be.
    fn track(&mut self, stretch: &Stretch, matcher: &mut EdgeMatcher, found: &mut Vec<Edge>) {
        for later in stretch.later.clone() {
            let small = stretch.near.iter().filter(|(earlier, window)| window.is_small() && earlier + APART < later);
            let place = stretch.poses[later].translation();
            let mut near: Vec<(f64, usize)> = small
                .filter(|(earlier, _)| (stretch.poses[*earlier].translation() - place).norm_squared() < REACH * REACH)
                .map(|&(earlier, _)| (stretch.difference(earlier, later), earlier))
                .filter(|(difference, _)| *difference < REACH)
                .collect();
            near.sort_by(|a, b| a.0.total_cmp(&b.0));
            for (_, earlier) in near.into_iter().take(EDGES) {
                if self.begun.get(&later).is_some_and(|begun| begun.len() >= EDGES || begun.contains(&earlier)) {
                    continue;
                }
                let guess = stretch.guess(earlier, later);
                let made = self.compare(stretch, matcher, (earlier, later), guess, SearchWindow::default());
                let is_there = |made: &Match| guess.between(&made.motion).distance() <= 2.0 * SMALL;
                if let Some(made) = made.filter(|made| made.agreement >= AGREEING && is_there(made)) {
                    self.add(earlier, later, &made, found);
                }
            }
        }
    }

    /// Looks for the keyframes of a stretch, none of which has been recognised, in all visits that may have come by.
    fn seek(&mut self, stretch: &Stretch, matcher: &mut EdgeMatcher, found: &mut Vec<Edge>) {
        let mut places: Vec<Place> = stretch.visits().iter().filter_map(|visit| self.place(stretch, matcher, visit)).collect();
        places.sort_by(|a, b| b.agreement.total_cmp(&a.agreement));
        let Some(best) = places.first() else { return };
        let middle = stretch.poses[stretch.middle()];
        let is_rival = |other: &Place| {
            other.agreement > best.agreement - RIVAL && !agree(&(other.correction * middle), &(best.correction * middle))
        };
        if best.is_sure() && !places[1..].iter().any(is_rival) {
            for &(earlier, later, made) in &best.matches {
                self.add(earlier, later, &made, found);
            }
        }
    }

    /// Where a stretch belongs by one visit: the correction that its keyframes agree on; `None` where they do not.
    fn place(&mut self, stretch: &Stretch, matcher: &mut EdgeMatcher, visit: &[(usize, Window)]) -> Option<Place> {
        let mut place: Option<Place> = None;
        for later in stretch.later.clone() {
            let before = visit.iter().filter(|(earlier, _)| earlier + APART < later);
            let difference = |earlier: usize| stretch.difference(earlier, later);
            let &(earlier, Window { distance, angle }) = before.min_by(|a, b| difference(a.0).total_cmp(&difference(b.0)))?;
            let window = SearchWindow {
                distance: distance.max(SMALL),
                angle: angle.clamp(SMALL_TURN, MOST_TURN),
                doubtful_agreement: f64::INFINITY,
            };
            let place_so_far = place.as_ref().filter(|_| later + 1 < stretch.later.end);
            let (guess, window) = match place_so_far {
                // The first and the last look everywhere; those between need only confirm.
                Some(place) => {
                    let placed = place.correction * stretch.poses[later];
                    (stretch.poses[earlier].between(&placed), SearchWindow::default())
                }
                None => (stretch.guess(earlier, later), window),
            };
            let made = self.compare(stretch, matcher, (earlier, later), guess, window)?;
            if made.agreement < AGREEING || made.condition_number > GREATEST_CONDITION {
                break;
            }
            let correction = stretch.poses[earlier] * made.motion * stretch.poses[later].inverse();
            let place = place.get_or_insert_with(|| Place { correction, agreement: 1.0, matches: Vec::new() });
            if !agree(&(place.correction * stretch.poses[later]), &(correction * stretch.poses[later])) {
                return None;
            }
            place.agreement = place.agreement.min(made.agreement);
            place.matches.push((earlier, later, made));
        }
        place.filter(|place| place.matches.len() >= IN_A_ROW)
    }

    fn add(&mut self, from: usize, to: usize, made: &Match, found: &mut Vec<Edge>) {
        self.begun.entry(to).or_default().push(from);
        found.push(Edge { from, to, motion: made.motion, covariance: made.covariance, kind: EdgeKind::Loop });
    }

    /// What a match of two keyframes says that see the same; it is made anew only where the guess is another one than before.
    fn compare(
        &mut self,
        stretch: &Stretch,
        matcher: &mut EdgeMatcher,
        (earlier, later): (usize, usize),
        guess: Pose2,
        window: SearchWindow,
    ) -> Option<Match> {
        if let Some((tried, made)) = self.tried.get(&(later, earlier)) {
            let moved = tried.between(&guess);
            if moved.distance() < NEWS && moved.theta.abs() < NEWS {
                return *made;
            }
        }
        let [of_earlier, of_later] = [earlier, later].map(|k| stretch.keyframes[k].view.as_ref());
        let made = matcher.compare(of_earlier?, of_later?, FirstGuess { window, ..guess.into() });
        let made = made.filter(|made| made.overlap >= OVERLAP);
        self.tried.insert((later, earlier), (guess, made));
        made
    }
}

/// Whether two corrections take a keyframe to the same place.
fn agree(a: &Pose2, b: &Pose2) -> bool {
    let apart = a.between(b);
    apart.distance() < CONSISTENT && apart.theta.abs() < CONSISTENT_TURN
}

/// Where a stretch may belong.
struct Place {
    /// Takes its keyframes there.
    correction: Pose2,
    /// Least part of the rays that agree.
    agreement: f64,
    /// Earlier and later keyframe, and what their match says.
    matches: Vec<(usize, usize, Match)>,
}

impl Place {
    fn is_sure(&self) -> bool {
        self.agreement >= SURE
    }
}

/// A stretch of the path.
struct Stretch<'a> {
    keyframes: &'a [Keyframe],
    poses: &'a [Pose2],
    /// Its keyframes.
    later: Range<usize>,
    /// Earlier keyframes of other visits that may be near, and how well that is known.
    near: Vec<(usize, Window)>,
    /// Greatest window, m.
    limit: f64,
}

impl Stretch<'_> {
    fn middle(&self) -> usize {
        usize::midpoint(self.later.start, self.later.end)
    }

    fn guess(&self, earlier: usize, later: usize) -> Pose2 {
        self.poses[earlier].between(&self.poses[later])
    }

    /// How different what is seen is: turns count as metres do.
    fn difference(&self, earlier: usize, later: usize) -> f64 {
        let motion = self.guess(earlier, later);
        motion.distance() + motion.theta.abs()
    }

    /// Finds the keyframes that may be near: first those that are within the limit, then of these the ones whose windows reach here.
    fn find_near(&mut self, ways: &Ways) {
        let place = self.poses[self.middle()].translation();
        let away = |earlier: usize| (self.poses[earlier].translation() - place).norm() - REACH - STRETCH;
        let is_candidate = |&earlier: &usize| self.keyframes[earlier].view.is_some() && away(earlier) < self.limit;
        let reached: Vec<usize> = (0..self.later.end.saturating_sub(APART)).filter(is_candidate).collect();
        if reached.is_empty() {
            return;
        }
        let known = ways.from(self.middle(), self.limit);
        let window = |earlier: usize| Some((earlier, Window::of(known[earlier].as_ref()?)));
        let near = reached.into_iter().filter_map(window);
        self.near = near.filter(|&(earlier, w)| w.distance <= self.limit && away(earlier) < w.distance).collect();
    }

    /// The near keyframes whose windows are not small, visit by visit.
    fn visits(&self) -> Vec<&[(usize, Window)]> {
        let way = |near: &(usize, Window)| self.keyframes[near.0].way;
        let visits = self.near.chunk_by(|a, b| way(b) - way(a) < VISIT);
        visits.filter(|visit| visit.iter().any(|(_, window)| !window.is_small())).collect()
    }
}

/// The graph's edges by the keyframes they are of, to find the best ways.
pub(super) struct Ways<'a> {
    poses: &'a [Pose2],
    /// By keyframe: the next one, and the covariance of the motion there, along the axes of the map.
    steps: Vec<Vec<(usize, PoseCovariance)>>,
}

/// A keyframe to go on from: the one known best first.
#[derive(PartialEq)]
struct Reached {
    variance: f64,
    keyframe: usize,
}

impl Eq for Reached {}

impl Ord for Reached {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        other.variance.total_cmp(&self.variance).then(other.keyframe.cmp(&self.keyframe))
    }
}

impl PartialOrd for Reached {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl<'a> Ways<'a> {
    pub(super) fn new(graph: &'a PoseGraph) -> Self {
        let poses = graph.poses();
        let mut steps = vec![Vec::new(); poses.len()];
        for ((from, to), covariance) in joint(graph) {
            let motion = poses[from].between(&poses[to]);
            steps[from].push((to, turned(&covariance, poses[from].theta)));
            steps[to].push((from, turned(&reversed(&motion, &covariance), poses[to].theta)));
        }
        Self { poses, steps }
    }

    /// Covariance of every keyframe's place as seen from one, along the axes of the map, by the best way to it; `None` where none leads, or
    /// none with a window of `limit` metres at most.
    fn from(&self, source: usize, limit: f64) -> Vec<Option<PoseCovariance>> {
        // In both directions, and the heading.
        let turn = if limit <= SMALL { SMALL_TURN } else { MOST_TURN };
        let most = (2.0 * limit.powi(2) + (LEVER * turn).powi(2)) / SIGMAS.powi(2);
        let mut known: Vec<Option<PoseCovariance>> = vec![None; self.steps.len()];
        let mut least = vec![f64::INFINITY; self.steps.len()];
        let mut queue = BinaryHeap::from([Reached { variance: 0.0, keyframe: source }]);
        (known[source], least[source]) = (Some(PoseCovariance::zeros()), 0.0);
        while let Some(Reached { keyframe, variance }) = queue.pop() {
            if variance > most {
                break;
            }
            let Some(here) = known[keyframe].filter(|_| variance <= least[keyframe]) else { continue };
            for (next, step) in &self.steps[keyframe] {
                let there = carried(&here, self.poses[*next].translation() - self.poses[keyframe].translation()) + step;
                let variance = there.m11 + there.m22 + LEVER * LEVER * there.m33;
                if variance < least[*next] {
                    (least[*next], known[*next]) = (variance, Some(there));
                    queue.push(Reached { variance, keyframe: *next });
                }
            }
        }
        known
    }
}

/// By pairs of keyframes: the covariance of the motion between them by all edges that they have in common, each by its weight: what others
/// contradict says little. In a corridor a match knows the heading and odometry the way.
fn joint(graph: &PoseGraph) -> BTreeMap<(usize, usize), PoseCovariance> {
    let mut known: BTreeMap<(usize, usize), PoseCovariance> = BTreeMap::new();
    for (number, edge) in graph.edges().iter().enumerate() {
        *known.entry((edge.from, edge.to)).or_default() += graph.weight(number) * graph.information(number);
    }
    known.into_iter().filter_map(|(pair, information)| Some((pair, information.try_inverse()?))).collect()
}

/// Covariance of the way back, along the axes of the end of `motion`.
fn reversed(motion: &Pose2, covariance: &PoseCovariance) -> PoseCovariance {
    let (sin, cos) = motion.theta.sin_cos();
    let back = motion.inverse();
    #[rustfmt::skip]
    let by_motion = PoseCovariance::new(
        -cos, -sin, back.y,
        sin, -cos, -back.x,
        0.0, 0.0, -1.0,
    );
    by_motion * covariance * by_motion.transpose()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::odometry::uncertainty::{compound, diagonal};

    fn near(a: &PoseCovariance, b: &PoseCovariance) -> bool {
        (a - b).amax() < 1e-9
    }

    #[test]
    fn uncertainty_goes_along_ways_as_it_does_through_poses() {
        let (a, b) = (Pose2::new(3.0, -2.0, 0.7), Pose2::new(1.5, 0.4, -0.3));
        let (of_a, of_b) =
            (turned(&diagonal(0.1, 0.05), 0.3), PoseCovariance::new(0.04, 0.01, 0.0, 0.01, 0.02, 0.001, 0.0, 0.001, 0.003));
        let expected = compound(&a, &of_a, &b, &of_b);
        let way = (a * b).translation() - a.translation();
        assert!(near(&(carried(&of_a, way) + turned(&of_b, a.theta)), &expected));
        assert!(near(&reversed(&b.inverse(), &reversed(&b, &of_b)), &of_b), "there and back");
    }

    #[test]
    fn a_loop_makes_windows_small() {
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
        let free = Window::of(&Ways::new(&graph).from(99, 1e3)[0].unwrap());
        let motion = Pose2::new(99.0, 0.0, 0.0);
        graph.add_edge(Edge { from: 0, to: 99, motion, covariance, kind: EdgeKind::Loop });
        let closed = Window::of(&Ways::new(&graph).from(99, 1e3)[0].unwrap());
        assert!(free.distance > 10.0 && free.angle > 0.25 && !free.is_small(), "{free:?}");
        assert!(closed.distance < 3.0 && closed.angle < 0.04, "{closed:?}");
        graph.add_pose(Pose2::IDENTITY);
        assert!(Ways::new(&graph).from(99, 1e3)[100].is_none(), "no way leads there");
        assert!(Ways::new(&graph).from(50, 0.3)[0].is_none(), "no good one does");
    }
}
