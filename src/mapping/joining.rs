//! Localizes a run with an unknown start on the map: a bag of another day, or a kidnapped robot.
//!
//! A keyframe of the run is matched against keyframes all over the map, in all headings. If one fits, the following keyframes of the
//! run must fit, too, each at the pose that odometry predicts from there, over several metres; and no other place may fit as well.

use std::f64::consts::PI;
use std::ops::Range;

use super::edges::{EdgeMatcher, Match};
use super::keyframe::{Keyframe, Spacing};
use super::pose_graph::{Edge, EdgeKind};
use crate::geometry::Pose2;
use crate::matching::SearchWindow;

/// Spacing to which the map's keyframes are thinned out for the global search, m and rad.
const THINNED_SPACING: f64 = 1.0;
/// Path length between the keyframes of the run that are searched for, m.
const START_SPACING: f64 = 2.0;
/// Maximum number of keyframes of the run that are searched for.
const MAX_STARTS: usize = 12;
/// Maximum number of hypotheses per keyframe that are verified.
const MAX_HYPOTHESES: usize = 5;
/// Minimum fraction of rays that must agree in the global search.
const MIN_GLOBAL_AGREEMENT: f64 = 0.75;
/// Minimum fraction of rays that must agree in each verification match.
const MIN_AGREEMENT: f64 = 0.65;
/// Path length over which a hypothesis is verified, m.
const VERIFIED_LENGTH: f64 = 5.0;
/// Minimum number of keyframes that must verify a hypothesis.
pub(super) const MIN_KEYFRAMES: usize = 6;
/// Maximum distance of a match from the pose predicted by odometry, m.
const MAX_DEVIATION: f64 = 0.4;
/// Maximum rotation of a match from the pose predicted by odometry, rad.
const MAX_ROTATION_DEVIATION: f64 = 0.1;
/// Hypotheses nearer to each other than this count as one, m.
const DUPLICATE_DISTANCE: f64 = 1.0;
/// A competing hypothesis whose fraction of agreeing rays is within this margin of the best one's makes the result ambiguous.
const AMBIGUITY_MARGIN: f64 = 0.08;

/// Alignment of a run with the map.
pub(super) struct RunAlignment {
    /// Transforms the run's current poses to the map.
    pub(super) correction: Pose2,
    /// Loop edges that connect the run to the map.
    pub(super) edges: Vec<Edge>,
    agreement: f64,
}

/// Aligns a run with the map by matching it against the keyframes in `known`, which are on the map and still have their scans. `None`
/// if the run fits nowhere, or in several places.
pub(super) fn find(
    keyframes: &[Keyframe],
    poses: &[Pose2],
    known: &[usize],
    run: Range<usize>,
    matcher: &mut EdgeMatcher,
) -> Option<RunAlignment> {
    let mut search = AlignmentSearch { keyframes, poses, known, thinned: thinned(poses, known), run: run.clone(), matcher };
    let (mut tried, mut next) = (0, f64::NEG_INFINITY);
    for start in run {
        if keyframes[start].path_length < next {
            continue;
        }
        next = keyframes[start].path_length + START_SPACING;
        if let Some(alignment) = search.from(start) {
            return Some(alignment);
        }
        tried += 1;
        if tried >= MAX_STARTS {
            break;
        }
    }
    None
}

/// Thins out keyframes to those that differ by [`THINNED_SPACING`] from all kept before.
fn thinned(poses: &[Pose2], known: &[usize]) -> Vec<usize> {
    let spacing = Spacing { distance: THINNED_SPACING, angle: THINNED_SPACING };
    let mut kept: Vec<usize> = Vec::new();
    for &k in known {
        if kept.iter().all(|&other| spacing.is_exceeded_by(&poses[other].between(&poses[k]))) {
            kept.push(k);
        }
    }
    kept
}

struct AlignmentSearch<'a> {
    keyframes: &'a [Keyframe],
    poses: &'a [Pose2],
    known: &'a [usize],
    thinned: Vec<usize>,
    run: Range<usize>,
    matcher: &'a mut EdgeMatcher,
}

impl AlignmentSearch<'_> {
    /// Aligns the run, starting from keyframe `start`.
    fn from(&mut self, start: usize) -> Option<RunAlignment> {
        let window = SearchWindow { distance: THINNED_SPACING, angle: PI, min_agreement: f64::INFINITY };
        let mut hypotheses: Vec<(f64, Pose2)> = Vec::new();
        for i in 0..self.thinned.len() {
            let earlier = self.thinned[i];
            if let Some(matched) =
                self.compare(earlier, start, Pose2::IDENTITY, window).filter(|matched| matched.agreement >= MIN_GLOBAL_AGREEMENT)
            {
                hypotheses.push((matched.agreement, self.poses[earlier] * matched.motion));
            }
        }
        hypotheses.sort_by(|a, b| b.0.total_cmp(&a.0));
        let mut distinct: Vec<Pose2> = Vec::new();
        for (_, pose) in hypotheses {
            if distinct.len() < MAX_HYPOTHESES
                && distinct.iter().all(|other| other.between(&pose).distance() > DUPLICATE_DISTANCE)
            {
                distinct.push(pose);
            }
        }
        let mut alignments: Vec<RunAlignment> = distinct.iter().filter_map(|pose| self.verify(start, pose)).collect();
        alignments.sort_by(|a, b| b.agreement.total_cmp(&a.agreement));
        let is_ambiguous = alignments.get(1).is_some_and(|other| other.agreement > alignments[0].agreement - AMBIGUITY_MARGIN);
        alignments.into_iter().next().filter(|_| !is_ambiguous)
    }

    /// Verifies a hypothesis for the pose of keyframe `start`: the following keyframes must match where odometry predicts them.
    fn verify(&mut self, start: usize, hypothesis: &Pose2) -> Option<RunAlignment> {
        let mut correction = *hypothesis * self.poses[start].inverse();
        let end = self.keyframes[start].path_length + VERIFIED_LENGTH;
        let mut alignment = RunAlignment { correction, edges: Vec::new(), agreement: 0.0 };
        for later in (start..self.run.end).take_while(|&k| self.keyframes[k].path_length <= end) {
            let predicted = correction * self.poses[later];
            let difference = |k: &usize| self.poses[*k].between(&predicted).magnitude();
            let earlier = *self.known.iter().min_by(|a, b| difference(a).total_cmp(&difference(b)))?;
            let guess = self.poses[earlier].between(&predicted);
            let matched = self.compare(earlier, later, guess, SearchWindow::default())?;
            if matched.agreement < MIN_AGREEMENT || !guess.is_near(&matched.motion, MAX_DEVIATION, MAX_ROTATION_DEVIATION) {
                return None;
            }
            correction = self.poses[earlier] * matched.motion * self.poses[later].inverse();
            alignment.agreement += matched.agreement;
            let (motion, covariance) = (matched.motion, matched.covariance);
            alignment.edges.push(Edge { from: earlier, to: later, motion, covariance, kind: EdgeKind::Loop });
        }
        alignment.agreement /= alignment.edges.len().max(1) as f64;
        (alignment.edges.len() >= MIN_KEYFRAMES).then_some(alignment)
    }

    fn compare(&mut self, earlier: usize, later: usize, guess: Pose2, window: SearchWindow) -> Option<Match> {
        let [earlier, later] = [earlier, later].map(|k| self.keyframes[k].view.as_ref());
        self.matcher.compare_visits(earlier?, later?, guess, window)
    }
}
