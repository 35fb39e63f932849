//! Other starts than the first guess, for when the scans do not agree at what it led to.
//!
//! All starts of the window are scored with few rays; the best few, none beside another, are refined. The one that most rays agree with is
//! refined with all of them, and believed when clearly more agree than before.

use super::pairing::{Agreement, Pairing};
use super::{FirstGuess, SearchWindow, StopReason};
use crate::geometry::Pose2;

/// Distance between starts, m ...
const STEP: f64 = 0.15;
/// ... and angle, rad.
const TURN_STEP: f64 = 0.0873;
/// Starts that are scored in one go.
const SCORED_AT_ONCE: usize = 64;
/// Starts nearer to one another than so many steps lead to the same pose.
const BESIDE: f64 = 1.1;
/// Starts that are refined.
const REFINED: usize = 8;
/// Part of the rays that must agree more than before with a start, so that it is refined with all, ...
const PROMISING: f64 = 0.03;
/// ... and then, so that it is believed: for each standard deviation that it is away from the prior, once at least, ...
const BELIEVED: f64 = 0.05;
/// ... and so many times at most.
const INCREDIBLE: f64 = 3.0;

/// Where tracking from the first guess had come to.
#[derive(Clone, Copy, Debug)]
pub(super) struct Tracked {
    pub(super) pose: Pose2,
    /// Of the kernel.
    pub(super) width: f64,
    pub(super) agreement: Agreement,
    pub(super) outcome: StopReason,
}

/// A search under way; keeps the memory that takes.
#[derive(Debug, Default)]
pub(super) struct Search {
    starts: Vec<Pose2>,
    scores: Vec<(u32, usize)>,
    is_scored: bool,
    /// Those to be refined.
    promising: Vec<Pose2>,
    best: Option<(Pose2, Agreement)>,
}

impl Search {
    pub(super) fn begin(&mut self, guess: &FirstGuess) {
        self.best = None;
        self.is_scored = false;
        self.scores.clear();
        self.starts.clear();
        let SearchWindow { distance, angle, .. } = guess.window;
        for turn in offsets(angle, TURN_STEP) {
            for forward in offsets(distance, STEP) {
                self.starts.extend(offsets(distance, STEP).map(|left| guess.pose * Pose2::new(forward, left, turn)));
            }
        }
    }

    /// Scores some more starts; in the end, leaves those that promise most. Answers whether there was anything to do.
    pub(super) fn score_some(&mut self, pairing: &dyn Pairing) -> bool {
        if self.is_scored {
            return false;
        }
        let done = self.scores.len();
        let next = self.starts[done..].iter().take(SCORED_AT_ONCE).enumerate();
        self.scores.extend(next.map(|(i, start)| (pairing.score(start), done + i)));
        if self.scores.len() == self.starts.len() {
            self.is_scored = true;
            self.keep_best();
        }
        true
    }

    /// Of starts beside one another only the best one promises anything.
    fn keep_best(&mut self) {
        self.scores.sort_unstable_by(|a, b| b.cmp(a));
        self.promising.clear();
        for &(_, i) in &self.scores {
            let start = self.starts[i];
            if !self.promising.iter().any(|better| is_beside(better, &start)) {
                self.promising.push(start);
            }
            if self.promising.len() == REFINED {
                break;
            }
        }
    }

    /// The next start to be refined.
    pub(super) fn next_start(&mut self) -> Option<Pose2> {
        self.promising.pop()
    }

    /// What the refinement of a start has come to.
    pub(super) fn consider(&mut self, pose: Pose2, agreement: Agreement) {
        if self.best.is_none_or(|(_, best)| agreement.agreeing > best.agreeing) {
            self.best = Some((pose, agreement));
        }
    }

    /// The pose found, if more of so many rays agree with it than did `before`.
    pub(super) fn found(&self, before: Agreement, rays: usize) -> Option<Pose2> {
        self.best.filter(|(_, agreement)| exceeds(*agreement, before, PROMISING, rays)).map(|(pose, _)| pose)
    }
}

/// Whether clearly more of so many rays agree. `deviation`: of the pose that they agree with from the prior, in standard deviations of that.
pub(super) fn is_better(agreement: Agreement, before: Agreement, rays: usize, deviation: f64) -> bool {
    exceeds(agreement, before, BELIEVED * deviation.clamp(1.0, INCREDIBLE), rays)
}

fn exceeds(agreement: Agreement, before: Agreement, margin: f64, rays: usize) -> bool {
    f64::from(agreement.agreeing) > f64::from(before.agreeing) + margin * rays as f64
}

fn is_beside(one: &Pose2, other: &Pose2) -> bool {
    let motion = one.between(other);
    motion.distance() < BESIDE * STEP && motion.theta.abs() < BESIDE * TURN_STEP
}

/// From `-limit` to `limit`, evenly, by `step` at most.
fn offsets(limit: f64, step: f64) -> impl Iterator<Item = f64> {
    #[allow(clippy::cast_possible_truncation)] // some dozens
    let steps = (limit / step).ceil() as i32;
    (-steps..=steps).map(move |i| if steps == 0 { 0.0 } else { limit * f64::from(i) / f64::from(steps) })
}
