//! Places of earlier along the path: where to look for them, and which of what is found to believe.
//!
//! Where two keyframes are relative to each other is known as well as the best way between them along the graph's edges (E. Olson, "Robust and efficient robotic
//! mapping", 2008: Dijkstra's algorithm over covariances). That is the window to look in. Small windows come first: what is found there is
//! sure, and makes others smaller. In a window that other places fit into, one match proves nothing: there several keyframes in a row have
//! to agree on the same correction, and no other place in the window may fit as well. In two corridors that look alike the right one is
//! found once the window is less than what they are apart, and before that none.

use std::collections::{BTreeMap, BinaryHeap};

use super::edges::{EdgeMatcher, Match};
use super::keyframe::Keyframe;
use super::pose_graph::{Edge, EdgeKind, PoseGraph};
use crate::geometry::{Pose2, PoseCovariance};
use crate::matching::SearchWindow;
use crate::odometry::uncertainty::compound;

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
/// An edge left with less of its weight is a mistake: no way leads over it.
const LEAST_WEIGHT: f64 = 0.25;

/// Looks for places of earlier; remembers what it has tried.
#[derive(Clone, Debug, Default)]
pub(super) struct LoopSearch {
    /// By pair of keyframes: the guess of the last try.
    tried: BTreeMap<(usize, usize), Pose2>,
    /// Loop edges by their later keyframe.
    begun: BTreeMap<usize, Vec<usize>>,
}

/// What is known of the place of one keyframe seen from another.
#[derive(Clone, Copy, Debug)]
struct Window {
    distance: f64,
    angle: f64,
}

impl Window {
    fn of(covariance: &PoseCovariance) -> Self {
        let distance = SIGMAS * covariance.fixed_view::<2, 2>(0, 0).symmetric_eigenvalues().max().max(0.0).sqrt();
        Self { distance, angle: SIGMAS * covariance.m33.max(0.0).sqrt() }
    }

    fn is_small(self) -> bool {
        self.distance <= SMALL && self.angle <= SMALL_TURN
    }
}

impl LoopSearch {
    /// Edges to places of earlier, found in windows of `limit` metres at most.
    pub(super) fn find(&mut self, keyframes: &[Keyframe], graph: &PoseGraph, matcher: &mut EdgeMatcher, limit: f64) -> Vec<Edge> {
        let ways = Ways::new(graph);
        let mut found = Vec::new();
        let mut start = 0;
        while start < keyframes.len() {
            let is_of_stretch = |k: &Keyframe| k.run == keyframes[start].run && k.way - keyframes[start].way < STRETCH;
            let end = start + keyframes[start..].iter().take_while(|k| is_of_stretch(k)).count();
            let mut stretch = Stretch { keyframes, graph, matcher: &mut *matcher, known: ways.from((start + end) / 2), limit };
            if limit <= SMALL {
                (start..end).for_each(|later| self.track(&mut stretch, later, &mut found));
            } else {
                self.seek(&mut stretch, start..end, &mut found);
            }
            start = end;
        }
        found
    }

    /// Matches a keyframe to the nearest ones of other visits, where these can only be where they seem to be.
    fn track(&mut self, stretch: &mut Stretch, later: usize, found: &mut Vec<Edge>) {
        let mut near: Vec<(f64, usize)> = (0..later.saturating_sub(APART))
            .filter(|&earlier| stretch.window(earlier).is_some_and(Window::is_small))
            .map(|earlier| (stretch.difference(earlier, later), earlier))
            .filter(|(difference, _)| *difference < REACH)
            .collect();
        near.sort_by(|a, b| a.0.total_cmp(&b.0));
        for (_, earlier) in near.into_iter().take(EDGES) {
            if self.begun.get(&later).is_some_and(|begun| begun.len() >= EDGES || begun.contains(&earlier)) {
                continue;
            }
            let guess = stretch.guess(earlier, later);
            if !self.is_news(earlier, later, &guess) {
                continue;
            }
            let window = SearchWindow::default();
            if let Some(made) = stretch.compare(earlier, later, guess, window).filter(|made| made.agreement >= AGREEING)
                && guess.between(&made.motion).distance() <= 2.0 * SMALL
            {
                self.add(earlier, later, &made, found);
            }
        }
    }

    /// Looks for the keyframes of a stretch in all visits that may have come by.
    fn seek(&mut self, stretch: &mut Stretch, later: std::ops::Range<usize>, found: &mut Vec<Edge>) {
        if later.clone().any(|k| self.begun.contains_key(&k)) {
            return;
        }
        let visits = stretch.visits(&later);
        let mut places: Vec<Place> = Vec::new();
        for visit in visits {
            if let Some(place) = self.place(stretch, &later, &visit) {
                places.push(place);
            }
        }
        places.sort_by(|a, b| b.agreement.total_cmp(&a.agreement));
        let Some(best) = places.first() else { return };
        let middle = stretch.graph.poses()[(later.start + later.end) / 2];
        let is_rival = |other: &Place| {
            other.agreement > best.agreement - RIVAL && !agree(&(other.correction * middle), &(best.correction * middle))
        };
        if best.is_sure && !places[1..].iter().any(is_rival) {
            for &(earlier, later, made) in &best.matches {
                self.add(earlier, later, &made, found);
            }
        }
    }

    /// Where a stretch belongs by one visit: the correction that most of its keyframes in a row agree on.
    fn place(&mut self, stretch: &mut Stretch, later: &std::ops::Range<usize>, visit: &std::ops::Range<usize>) -> Option<Place> {
        let mut place: Option<Place> = None;
        for j in later.clone() {
            let nearest = visit.clone().filter(|&i| i + APART < j);
            let nearest = nearest.min_by(|&a, &b| stretch.difference(a, j).total_cmp(&stretch.difference(b, j)))?;
            let Some(Window { distance, angle }) = stretch.window(nearest) else { continue };
            let guess = stretch.guess(nearest, j);
            if !self.is_news(nearest, j, &guess) {
                return None;
            }
            let window = SearchWindow {
                distance: distance.clamp(SMALL, stretch.limit),
                angle: angle.clamp(SMALL_TURN, MOST_TURN),
                doubtful_agreement: f64::INFINITY,
            };
            let made = stretch.compare(nearest, j, guess, window)?;
            let poses = stretch.graph.poses();
            let correction = poses[nearest] * made.motion * poses[j].inverse();
            if made.agreement < AGREEING || made.condition_number > GREATEST_CONDITION {
                return place.filter(|place| place.matches.len() >= IN_A_ROW);
            }
            let place = place.get_or_insert_with(|| Place { correction, agreement: 1.0, matches: Vec::new(), is_sure: false });
            if !agree(&(place.correction * poses[j]), &(correction * poses[j])) {
                return None;
            }
            place.agreement = place.agreement.min(made.agreement);
            place.matches.push((nearest, j, made));
            place.is_sure = place.matches.len() >= IN_A_ROW && place.agreement >= SURE;
        }
        place
    }

    fn add(&mut self, from: usize, to: usize, made: &Match, found: &mut Vec<Edge>) {
        self.begun.entry(to).or_default().push(from);
        found.push(Edge { from, to, motion: made.motion, covariance: made.covariance, kind: EdgeKind::Loop });
    }

    /// Whether a pair has not been tried from about this guess; notes that it is.
    fn is_news(&mut self, earlier: usize, later: usize, guess: &Pose2) -> bool {
        let is_old = |tried: &Pose2| {
            let moved = tried.between(guess);
            moved.distance() < NEWS && moved.theta.abs() < NEWS
        };
        let is_news = !self.tried.get(&(earlier, later)).is_some_and(is_old);
        if is_news {
            self.tried.insert((earlier, later), *guess);
        }
        is_news
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
    is_sure: bool,
}

/// A stretch of the path, and what is known of all keyframes from it.
struct Stretch<'a> {
    keyframes: &'a [Keyframe],
    graph: &'a PoseGraph,
    matcher: &'a mut EdgeMatcher,
    known: Vec<Option<PoseCovariance>>,
    limit: f64,
}

impl Stretch<'_> {
    fn window(&self, earlier: usize) -> Option<Window> {
        self.known[earlier].as_ref().map(Window::of)
    }

    fn guess(&self, earlier: usize, later: usize) -> Pose2 {
        self.graph.poses()[earlier].between(&self.graph.poses()[later])
    }

    /// How different what is seen is: turns count as metres do.
    fn difference(&self, earlier: usize, later: usize) -> f64 {
        let motion = self.guess(earlier, later);
        motion.distance() + motion.theta.abs()
    }

    /// Keyframes that may be near the stretch, visit by visit, of which a window of more than the small one and up to the limit is known.
    fn visits(&self, later: &std::ops::Range<usize>) -> Vec<std::ops::Range<usize>> {
        let middle = (later.start + later.end) / 2;
        let mut visits: Vec<std::ops::Range<usize>> = Vec::new();
        for earlier in 0..later.start.saturating_sub(APART) {
            let Some(window) = self.window(earlier).filter(|window| !window.is_small()) else { continue };
            let far = self.guess(earlier, middle).distance() > REACH + window.distance.min(self.limit);
            if far || window.distance > self.limit {
                continue;
            }
            let way = self.keyframes[earlier].way;
            match visits.last_mut() {
                Some(visit) if way - self.keyframes[visit.end - 1].way < VISIT => visit.end = earlier + 1,
                _ => visits.push(earlier..earlier + 1),
            }
        }
        visits
    }

    fn compare(&mut self, earlier: usize, later: usize, guess: Pose2, window: SearchWindow) -> Option<Match> {
        let [earlier, later] = [earlier, later].map(|k| &self.keyframes[k].view);
        self.matcher.compare(earlier, later, guess, window).filter(|made| made.overlap >= OVERLAP)
    }
}

/// The graph's edges by the keyframes they are of, to find the best ways.
struct Ways<'a> {
    graph: &'a PoseGraph,
    edges: Vec<Vec<usize>>,
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
    fn new(graph: &'a PoseGraph) -> Self {
        let mut edges = vec![Vec::new(); graph.poses().len()];
        for (number, edge) in graph.edges().iter().enumerate() {
            if graph.weight(number) >= LEAST_WEIGHT {
                edges[edge.from].push(number);
                edges[edge.to].push(number);
            }
        }
        Self { graph, edges }
    }

    /// Covariance of every keyframe's place seen from one, by the best way to it; `None` where no way leads.
    fn from(&self, source: usize) -> Vec<Option<PoseCovariance>> {
        let mut known: Vec<Option<PoseCovariance>> = vec![None; self.edges.len()];
        let mut is_done = vec![false; self.edges.len()];
        let mut queue = BinaryHeap::from([Reached { variance: 0.0, keyframe: source }]);
        let mut best = vec![f64::INFINITY; self.edges.len()];
        known[source] = Some(PoseCovariance::zeros());
        let poses = self.graph.poses();
        while let Some(Reached { keyframe, .. }) = queue.pop() {
            if std::mem::replace(&mut is_done[keyframe], true) {
                continue;
            }
            let Some(here) = known[keyframe] else { continue };
            let place = poses[source].between(&poses[keyframe]);
            for &number in &self.edges[keyframe] {
                let edge = &self.graph.edges()[number];
                let (next, step, covariance) = if edge.from == keyframe {
                    (edge.to, edge.motion, edge.covariance)
                } else {
                    (edge.from, edge.motion.inverse(), reversed(&edge.motion, &edge.covariance))
                };
                if is_done[next] {
                    continue;
                }
                let there = compound(&place, &here, &step, &covariance);
                let variance = there.m11 + there.m22 + LEVER * LEVER * there.m33;
                if variance < best[next] {
                    best[next] = variance;
                    known[next] = Some(there);
                    queue.push(Reached { variance, keyframe: next });
                }
            }
        }
        known
    }
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
