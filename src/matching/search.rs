//! Multi-start search: tries other starts than the first guess if the scans do not agree well enough where tracking from it
//! ended.
//!
//! All starts in the window are scored with few rays. The best few, no two of them neighbours, are refined. The one that most
//! rays agree with is refined with all rays, and accepted if clearly more rays agree than before.

use super::data_association::{Agreement, DataAssociation};
use super::first_guess::{FirstGuess, SearchWindow};
use super::stop_reason::StopReason;
use crate::geometry::Pose2;

/// Distance between neighbouring starts in x and y, m.
const TRANSLATION_STEP: f64 = 0.15;
/// Angle between neighbouring starts, rad.
const ROTATION_STEP: f64 = 0.0873;
/// Number of starts scored per step of the search.
const SCORES_PER_STEP: usize = 64;
/// Starts that are less than this many grid steps apart lead to the same pose.
const MIN_SEPARATION: f64 = 1.1;
/// ICP from a start that comes this near to the result of tracking, in grid steps, leads there. At twice this distance, other
/// solutions are missed.
const TRACKED_RADIUS: f64 = 1.0 / 8.0;
/// Maximum number of starts that are refined.
const MAX_REFINED: usize = 8;
/// A refined start is refined again with all rays if more rays agree than before, by this fraction of them.
const REFINEMENT_MARGIN: f64 = 0.03;
/// The result is accepted if more rays agree than before, by this fraction of them per standard deviation from the prior,
/// counting at least one standard deviation.
const ACCEPTANCE_MARGIN: f64 = 0.05;
/// Maximum number of standard deviations counted for [`ACCEPTANCE_MARGIN`].
const MAX_DEVIATION: f64 = 3.0;

/// Result of tracking from the first guess.
#[derive(Clone, Copy, Debug)]
pub(super) struct TrackingResult {
    pub(super) pose: Pose2,
    /// Variance of the robust kernel.
    pub(super) kernel_variance: f64,
    pub(super) agreement: Agreement,
    pub(super) outcome: StopReason,
}

/// A search in progress; keeps its buffers from search to search.
#[derive(Debug, Default)]
pub(super) struct MultiStartSearch {
    starts: Vec<Pose2>,
    scores: Vec<(u32, usize)>,
    /// Starts that remain to be refined.
    candidates: Vec<Pose2>,
    best: Option<(Pose2, Agreement)>,
}

impl MultiStartSearch {
    pub(super) fn begin(&mut self, guess: &FirstGuess) {
        self.best = None;
        self.scores.clear();
        self.starts.clear();
        let SearchWindow { distance, angle, .. } = guess.window;
        for rotation in offsets(angle, ROTATION_STEP) {
            for forward in offsets(distance, TRANSLATION_STEP) {
                self.starts
                    .extend(offsets(distance, TRANSLATION_STEP).map(|left| guess.pose * Pose2::new(forward, left, rotation)));
            }
        }
    }

    /// Scores some more starts, and selects the best when all are scored. Returns whether there was anything left to score.
    pub(super) fn score_some(&mut self, association: &dyn DataAssociation) -> bool {
        let done = self.scores.len();
        if done == self.starts.len() {
            return false;
        }
        let next = self.starts[done..].iter().take(SCORES_PER_STEP).enumerate();
        self.scores.extend(next.map(|(i, start)| (association.score(start), done + i)));
        if self.scores.len() == self.starts.len() {
            self.select_best();
        }
        true
    }

    /// Selects the starts with the best scores. Of neighbouring starts only the best is kept.
    fn select_best(&mut self) {
        self.scores.sort_unstable_by(|a, b| b.cmp(a));
        self.candidates.clear();
        for &(_, i) in &self.scores {
            let start = self.starts[i];
            if !self.candidates.iter().any(|better| are_within(better, &start, MIN_SEPARATION)) {
                self.candidates.push(start);
            }
            if self.candidates.len() == MAX_REFINED {
                break;
            }
        }
    }

    /// Takes the next start to be refined.
    pub(super) fn next_start(&mut self) -> Option<Pose2> {
        self.candidates.pop()
    }

    /// Records the result of refining a start.
    pub(super) fn consider(&mut self, pose: Pose2, agreement: Agreement) {
        if self.best.is_none_or(|(_, best)| agreement.agreeing > best.agreeing) {
            self.best = Some((pose, agreement));
        }
    }

    /// The best pose found, if enough more of the `rays` agree with it than `before`.
    pub(super) fn best_pose(&self, before: Agreement, rays: usize) -> Option<Pose2> {
        self.best.filter(|(_, agreement)| exceeds(*agreement, before, REFINEMENT_MARGIN, rays)).map(|(pose, _)| pose)
    }
}

/// Whether clearly more of the `rays` agree than `before`. `deviation`: Mahalanobis distance of the new pose from the prior, in
/// standard deviations.
pub(super) fn is_better(agreement: Agreement, before: Agreement, rays: usize, deviation: f64) -> bool {
    exceeds(agreement, before, ACCEPTANCE_MARGIN * deviation.clamp(1.0, MAX_DEVIATION), rays)
}

fn exceeds(agreement: Agreement, before: Agreement, margin: f64, rays: usize) -> bool {
    f64::from(agreement.agreeing) > f64::from(before.agreeing) + margin * rays as f64
}

/// Whether ICP that has come to `pose` leads to the result of tracking.
pub(super) fn leads_to(pose: &Pose2, tracked: &Pose2) -> bool {
    are_within(pose, tracked, TRACKED_RADIUS)
}

/// Whether two poses are less than this many grid steps apart.
fn are_within(one: &Pose2, other: &Pose2, steps: f64) -> bool {
    one.is_near(other, steps * TRANSLATION_STEP, steps * ROTATION_STEP)
}

/// Evenly spaced values from `-limit` to `limit`, at most `step` apart.
fn offsets(limit: f64, step: f64) -> impl Iterator<Item = f64> {
    #[allow(clippy::cast_possible_truncation)] // at most some dozens
    let steps = (limit / step).ceil() as i32;
    (-steps..=steps).map(move |i| if steps == 0 { 0.0 } else { limit * f64::from(i) / f64::from(steps) })
}
