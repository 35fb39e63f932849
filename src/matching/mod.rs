//! Matching a sensed scan to a reference scan by iterated closest point.
//!
//! The whole algorithm is `Refinement::iterate`: correspondences, rejection, solve. [`Refinement::refine`] adds the levels, from few rays
//! to all, and the search for other starts. [`Matcher::begin`] sets a match up, each `refine` improves it, and [`Refinement::pose`] is the
//! best pose so far at every moment: that makes it an anytime algorithm. No clock is read here, nothing allocates once the buffers have
//! grown to the size of the scans, nothing prints and nothing panics.

pub mod classic;
mod pairing;
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
use classic::correspondence::Correspondence;
use classic::rejection::RejectionKnobs;
pub use pairing::PlacedView;
use pairing::{Agreement, Pairing, Pairs};
use ray_order::RayOrder;
use search::{Search, Tracked};
use solver::{Metric, QuadraticForm, SolverKind};
use surfaces::Projective;
pub use uncertainty::Uncertainty;
pub use view::View;

/// Pairs without which no pose is determined.
const FEWEST_PAIRS: u32 = 3;
/// Refinements of one match at most: from the first guess, and from what a search has found.
const STAGES: usize = 2;
/// What a search finds must have more than this part of the rays agree.
const LIKELY_AGREEMENT: f64 = 0.5;
/// Rays that the search makes do with.
const SEARCH_RAYS: usize = 64;
/// Iterations from each start of the search.
const SEARCH_ITERATIONS: usize = 5;
/// A prior that led astray has its covariance multiplied by this.
const DISTRUST: f64 = 25.0;
/// Each level of the coarse-to-fine schedule has so many times the rays of the one before.
const LEVEL_RATIO: usize = 4;
/// Coarse levels make do with so many views, the first ones: they should see most of what the scan sees.
pub(crate) const COARSE_VIEWS: usize = 3;
/// A coarse level is left when its steps are below this many epsilons: what remains, the finer one corrects anyway.
const COARSE_EPSILONS: f64 = 10.0;

crate::knobs! {
    /// How two scans are matched.
    pub struct MatchingKnobs {
        /// How the partner of a point in the reference is found. All but `projective` are for its nearest point: classic PL-ICP.
        correspondence: Correspondence = Correspondence::Projective;
        /// What is minimised, and how. Projective pairs are of points with lines: `point_to_point` is `point_to_line` for them.
        solver: SolverKind = SolverKind::PointToLine;
        /// Rays of the sensed scan that take part at most, spread over the whole field of view; 0: all.
        max_rays: u32 = 0, in 0 to 10000;
        /// Rays to begin with: what they settle need not be done with all. Each following level has four times as many; 0: all at once.
        coarse_rays: u32 = 128, in 0 to 10000;
        /// Iterations of one match at most.
        max_iterations: u32 = 30, in 1 to 1000;
        /// Points farther apart do not correspond.
        max_correspondence_distance: f64 = 0.5, in 0.001 to 100, unit "m";
        /// Converged when a step moves the pose by less than this and turns it by less than `epsilon_rotation`.
        epsilon_translation: f64 = 3e-4, in 0 to 1, unit "m";
        /// See `epsilon_translation`.
        epsilon_rotation: f64 = 1e-4, in 0 to 1, unit "rad";
        /// Least part of the sensed rays that must find a correspondence.
        min_correspondence_ratio: f64 = 0.2, in 0 to 1;
        /// Standard deviation of a range; where keyframes of many rays show more, that counts.
        range_noise: f64 = 0.01, in 0.0001 to 1, unit "m";
    }
}

/// Why a refinement ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum StopReason {
    /// The last step was below epsilon.
    Converged,
    /// The correspondences are those of an earlier iteration: the steps go round in a circle.
    Cycle,
    /// `max_iterations` have been made.
    IterationLimit,
    /// The time budget is used up.
    Budget,
    /// The estimated error is within the bound asked for.
    ErrorBound,
    /// The answer was called for.
    Interrupted,
    /// Too few sensed points have a partner.
    TooFewCorrespondences,
    /// The pairs determine no finite pose.
    Singular,
}

impl StopReason {
    /// The name in reports and files.
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

    /// Whether the pose found is worth nothing.
    pub fn is_failure(self) -> bool {
        matches!(self, Self::TooFewCorrespondences | Self::Singular)
    }
}

/// What one iteration did.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct IterationTrace {
    /// Pose of the sensed scan in the reference frame after the iteration.
    pub pose: Pose2,
    /// Sensed points that took part.
    pub rays: u32,
    /// Of those, the ones with a partner.
    pub correspondences: u32,
    /// Of those, the ones left after rejection.
    pub inliers: u32,
    /// Mean absolute error of the inliers before the step, m.
    pub mean_residual: f64,
    /// Identity of the set of pairs: equal when the pairs are.
    fingerprint: Option<u64>,
}

/// What is known of a pose beforehand, from elsewhere.
#[derive(Clone, Copy, Debug)]
pub struct Prior {
    /// Pose of the sensed laser in the reference frame.
    pub pose: Pose2,
    /// Its covariance, m, m, rad.
    pub covariance: PoseCovariance,
}

impl Prior {
    /// How far a pose is from this one, in standard deviations (Mahalanobis 1936).
    pub(crate) fn deviation(&self, pose: &Pose2) -> f64 {
        let offset = self.pose.difference(pose);
        self.covariance.try_inverse().map_or(0.0, |information| offset.dot(&(information * offset)).sqrt())
    }
}

/// Where a match begins.
#[derive(Clone, Copy, Debug)]
pub struct FirstGuess {
    /// Pose of the sensed laser in the reference frame.
    pub pose: Pose2,
    /// What weighs against what the scans say.
    pub prior: Option<Prior>,
    /// Where else to look.
    pub window: SearchWindow,
}

/// Where to look for a better pose than the one that the first guess led to.
#[derive(Clone, Copy, Debug)]
pub struct SearchWindow {
    /// To either side, forward and back, m.
    pub distance: f64,
    /// To either side, rad.
    pub angle: f64,
    /// Look there where a smaller part of the rays agrees: more than 1 is always.
    pub doubtful_agreement: f64,
}

impl Default for SearchWindow {
    /// Twice the error that tracking copes with.
    fn default() -> Self {
        Self { distance: 0.3, angle: 0.35, doubtful_agreement: 0.9 }
    }
}

/// A guess that is no more than a place to start from.
impl From<Pose2> for FirstGuess {
    fn from(pose: Pose2) -> Self {
        Self { pose, prior: None, window: SearchWindow::default() }
    }
}

/// Matches scans; keeps the memory that takes between them.
pub struct Matcher {
    knobs: MatchingKnobs,
    pairing: Box<dyn Pairing>,
    metric: Metric,
    /// The solver.
    minimise: fn(&QuadraticForm, &Pose2) -> Option<Pose2>,
    search: Search,
    /// Number of rays asked for when they were chosen; 0: not yet.
    rays_chosen: usize,
    trace: Vec<IterationTrace>,
}

impl Matcher {
    /// Another limit of the iterations of one match.
    pub fn set_max_iterations(&mut self, limit: u32) {
        self.knobs.max_iterations = limit;
        self.trace = Vec::with_capacity(STAGES * limit as usize); // no match allocates
    }

    /// A matcher with these knobs.
    pub fn new(knobs: &MatchingKnobs, rejection: &RejectionKnobs) -> Self {
        let noise = knobs.range_noise;
        let solver = if knobs.correspondence.serves(knobs.solver) { knobs.solver } else { SolverKind::PointToLine };
        let pairing: Box<dyn Pairing> = match knobs.correspondence.search() {
            Some(search) => Box::new(ClosestPoint::new(search, rejection, knobs.max_correspondence_distance, noise)),
            None => Box::new(Projective::new(noise)),
        };
        Self {
            pairing,
            metric: solver.metric(),
            minimise: solver.function(),
            search: Search::default(),
            rays_chosen: 0,
            trace: Vec::with_capacity(STAGES * knobs.max_iterations as usize),
            knobs: knobs.clone(),
        }
    }

    /// The same, but it learns from the scans it prepares how much ranges err. To a single match that makes uneven walls less precise than
    /// they are; along a path it keeps errors that neighbouring rays share from being taken for knowledge, again and again.
    #[must_use]
    pub fn learning_noise(mut self) -> Self {
        self.pairing.learn_noise();
        self
    }

    /// Prepares a scan to be matched to.
    pub fn view(&mut self, scan: Scan) -> Arc<View> {
        Arc::new(self.pairing.view(scan))
    }

    /// Sets the scan that the next ones are matched to.
    pub fn set_reference(&mut self, scan: &Scan) {
        let view = self.view(scan.clone());
        self.set_views(&[PlacedView::at_origin(view)]);
    }

    /// Sets what the next scans are matched to: the first view's frame is the reference frame.
    pub fn set_views(&mut self, views: &[PlacedView]) {
        self.pairing.set_views(views);
    }

    /// Starts to match a scan. `first_guess`: pose of the sensed laser in the reference laser's frame.
    pub fn begin<'a>(&'a mut self, sensed: &'a Scan, first_guess: impl Into<FirstGuess>) -> Refinement<'a> {
        let first_guess = first_guess.into();
        let all_if_zero = |count: u32| if count == 0 { usize::MAX } else { count as usize };
        let finest = all_if_zero(self.knobs.max_rays).min(sensed.valid_len());
        let coarsest = all_if_zero(self.knobs.coarse_rays);
        self.trace.clear();
        self.pairing.begin(&first_guess);
        self.pairing.sense(sensed);
        self.rays_chosen = 0;
        let mut refinement = Refinement {
            matcher: self,
            scan: sensed,
            finest,
            next_rays: 0,
            level_start: 0,
            first_guess,
            pose: first_guess.pose,
            stopped: None,
            stage: Stage::Track,
            stage_start: 0,
        };
        refinement.use_rays(coarsest);
        refinement
    }
}

/// What a refinement is at. The later stages hold what tracking had come to, for when they find nothing better.
#[derive(Clone, Copy, Debug)]
enum Stage {
    /// From the first guess on.
    Track,
    /// The scans do not agree: from other starts.
    Search(Tracked),
    /// From the best of them.
    Confirm(Tracked),
}

/// A match under way.
pub struct Refinement<'a> {
    matcher: &'a mut Matcher,
    scan: &'a Scan,
    /// Rays of the last level.
    finest: usize,
    /// Rays of the next iteration: another number than the present one's where a new level begins.
    next_rays: usize,
    /// Index into the trace of the present level's first iteration.
    level_start: usize,
    first_guess: FirstGuess,
    pose: Pose2,
    stage: Stage,
    /// Index into the trace of the present stage's first iteration.
    stage_start: usize,
    stopped: Option<StopReason>,
}

impl Refinement<'_> {
    /// One iteration; does nothing once it has stopped. Answers why it stopped, `None` while there is more to gain.
    pub fn refine(&mut self) -> Option<StopReason> {
        if self.stopped.is_none() {
            self.stopped = match self.stage {
                Stage::Track => self.step().and_then(|outcome| self.review(outcome)),
                Stage::Search(tracked) => self.seek(tracked),
                Stage::Confirm(tracked) => self.step().map(|outcome| self.confirm(outcome, &tracked)),
            };
        }
        self.stopped
    }

    /// One iteration of the present level, and on to the next one when it is done; answers what ended the last.
    fn step(&mut self) -> Option<StopReason> {
        self.begin_level();
        match self.iterate() {
            Err(StopReason::IterationLimit) => Some(StopReason::IterationLimit),
            Err(_) if self.next_rays < self.finest => {
                self.use_rays(LEVEL_RATIO * self.next_rays);
                None
            }
            outcome => outcome.err(),
        }
    }

    /// What to do when tracking has come to an end: it may need a search.
    fn review(&mut self, outcome: StopReason) -> Option<StopReason> {
        let m = &mut *self.matcher;
        let Some(agreement) = m.pairing.agreement() else { return Some(outcome) };
        if !outcome.is_failure() && agreement.share() >= self.first_guess.window.doubtful_agreement {
            return Some(outcome);
        }
        m.search.begin(&self.first_guess);
        self.stage = Stage::Search(Tracked { pose: self.pose, width: m.pairing.width(), agreement, outcome });
        self.next_rays = SEARCH_RAYS.min(self.finest);
        self.begin_level();
        None
    }

    /// A part of the search: starts are scored, then each of the best is refined with few rays, then the best of those with all.
    fn seek(&mut self, tracked: Tracked) -> Option<StopReason> {
        let m = &mut *self.matcher;
        if m.search.score_some(&*m.pairing) {
            return None;
        }
        if let Some(start) = m.search.next_start() {
            let (pose, agreement) = m.refine_start(start);
            m.search.consider(pose, agreement);
            return None;
        }
        m.pairing.pair(&tracked.pose, m.metric);
        let before = m.pairing.agreement()?;
        let Some(found) = m.search.found(before, m.pairing.rays()) else { return Some(self.return_to(&tracked)) };
        self.pose = found;
        // What led astray must not pull the pose back there.
        let prior = self.first_guess.prior.map(|prior| Prior { covariance: prior.covariance * DISTRUST, ..prior });
        m.pairing.begin(&FirstGuess { pose: found, prior, ..self.first_guess });
        self.stage = Stage::Confirm(tracked);
        self.stage_start = m.trace.len();
        self.use_rays(self.finest);
        None
    }

    /// Whether what the search has found is better than what tracking had come to, now that it has been refined with all rays.
    fn confirm(&mut self, outcome: StopReason, tracked: &Tracked) -> StopReason {
        let agreement = self.matcher.pairing.agreement().unwrap_or_default();
        let is_likely = !outcome.is_failure() && agreement.share() > LIKELY_AGREEMENT;
        let deviation = self.first_guess.prior.map_or(0.0, |prior| prior.deviation(&self.pose));
        let is_better = is_likely && search::is_better(agreement, tracked.agreement, self.finest, deviation);
        if is_better { outcome } else { self.return_to(tracked) }
    }

    /// The search has found nothing better.
    fn return_to(&mut self, tracked: &Tracked) -> StopReason {
        self.stage = Stage::Track;
        self.pose = tracked.pose;
        self.next_rays = self.finest;
        self.begin_level();
        self.matcher.pair_again(&self.first_guess, tracked);
        // Pairs there are everywhere in sight; that they agree is what makes them correspondences.
        let agrees = tracked.agreement.share() >= self.matcher.knobs.min_correspondence_ratio;
        if agrees { tracked.outcome } else { StopReason::TooFewCorrespondences }
    }

    /// From the next iteration on about this many rays take part, as far as there are so many and they are allowed.
    pub fn use_rays(&mut self, count: usize) {
        // A level with nearly all rays is better taken with all.
        self.next_rays = if count > self.finest / 2 { self.finest } else { count };
    }

    /// Number of sensed rays that take part in the next iteration, or nearly so; of the search, as many as are as much work.
    pub fn next_rays(&self) -> usize {
        match self.stage {
            Stage::Search(_) => SEARCH_RAYS * (SEARCH_ITERATIONS + 1),
            Stage::Track | Stage::Confirm(_) => self.next_rays,
        }
    }

    /// Chooses the rays, where they are others than before.
    fn begin_level(&mut self) {
        let m = &mut *self.matcher;
        if m.rays_chosen == self.next_rays {
            return;
        }
        m.pairing.choose_rays(RayOrder::first(self.next_rays, self.scan.valid_len()));
        m.pairing.choose_views(if self.next_rays < self.finest { COARSE_VIEWS } else { usize::MAX });
        m.rays_chosen = self.next_rays;
        self.level_start = m.trace.len();
    }

    /// The whole of ICP.
    fn iterate(&mut self) -> Result<(), StopReason> {
        let m = &mut *self.matcher;
        let pairs = m.pairing.pair(&self.pose, m.metric).ok_or(StopReason::TooFewCorrespondences)?;
        let share = f64::from(pairs.correspondences) / m.pairing.rays() as f64;
        if share < m.knobs.min_correspondence_ratio || pairs.inliers < FEWEST_PAIRS {
            return Err(StopReason::TooFewCorrespondences);
        }
        let pose = m.solve(&pairs.form, &self.pose).ok_or(StopReason::Singular)?;
        let moved = self.pose.between(&pose);
        self.pose = pose;
        let earlier = m.record(pose, &pairs, self.level_start);
        let epsilons = if m.rays_chosen < self.finest { COARSE_EPSILONS } else { 1.0 };
        let (translation, rotation) = (epsilons * m.knobs.epsilon_translation, epsilons * m.knobs.epsilon_rotation);
        if pairs.settled && moved.distance() <= translation && moved.theta.abs() <= rotation {
            return Err(StopReason::Converged);
        }
        if let Some(start) = earlier {
            self.pose = m.best_since(start);
            return Err(StopReason::Cycle);
        }
        if m.trace.len() >= self.stage_start + m.knobs.max_iterations as usize {
            return Err(StopReason::IterationLimit);
        }
        Ok(())
    }

    /// The best pose so far of the sensed laser in the reference laser's frame: the first guess before the first iteration.
    pub fn pose(&self) -> Pose2 {
        self.pose
    }

    /// The pose that the match began with.
    pub fn first_guess(&self) -> Pose2 {
        self.first_guess.pose
    }

    /// What each iteration did so far.
    pub fn trace(&self) -> &[IterationTrace] {
        &self.matcher.trace
    }

    /// Number of sensed rays that carry a measurement.
    pub fn rays(&self) -> usize {
        self.scan.valid_len()
    }

    /// Whether other starts are being tried, because the scans agree too little at [`Self::pose`].
    pub fn is_searching(&self) -> bool {
        matches!(self.stage, Stage::Search(_))
    }

    /// Part of the rays that end where the reference has a surface, of those that end where it sees; `None` where pairs say nothing of
    /// that, as those with the nearest point do.
    pub fn agreement(&self) -> Option<f64> {
        self.matcher.pairing.agreement().map(Agreement::share)
    }

    /// The pairs of the last iteration as (sensed point moved to the pose, its partner), m, in the reference frame.
    pub fn matched_points(&self, points: &mut Vec<(Point, Point)>) {
        self.matcher.pairing.matched_points(&self.pose, points);
    }

    /// How well the pairs of the last iteration fix [`Self::pose`]; `None` before the first iteration.
    pub fn uncertainty(&mut self) -> Option<Uncertainty> {
        let m = &mut *self.matcher;
        m.trace.last()?;
        if let Stage::Search(tracked) = self.stage {
            m.pair_again(&self.first_guess, &tracked);
        }
        Some(m.pairing.uncertainty(&self.pose, m.metric))
    }
}

impl Matcher {
    /// What fits pairs that were made at a pose.
    fn solve(&self, form: &QuadraticForm, pose: &Pose2) -> Option<Pose2> {
        let best = (self.minimise)(form, pose).filter(Pose2::is_finite)?;
        // Two walls are fitted as well when all turns half round about their corner. Pairs are for what is near.
        let is_near = wrap_angle(best.theta - pose.theta).abs() < FRAC_PI_2;
        if is_near { Some(best) } else { SolverKind::Linearized.solve(form, pose) }
    }

    /// Some iterations from a start of the search.
    fn refine_start(&mut self, start: Pose2) -> (Pose2, Agreement) {
        let mut pose = start;
        self.pairing.begin(&start.into());
        for _ in 0..SEARCH_ITERATIONS {
            let pairs = self.pairing.pair(&pose, self.metric);
            let Some(next) = pairs.and_then(|pairs| self.solve(&pairs.form, &pose)) else { break };
            pose = next;
        }
        self.pairing.pair(&pose, self.metric);
        (pose, self.pairing.agreement().unwrap_or_default())
    }

    /// Pairs as tracking had last done, with the rays that take part now.
    fn pair_again(&mut self, first_guess: &FirstGuess, tracked: &Tracked) {
        self.pairing.begin(first_guess);
        self.pairing.set_width(tracked.width);
        self.pairing.pair(&tracked.pose, self.metric);
    }

    /// Adds to the trace; answers the earlier iteration with the same pairs, if there is one from `level_start` on.
    #[allow(clippy::cast_possible_truncation)] // a scan has at most 10 000 rays
    fn record(&mut self, pose: Pose2, pairs: &Pairs, level_start: usize) -> Option<usize> {
        let same = |iteration: &IterationTrace| pairs.fingerprint.is_some() && iteration.fingerprint == pairs.fingerprint;
        let earlier = self.trace.iter().enumerate().skip(level_start).find(|(_, iteration)| same(iteration)).map(|(i, _)| i);
        self.trace.push(IterationTrace {
            pose,
            rays: self.pairing.rays() as u32,
            correspondences: pairs.correspondences,
            inliers: pairs.inliers,
            mean_residual: pairs.mean_residual,
            fingerprint: pairs.fingerprint,
        });
        earlier
    }

    /// The pose before the iteration of smallest residual from `start` on.
    fn best_since(&self, start: usize) -> Pose2 {
        let best =
            (start + 1..self.trace.len()).min_by(|&a, &b| self.trace[a].mean_residual.total_cmp(&self.trace[b].mean_residual));
        self.trace[best.map_or(start, |i| i - 1)].pose
    }
}
