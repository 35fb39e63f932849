//! Scan matching by iterative closest point (ICP): aligns a sensed scan with a reference scan.
//!
//! `Refinement::iterate` is one ICP iteration: find correspondences, reject outliers, solve for the pose. [`Refinement::refine`]
//! adds the coarse-to-fine levels, from few rays to all of them, and a multi-start search for when the scans do not agree.
//!
//! [`Matcher::begin`] starts a match, each call of `refine` improves it, and [`Refinement::pose`] is the best pose so far at any
//! time: this makes it an anytime algorithm. This module reads no clock, prints nothing and does not panic. It allocates nothing
//! once its buffers have grown to the size of the scans.

pub mod classic;
mod data_association;
mod ray_order;
mod search;
pub mod solver;
mod surface;
mod surfaces;
mod symmetric_eigen;
mod uncertainty;
mod view;

#[cfg(test)]
mod tests;

use std::f64::consts::FRAC_PI_2;
use std::sync::Arc;

use crate::geometry::{Point, Pose2, PoseCovariance, wrap_angle};
use crate::scan::Scan;
use classic::ClosestPoint;
use classic::correspondence::CorrespondenceKind;
use classic::rejection::RejectionKnobs;
pub use data_association::PlacedView;
use data_association::{Agreement, Correspondences, DataAssociation};
use ray_order::RayOrder;
use search::{MultiStartSearch, TrackingResult};
use solver::{Metric, QuadraticForm, SolverKind};
use surfaces::Projective;
pub use uncertainty::Uncertainty;
pub use view::View;

/// Minimum number of inlier correspondences: fewer do not determine a pose.
const MIN_CORRESPONDENCES: u32 = 3;
/// Maximum number of refinements per match: one from the first guess, and one from the result of the search.
const MAX_STAGES: usize = 2;
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

crate::knobs! {
    /// How two scans are matched.
    pub struct MatchingKnobs {
        /// How the correspondence of a point is found in the reference. `projective` pairs it with the surface seen in its
        /// direction, all others with its nearest point (classic PL-ICP).
        correspondence: CorrespondenceKind = CorrespondenceKind::Projective;
        /// Error metric and how it is minimised. Projective correspondences are point-to-line: `point_to_point` means
        /// `point_to_line` for them.
        solver: SolverKind = SolverKind::PointToLine;
        /// Maximum number of rays used of the sensed scan, spread over the whole field of view; 0: all.
        max_rays: u32 = 0, in 0 to 10000;
        /// Number of rays on the coarsest level, which does most of the alignment cheaply. Each following level uses four times
        /// as many; 0: all rays from the start.
        coarse_rays: u32 = 128, in 0 to 10000;
        /// Maximum number of iterations per match.
        max_iterations: u32 = 30, in 1 to 1000;
        /// Maximum distance between corresponding points.
        max_correspondence_distance: f64 = 0.5, in 0.001 to 100, unit "m";
        /// A match has converged when a step moves the pose by less than this and rotates it by less than `epsilon_rotation`.
        epsilon_translation: f64 = 3e-4, in 0 to 1, unit "m";
        /// See `epsilon_translation`.
        epsilon_rotation: f64 = 1e-4, in 0 to 1, unit "rad";
        /// Minimum fraction of the sensed rays that must have a correspondence.
        min_correspondence_ratio: f64 = 0.2, in 0 to 1;
        /// Standard deviation of a measured range. If keyframes with many rays show a larger one, that is used instead.
        range_noise: f64 = 0.01, in 0.0001 to 1, unit "m";
    }
}

/// Why a refinement stopped.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum StopReason {
    /// The last step was below epsilon.
    Converged,
    /// The correspondences are the same as in an earlier iteration: the steps repeat in a cycle.
    Cycle,
    /// The limit `max_iterations` is reached.
    IterationLimit,
    /// The time budget is used up.
    Budget,
    /// The estimated error is within the requested bound.
    ErrorBound,
    /// The caller asked for the answer now.
    Interrupted,
    /// Too few sensed points have a correspondence.
    TooFewCorrespondences,
    /// The correspondences determine no finite pose.
    Singular,
}

impl StopReason {
    /// The name used in reports and files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Converged => "converged",
            Self::Cycle => "cycle",
            Self::IterationLimit => "iteration_limit",
            Self::Budget => "budget",
            Self::ErrorBound => "error_bound",
            Self::Interrupted => "interrupted",
            Self::TooFewCorrespondences => "too_few_correspondences",
            Self::Singular => "singular",
        }
    }

    /// Whether the match failed, so that its pose is unusable.
    pub fn is_failure(self) -> bool {
        matches!(self, Self::TooFewCorrespondences | Self::Singular)
    }
}

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

/// Prior knowledge of a pose from other sources, such as odometry.
#[derive(Clone, Copy, Debug)]
pub struct Prior {
    /// Pose of the sensed laser in the reference frame.
    pub pose: Pose2,
    /// Its covariance, m, m, rad.
    pub covariance: PoseCovariance,
}

impl Prior {
    /// Mahalanobis distance of a pose from the prior, in standard deviations (Mahalanobis 1936).
    pub(crate) fn mahalanobis_distance(&self, pose: &Pose2) -> f64 {
        let offset = self.pose.difference(pose);
        self.covariance.try_inverse().map_or(0.0, |information| offset.dot(&(information * offset)).sqrt())
    }
}

/// Initial guess of a match.
#[derive(Clone, Copy, Debug)]
pub struct FirstGuess {
    /// Pose of the sensed laser in the reference frame.
    pub pose: Pose2,
    /// Prior that is weighed against the scans, if any.
    pub prior: Option<Prior>,
    /// Window of the search for other solutions.
    pub window: SearchWindow,
}

/// Window around the first guess in which other starts are tried if tracking from the first guess fits badly.
#[derive(Clone, Copy, Debug)]
pub struct SearchWindow {
    /// Half width of the window in x and y, m.
    pub distance: f64,
    /// Half width of the window in heading, rad.
    pub angle: f64,
    /// Search if a smaller fraction of the rays agrees; more than 1: always search.
    pub min_agreement: f64,
}

impl Default for SearchWindow {
    /// Twice the error that tracking alone can correct.
    fn default() -> Self {
        Self { distance: 0.3, angle: 0.35, min_agreement: 0.9 }
    }
}

/// A first guess without a prior.
impl From<Pose2> for FirstGuess {
    fn from(pose: Pose2) -> Self {
        Self { pose, prior: None, window: SearchWindow::default() }
    }
}

/// Matches scans, and keeps its buffers from match to match.
pub struct Matcher {
    knobs: MatchingKnobs,
    association: Box<dyn DataAssociation>,
    metric: Metric,
    solver: fn(&QuadraticForm, &Pose2) -> Option<Pose2>,
    search: MultiStartSearch,
    /// Number of rays requested by the last selection; 0: no rays have been selected yet.
    selected_rays: usize,
    trace: Vec<IterationTrace>,
}

impl Matcher {
    /// Changes the maximum number of iterations per match.
    pub fn set_max_iterations(&mut self, limit: u32) {
        self.knobs.max_iterations = limit;
        self.trace = Vec::with_capacity(MAX_STAGES * limit as usize); // so that no match allocates
    }

    /// Creates a matcher with these parameters.
    pub fn new(knobs: &MatchingKnobs, rejection: &RejectionKnobs) -> Self {
        let noise = knobs.range_noise;
        let solver = if knobs.correspondence.supports(knobs.solver) { knobs.solver } else { SolverKind::PointToLine };
        let association: Box<dyn DataAssociation> = match knobs.correspondence.search() {
            Some(search) => Box::new(ClosestPoint::new(search, rejection, knobs.max_correspondence_distance, noise)),
            None => Box::new(Projective::new(noise)),
        };
        Self {
            association,
            metric: solver.metric(),
            solver: solver.function(),
            search: MultiStartSearch::default(),
            selected_rays: 0,
            trace: Vec::with_capacity(MAX_STAGES * knobs.max_iterations as usize),
            knobs: knobs.clone(),
        }
    }

    /// Enables estimation of the range noise from the scans that this matcher prepares. If walls are uneven, a single match then
    /// claims less precision than it has. Along a path, however, errors that neighbouring rays share are not counted as
    /// information again and again.
    #[must_use]
    pub fn with_noise_estimation(mut self) -> Self {
        self.association.estimate_noise();
        self
    }

    /// Prepares a scan to serve as a reference.
    pub fn view(&mut self, scan: Scan) -> Arc<View> {
        Arc::new(self.association.view(scan))
    }

    /// Sets a single scan as the reference of the next matches.
    pub fn set_reference(&mut self, scan: &Scan) {
        let view = self.view(scan.clone());
        self.set_views(&[PlacedView::at_origin(view)]);
    }

    /// Sets the views that form the reference of the next matches. The frame of the first view is the reference frame.
    pub fn set_views(&mut self, views: &[PlacedView]) {
        self.association.set_views(views);
    }

    /// Starts to match a scan. `first_guess`: pose of the sensed laser in the reference frame.
    pub fn begin<'a>(&'a mut self, sensed: &'a Scan, first_guess: impl Into<FirstGuess>) -> Refinement<'a> {
        let first_guess = first_guess.into();
        let all_if_zero = |count: u32| if count == 0 { usize::MAX } else { count as usize };
        let finest = all_if_zero(self.knobs.max_rays).min(sensed.valid_len());
        let coarsest = all_if_zero(self.knobs.coarse_rays);
        self.trace.clear();
        self.association.begin(&first_guess);
        self.association.set_sensed(sensed);
        self.selected_rays = 0;
        let mut refinement = Refinement {
            matcher: self,
            scan: sensed,
            finest,
            next_rays: 0,
            level_start: 0,
            first_guess,
            pose: first_guess.pose,
            stopped: None,
            stage: Stage::Tracking,
            stage_start: 0,
        };
        refinement.use_rays(coarsest);
        refinement
    }
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
    /// Index in the trace of the current level's first iteration.
    level_start: usize,
    first_guess: FirstGuess,
    pose: Pose2,
    stage: Stage,
    /// Index in the trace of the current stage's first iteration.
    stage_start: usize,
    stopped: Option<StopReason>,
}

impl Refinement<'_> {
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
        m.association.find_correspondences(&tracked.pose, m.metric);
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
        let m = &mut *self.matcher;
        if m.selected_rays == self.next_rays {
            return;
        }
        m.association.select_rays(RayOrder::first(self.next_rays, self.scan.valid_len()));
        m.association.limit_views(if self.next_rays < self.finest { COARSE_VIEWS } else { usize::MAX });
        m.selected_rays = self.next_rays;
        self.level_start = m.trace.len();
    }

    /// One ICP iteration: find correspondences, solve, check for convergence.
    fn iterate(&mut self) -> Result<(), StopReason> {
        let m = &mut *self.matcher;
        let found = m.association.find_correspondences(&self.pose, m.metric).ok_or(StopReason::TooFewCorrespondences)?;
        let fraction = f64::from(found.count) / m.association.ray_count() as f64;
        if fraction < m.knobs.min_correspondence_ratio || found.inliers < MIN_CORRESPONDENCES {
            return Err(StopReason::TooFewCorrespondences);
        }
        let pose = m.solve(&found.form, &self.pose).ok_or(StopReason::Singular)?;
        let step = self.pose.between(&pose);
        self.pose = pose;
        let repeated = m.record(pose, &found, self.level_start);
        let epsilons = if m.selected_rays < self.finest { COARSE_EPSILON_FACTOR } else { 1.0 };
        let (translation, rotation) = (epsilons * m.knobs.epsilon_translation, epsilons * m.knobs.epsilon_rotation);
        if found.is_kernel_settled && step.distance() <= translation && step.theta.abs() <= rotation {
            return Err(StopReason::Converged);
        }
        if let Some(start) = repeated {
            self.pose = m.best_pose_since(start);
            return Err(StopReason::Cycle);
        }
        if m.trace.len() >= self.stage_start + m.knobs.max_iterations as usize {
            return Err(StopReason::IterationLimit);
        }
        Ok(())
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
        Some(m.association.uncertainty(&self.pose, m.metric))
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
            let found = self.association.find_correspondences(&pose, self.metric);
            let Some(next) = found.and_then(|found| self.solve(&found.form, &pose)) else { break };
            pose = next;
            if search::leads_to(&pose, tracked) {
                return None;
            }
        }
        self.association.find_correspondences(&pose, self.metric);
        Some((pose, self.association.agreement()?))
    }

    /// Restores the correspondences of the last tracking iteration, for the rays that are selected now.
    fn restore_correspondences(&mut self, first_guess: &FirstGuess, tracked: &TrackingResult) {
        self.association.begin(first_guess);
        self.association.set_kernel_variance(tracked.kernel_variance);
        self.association.find_correspondences(&tracked.pose, self.metric);
    }

    /// Adds an iteration to the trace. Returns the index of an earlier iteration with the same correspondences, if there is one
    /// since `level_start`.
    #[allow(clippy::cast_possible_truncation)] // a scan has at most 10 000 rays
    fn record(&mut self, pose: Pose2, found: &Correspondences, level_start: usize) -> Option<usize> {
        let same = |iteration: &IterationTrace| found.fingerprint.is_some() && iteration.fingerprint == found.fingerprint;
        let repeated = self.trace.iter().enumerate().skip(level_start).find(|(_, iteration)| same(iteration)).map(|(i, _)| i);
        self.trace.push(IterationTrace {
            pose,
            rays: self.association.ray_count() as u32,
            correspondences: found.count,
            inliers: found.inliers,
            mean_residual: found.mean_residual,
            fingerprint: found.fingerprint,
        });
        repeated
    }

    /// The pose with the smallest mean residual since iteration `start`. (A residual in the trace belongs to the pose before its
    /// step.)
    fn best_pose_since(&self, start: usize) -> Pose2 {
        let best =
            (start + 1..self.trace.len()).min_by(|&a, &b| self.trace[a].mean_residual.total_cmp(&self.trace[b].mean_residual));
        self.trace[best.map_or(start, |i| i - 1)].pose
    }
}
