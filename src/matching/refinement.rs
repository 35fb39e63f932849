//! The ICP loop: iterations from coarse to fine, and the search for other solutions if the scans do not agree.

use std::f64::consts::FRAC_PI_2;

use super::Matcher;
use super::data_association::{Agreement, Correspondences};
use super::first_guess::{FirstGuess, Prior};
use super::ray_order::RayOrder;
use super::search::{self, TrackingResult};
use super::solver::{QuadraticForm, SolverKind};
use super::stop_reason::StopReason;
use super::uncertainty::Uncertainty;
use crate::geometry::{Point, Pose2, wrap_angle};
use crate::scan::Scan;

/// Minimum number of inlier correspondences: fewer do not determine a pose.
const MIN_CORRESPONDENCES: u32 = 3;
/// A pose found by the search is accepted only if more than this fraction of the rays agree with it.
const MIN_SEARCH_AGREEMENT: f64 = 0.5;
/// Number of rays used by the search.
const SEARCH_RAYS: usize = 64;
/// Number of ICP iterations from each start of the search.
const SEARCH_ITERATIONS: usize = 5;
/// If tracking from the prior failed, the covariance of the prior is multiplied by this factor.
const PRIOR_INFLATION: f64 = 25.0;
/// Each level of the coarse-to-fine schedule uses this many times the rays of the previous level.
const LEVEL_RATIO: usize = 4;
/// Coarse levels use only this many views, the first ones, which should cover most of what the scan sees.
pub(crate) const COARSE_VIEWS: usize = 3;
/// A coarse level has converged when its steps are below this many times epsilon: the next level corrects the rest.
const COARSE_EPSILON_FACTOR: f64 = 10.0;

/// Record of one iteration.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct IterationTrace {
    /// Pose of the sensed scan in the reference frame after the iteration.
    pub pose: Pose2,
    /// Number of sensed points used.
    pub rays: u32,
    /// Number of those with a correspondence.
    pub correspondences: u32,
    /// Number of correspondences left after outlier rejection.
    pub inliers: u32,
    /// Mean absolute error of the inliers before the step, m.
    pub mean_residual: f64,
    /// Hash of the set of correspondences, to detect cycles.
    fingerprint: Option<u64>,
}

/// Stage of a refinement. The later stages keep the result of tracking, to fall back to if they find nothing better.
#[derive(Clone, Copy, Debug)]
enum Stage {
    /// ICP from the first guess.
    Tracking,
    /// The scans do not agree well enough: ICP from other starts.
    Search(TrackingResult),
    /// ICP with all rays from the best pose that the search has found.
    Verification(TrackingResult),
}

/// A match in progress.
pub struct Refinement<'a> {
    matcher: &'a mut Matcher,
    scan: &'a Scan,
    /// Number of rays of the finest level.
    finest: usize,
    /// Number of rays of the next iteration; it differs from the current number if a new level begins.
    next_rays: usize,
    /// Number of rays requested by the last selection; 0: no rays have been selected yet.
    selected_rays: usize,
    /// Index in the trace of the current level's first iteration.
    level_start: usize,
    first_guess: FirstGuess,
    pose: Pose2,
    stage: Stage,
    /// Index in the trace of the current stage's first iteration.
    stage_start: usize,
    stopped: Option<StopReason>,
}

impl<'a> Refinement<'a> {
    /// Starts with the coarsest level.
    pub(super) fn new(matcher: &'a mut Matcher, scan: &'a Scan, first_guess: FirstGuess) -> Self {
        let all_if_zero = |count: u32| if count == 0 { usize::MAX } else { count as usize };
        let coarsest = all_if_zero(matcher.knobs.coarse_rays);
        let mut refinement = Self {
            finest: all_if_zero(matcher.knobs.max_rays).min(scan.valid_len()),
            next_rays: 0,
            selected_rays: 0,
            level_start: 0,
            pose: first_guess.pose,
            first_guess,
            stage: Stage::Tracking,
            stage_start: 0,
            stopped: None,
            matcher,
            scan,
        };
        refinement.use_rays(coarsest);
        refinement
    }

    /// Does one iteration, or nothing if the refinement has stopped. Returns the reason for stopping, or `None` while further
    /// iterations can improve the pose.
    pub fn refine(&mut self) -> Option<StopReason> {
        if self.stopped.is_none() {
            self.stopped = match self.stage {
                Stage::Tracking => self.step().and_then(|outcome| self.finish_tracking(outcome)),
                Stage::Search(tracked) => self.search_step(tracked),
                Stage::Verification(tracked) => self.step().map(|outcome| self.verify(outcome, &tracked)),
            };
        }
        self.stopped
    }

    /// Does one iteration of the current level, and advances to the next level when this one is done. Returns why the last level
    /// ended.
    fn step(&mut self) -> Option<StopReason> {
        self.start_level();
        match self.iterate() {
            Err(StopReason::IterationLimit) => Some(StopReason::IterationLimit),
            Err(_) if self.next_rays < self.finest => {
                self.use_rays(LEVEL_RATIO * self.next_rays);
                None
            }
            outcome => outcome.err(),
        }
    }

    /// Ends tracking, or starts a search if too few rays agree with the result.
    fn finish_tracking(&mut self, outcome: StopReason) -> Option<StopReason> {
        let m = &mut *self.matcher;
        let Some(agreement) = m.association.agreement() else { return Some(outcome) };
        if !outcome.is_failure() && agreement.fraction() >= self.first_guess.window.min_agreement {
            return Some(outcome);
        }
        m.search.begin(&self.first_guess);
        self.stage = Stage::Search(TrackingResult {
            pose: self.pose,
            kernel_variance: m.association.kernel_variance(),
            agreement,
            outcome,
        });
        self.next_rays = SEARCH_RAYS.min(self.finest);
        self.start_level();
        None
    }

    /// Does one step of the search: first all starts are scored, then each of the best is refined with few rays, then the best of
    /// those with all rays.
    fn search_step(&mut self, tracked: TrackingResult) -> Option<StopReason> {
        let m = &mut *self.matcher;
        if m.search.score_some(&*m.association) {
            return None;
        }
        if let Some(start) = m.search.next_start() {
            if let Some((pose, agreement)) = m.refine_start(start, &tracked.pose) {
                m.search.consider(pose, agreement);
            }
            return None;
        }
        m.association.find_correspondences(&tracked.pose);
        let before = m.association.agreement()?;
        let Some(best_pose) = m.search.best_pose(before, m.association.ray_count()) else {
            return Some(self.fall_back_to(&tracked));
        };
        self.pose = best_pose;
        // The prior that led tracking astray must not pull the pose back.
        let prior = self.first_guess.prior.map(|prior| Prior { covariance: prior.covariance * PRIOR_INFLATION, ..prior });
        m.association.begin(&FirstGuess { pose: best_pose, prior, ..self.first_guess });
        self.stage = Stage::Verification(tracked);
        self.stage_start = m.trace.len();
        self.use_rays(self.finest);
        None
    }

    /// Accepts the result of the search if, refined with all rays, it is clearly better than the result of tracking.
    fn verify(&mut self, outcome: StopReason, tracked: &TrackingResult) -> StopReason {
        let agreement = self.matcher.association.agreement().unwrap_or_default();
        let is_plausible = !outcome.is_failure() && agreement.fraction() > MIN_SEARCH_AGREEMENT;
        let deviation = self.first_guess.prior.map_or(0.0, |prior| prior.mahalanobis_distance(&self.pose));
        let is_better = is_plausible && search::is_better(agreement, tracked.agreement, self.finest, deviation);
        if is_better { outcome } else { self.fall_back_to(tracked) }
    }

    /// Falls back to the result of tracking: the search has found nothing better.
    fn fall_back_to(&mut self, tracked: &TrackingResult) -> StopReason {
        self.stage = Stage::Tracking;
        self.pose = tracked.pose;
        self.next_rays = self.finest;
        self.start_level();
        self.matcher.restore_correspondences(&self.first_guess, tracked);
        // Projective correspondences exist wherever the views see anything. Only agreement shows that they are correct.
        let agrees = tracked.agreement.fraction() >= self.matcher.knobs.min_correspondence_ratio;
        if agrees { tracked.outcome } else { StopReason::TooFewCorrespondences }
    }

    /// Uses about this many rays from the next iteration on, limited by the size of the scan and by `max_rays`.
    pub fn use_rays(&mut self, count: usize) {
        // With more than half of the rays, the level might as well use all of them.
        self.next_rays = if count > self.finest / 2 { self.finest } else { count };
    }

    /// Approximate number of sensed rays used by the next iteration. For a step of the search: the number of rays that would take
    /// the same work.
    pub fn next_rays(&self) -> usize {
        match self.stage {
            Stage::Search(_) => SEARCH_RAYS * (SEARCH_ITERATIONS + 1),
            Stage::Tracking | Stage::Verification(_) => self.next_rays,
        }
    }

    /// Selects the rays if their number has changed.
    fn start_level(&mut self) {
        if self.selected_rays == self.next_rays {
            return;
        }
        let views = if self.next_rays < self.finest { COARSE_VIEWS } else { usize::MAX };
        self.matcher.association.select_rays(RayOrder::first(self.next_rays, self.rays()), views);
        self.selected_rays = self.next_rays;
        self.level_start = self.matcher.trace.len();
    }

    /// One ICP iteration: find correspondences, solve, check for convergence.
    fn iterate(&mut self) -> Result<(), StopReason> {
        let m = &mut *self.matcher;
        let found = m.association.find_correspondences(&self.pose).ok_or(StopReason::TooFewCorrespondences)?;
        let fraction = f64::from(found.count) / m.association.ray_count() as f64;
        if fraction < m.knobs.min_correspondence_ratio || found.inliers < MIN_CORRESPONDENCES {
            return Err(StopReason::TooFewCorrespondences);
        }
        let pose = m.solve(&found.form, &self.pose).ok_or(StopReason::Singular)?;
        let step = self.pose.between(&pose);
        self.pose = pose;
        let best_of_cycle = self.record(&found);
        let knobs = &self.matcher.knobs;
        let epsilons = if self.selected_rays < self.finest { COARSE_EPSILON_FACTOR } else { 1.0 };
        let (translation, rotation) = (epsilons * knobs.epsilon_translation, epsilons * knobs.epsilon_rotation);
        if found.is_kernel_settled && step.distance() <= translation && step.theta.abs() <= rotation {
            return Err(StopReason::Converged);
        }
        if let Some(pose) = best_of_cycle {
            self.pose = pose;
            return Err(StopReason::Cycle);
        }
        if self.trace().len() >= self.stage_start + knobs.max_iterations as usize {
            return Err(StopReason::IterationLimit);
        }
        Ok(())
    }

    /// Adds an iteration to the trace. If an earlier one of its level had the same correspondences, the steps repeat in a cycle:
    /// returns the pose of the cycle with the smallest mean residual.
    #[allow(clippy::cast_possible_truncation)] // a scan has at most 10 000 rays
    fn record(&mut self, found: &Correspondences) -> Option<Pose2> {
        let trace = &mut self.matcher.trace;
        let is_same = |earlier: &IterationTrace| found.fingerprint.is_some() && earlier.fingerprint == found.fingerprint;
        let repeated = trace[self.level_start..].iter().position(is_same);
        trace.push(IterationTrace {
            pose: self.pose,
            rays: self.matcher.association.ray_count() as u32,
            correspondences: found.count,
            inliers: found.inliers,
            mean_residual: found.mean_residual,
            fingerprint: found.fingerprint,
        });
        // A residual in the trace belongs to the pose before its step.
        let steps = trace[self.level_start + repeated?..].windows(2);
        steps.min_by(|a, b| a[1].mean_residual.total_cmp(&b[1].mean_residual)).map(|step| step[0].pose)
    }

    /// The best pose so far of the sensed laser in the reference frame. Before the first iteration: the first guess.
    pub fn pose(&self) -> Pose2 {
        self.pose
    }

    /// The pose that the match began with.
    pub fn first_guess(&self) -> Pose2 {
        self.first_guess.pose
    }

    /// Record of every iteration so far.
    pub fn trace(&self) -> &[IterationTrace] {
        &self.matcher.trace
    }

    /// Number of sensed rays that carry a measurement.
    pub fn rays(&self) -> usize {
        self.scan.valid_len()
    }

    /// Whether the search for other solutions is running, because too few rays agree at [`Self::pose`].
    pub fn is_searching(&self) -> bool {
        matches!(self.stage, Stage::Search(_))
    }

    /// Fraction of the rays that end on a surface of the reference, among those that end where the reference sees anything.
    /// `None` for nearest-point correspondences, which do not measure this.
    pub fn agreement(&self) -> Option<f64> {
        self.matcher.association.agreement().map(Agreement::fraction)
    }

    /// The correspondences of the last iteration as pairs (sensed point at the current pose, reference point), m, in the
    /// reference frame.
    pub fn matched_points(&self, points: &mut Vec<(Point, Point)>) {
        self.matcher.association.matched_points(&self.pose, points);
    }

    /// Uncertainty of [`Self::pose`] from the correspondences of the last iteration; `None` before the first iteration.
    pub fn uncertainty(&mut self) -> Option<Uncertainty> {
        let m = &mut *self.matcher;
        m.trace.last()?;
        if let Stage::Search(tracked) = self.stage {
            m.restore_correspondences(&self.first_guess, &tracked);
        }
        Some(m.association.uncertainty(&self.pose))
    }
}
impl Matcher {
    /// Solves for the pose that minimises the error of correspondences found at `pose`.
    fn solve(&self, form: &QuadraticForm, pose: &Pose2) -> Option<Pose2> {
        let best = (self.solver)(form, pose).filter(Pose2::is_finite)?;
        // A corner of two walls fits equally well after a rotation by half a turn about it. Correspondences are valid only near
        // the pose that they were found at.
        let is_near = wrap_angle(best.theta - pose.theta).abs() < FRAC_PI_2;
        if is_near { Some(best) } else { SolverKind::Linearized.solve(form, pose) }
    }

    /// Does a few ICP iterations from a start of the search. Returns the pose, and how far the scans agree there; `None` if it leads
    /// to `tracked`, the result of tracking.
    fn refine_start(&mut self, start: Pose2, tracked: &Pose2) -> Option<(Pose2, Agreement)> {
        let mut pose = start;
        self.association.begin(&start.into());
        for _ in 0..SEARCH_ITERATIONS {
            let found = self.association.find_correspondences(&pose);
            let Some(next) = found.and_then(|found| self.solve(&found.form, &pose)) else { break };
            pose = next;
            if search::leads_to(&pose, tracked) {
                return None;
            }
        }
        self.association.find_correspondences(&pose);
        Some((pose, self.association.agreement()?))
    }

    /// Restores the correspondences of the last tracking iteration, for the rays that are selected now.
    fn restore_correspondences(&mut self, first_guess: &FirstGuess, tracked: &TrackingResult) {
        self.association.begin(first_guess);
        self.association.set_kernel_variance(tracked.kernel_variance);
        self.association.find_correspondences(&tracked.pose);
    }
}
