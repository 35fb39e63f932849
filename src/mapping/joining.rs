//! Where on the map a run has begun of which nobody knows: a bag of another day, a robot that was carried off.
//!
//! A keyframe of the run is matched to keyframes all over the map, whichever way it may look. Where one fits, those that follow it on the
//! run must fit, too, each where odometry leads from there: over several metres, and nowhere else as well.

use std::f64::consts::PI;
use std::ops::Range;

use super::edges::{EdgeMatcher, Match};
use super::keyframe::Keyframe;
use super::pose_graph::{Edge, EdgeKind};
use crate::geometry::Pose2;
use crate::matching::{FirstGuess, SearchWindow};

/// Keyframes to compare with are thinned out to one in so many metres, and radians.
const THINNED: f64 = 1.0;
/// Starts along the run are so far apart, m.
const STARTS: f64 = 2.0;
/// So many are tried.
const MOST_STARTS: usize = 12;
/// Places that are followed from each.
const FOLLOWED: usize = 5;
/// Least part of the rays that must agree at the start ...
const SURE: f64 = 0.75;
/// ... and on the way.
const AGREEING: f64 = 0.65;
/// Least part of the rays that must see what the other keyframe has seen.
const OVERLAP: f64 = 0.4;
/// Way along which keyframes must fit, m ...
const FOLLOW: f64 = 5.0;
/// ... and how many of them.
pub(super) const FEWEST: usize = 6;
/// How far odometry may lead astray on that way, m ...
const ASTRAY: f64 = 0.4;
/// ... and rad.
const ASTRAY_TURN: f64 = 0.1;
/// Two places nearer than this are one, m.
const SAME: f64 = 1.0;
/// Another place whose part of agreeing rays is within this is a rival.
const RIVAL: f64 = 0.08;

/// Where a run belongs.
pub(super) struct Junction {
    /// Takes its poses to the map.
    pub(super) correction: Pose2,
    /// What holds it there.
    pub(super) edges: Vec<Edge>,
    agreement: f64,
}

/// Finds where on a map a run belongs, by the keyframes of the map that are `known` and still have their views; `None` where it fits nowhere,
/// or in several places.
pub(super) fn find(
    keyframes: &[Keyframe],
    poses: &[Pose2],
    known: &[usize],
    run: Range<usize>,
    matcher: &mut EdgeMatcher,
) -> Option<Junction> {
    let mut search = JunctionSearch { keyframes, poses, known, thinned: thinned(poses, known), run: run.clone(), matcher };
    let (mut tried, mut next) = (0, f64::NEG_INFINITY);
    for start in run {
        if keyframes[start].way < next {
            continue;
        }
        next = keyframes[start].way + STARTS;
        if let Some(junction) = search.from(start) {
            return Some(junction);
        }
        tried += 1;
        if tried >= MOST_STARTS {
            break;
        }
    }
    None
}

/// Keyframes that see something else than those before.
fn thinned(poses: &[Pose2], known: &[usize]) -> Vec<usize> {
    let mut kept: Vec<usize> = Vec::new();
    for &k in known {
        let is_new = |other: &usize| {
            let motion = poses[*other].between(&poses[k]);
            motion.distance() > THINNED || motion.theta.abs() > THINNED
        };
        if kept.iter().all(is_new) {
            kept.push(k);
        }
    }
    kept
}

struct JunctionSearch<'a> {
    keyframes: &'a [Keyframe],
    poses: &'a [Pose2],
    known: &'a [usize],
    thinned: Vec<usize>,
    run: Range<usize>,
    matcher: &'a mut EdgeMatcher,
}

impl JunctionSearch<'_> {
    /// Where the run belongs by the keyframes from `start` on.
    fn from(&mut self, start: usize) -> Option<Junction> {
        let window = SearchWindow { distance: THINNED, angle: PI, doubtful_agreement: f64::INFINITY };
        let mut places: Vec<(f64, Pose2)> = Vec::new();
        for i in 0..self.thinned.len() {
            let earlier = self.thinned[i];
            if let Some(made) = self.compare(earlier, start, Pose2::IDENTITY, window).filter(|made| made.agreement >= SURE) {
                places.push((made.agreement, self.poses[earlier] * made.motion));
            }
        }
        places.sort_by(|a, b| b.0.total_cmp(&a.0));
        let mut distinct: Vec<Pose2> = Vec::new();
        for (_, place) in places {
            if distinct.len() < FOLLOWED && distinct.iter().all(|other| other.between(&place).distance() > SAME) {
                distinct.push(place);
            }
        }
        let mut junctions: Vec<Junction> = distinct.iter().filter_map(|place| self.follow(start, place)).collect();
        junctions.sort_by(|a, b| b.agreement.total_cmp(&a.agreement));
        let rival = junctions.get(1).is_some_and(|other| other.agreement > junctions[0].agreement - RIVAL);
        junctions.into_iter().next().filter(|_| !rival)
    }

    /// Whether the keyframes that follow fit, too, where odometry leads from a place of the first one.
    fn follow(&mut self, start: usize, place: &Pose2) -> Option<Junction> {
        let mut correction = *place * self.poses[start].inverse();
        let end = self.keyframes[start].way + FOLLOW;
        let mut junction = Junction { correction, edges: Vec::new(), agreement: 0.0 };
        for later in (start..self.run.end).take_while(|&k| self.keyframes[k].way <= end) {
            let place = correction * self.poses[later];
            let difference = |k: &usize| {
                let motion = self.poses[*k].between(&place);
                motion.distance() + motion.theta.abs()
            };
            let earlier = *self.known.iter().min_by(|a, b| difference(a).total_cmp(&difference(b)))?;
            let guess = self.poses[earlier].between(&place);
            let made = self.compare(earlier, later, guess, SearchWindow::default())?;
            let astray = guess.between(&made.motion);
            if made.agreement < AGREEING || astray.distance() > ASTRAY || astray.theta.abs() > ASTRAY_TURN {
                return None;
            }
            correction = self.poses[earlier] * made.motion * self.poses[later].inverse();
            junction.agreement += made.agreement;
            let (motion, covariance) = (made.motion, made.covariance);
            junction.edges.push(Edge { from: earlier, to: later, motion, covariance, kind: EdgeKind::Loop });
        }
        junction.agreement /= junction.edges.len().max(1) as f64;
        (junction.edges.len() >= FEWEST).then_some(junction)
    }

    fn compare(&mut self, earlier: usize, later: usize, guess: Pose2, window: SearchWindow) -> Option<Match> {
        let [earlier, later] = [earlier, later].map(|k| self.keyframes[k].view.as_ref());
        self.matcher.compare(earlier?, later?, FirstGuess { window, ..guess.into() }).filter(|made| made.overlap >= OVERLAP)
    }
}
