//! Matching a sensed scan to a reference scan by iterated closest point.
//!
//! The whole algorithm is [`Refinement::refine`]: correspondences, rejection, solve. [`Matcher::begin`] sets a match up, each
//! `refine` improves it, and [`Refinement::pose`] is the best pose so far at every moment: that makes it an anytime algorithm. No
//! clock is read here, nothing allocates once the buffers have grown to the size of the scans, nothing prints and nothing panics.

pub mod correspondence;
mod covariance;
mod ray_order;
pub mod reference;
pub mod rejection;
pub mod solver;

use crate::geometry::{Point, Pose2};
use crate::scan::Scan;
use correspondence::{Correspondence, CorrespondenceSearch, Nearest};
pub use covariance::Uncertainty;
use covariance::{Solution, UncertaintyEstimator};
use ray_order::RayOrder;
use reference::Reference;
use rejection::{Pair, Rejection, RejectionKnobs};
use solver::{Metric, QuadraticForm, Solver, SolverKind};

/// Pairs without which no pose is determined.
const FEWEST_PAIRS: usize = 3;
/// Each level of the coarse-to-fine schedule has so many times the rays of the one before.
const LEVEL_RATIO: usize = 4;
/// A coarse level is left when its steps are below this many epsilons: what remains, the finer one corrects anyway.
const COARSE_EPSILONS: f64 = 10.0;

crate::knobs! {
    /// How two scans are matched.
    pub struct MatchingKnobs {
        /// How the nearest reference ray of a point is found.
        correspondence: Correspondence = Correspondence::JumpTable;
        /// What is minimised, and how.
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
        epsilon_translation: f64 = 1e-4, in 0 to 1, unit "m";
        /// See `epsilon_translation`.
        epsilon_rotation: f64 = 1e-4, in 0 to 1, unit "rad";
        /// Least part of the sensed rays that must find a correspondence.
        min_correspondence_ratio: f64 = 0.2, in 0 to 1;
        /// Standard deviation of a range, for the covariance; where the residuals say more, they count.
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
    fingerprint: u64,
}

/// Matches scans; keeps the memory that takes between them.
pub struct Matcher {
    knobs: MatchingKnobs,
    search: Box<dyn CorrespondenceSearch>,
    solver: Box<dyn Solver>,
    rejection: Rejection,
    uncertainty: UncertaintyEstimator,
    reference: Reference,
    /// Number of rays asked for when `sensed` was chosen; 0: not yet.
    rays_chosen: usize,
    sensed: Vec<Point>,
    moved: Vec<Point>,
    nearest: Vec<Nearest>,
    pairs: Vec<Pair>,
    trace: Vec<IterationTrace>,
}

impl Matcher {
    /// A matcher with these knobs.
    pub fn new(knobs: &MatchingKnobs, rejection: &RejectionKnobs) -> Self {
        Self {
            search: knobs.correspondence.search(),
            solver: knobs.solver.solver(),
            rejection: Rejection::new(rejection.clone()),
            uncertainty: UncertaintyEstimator::default(),
            reference: Reference::default(),
            rays_chosen: 0,
            sensed: Vec::new(),
            moved: Vec::new(),
            nearest: Vec::new(),
            pairs: Vec::new(),
            trace: Vec::with_capacity(knobs.max_iterations as usize),
            knobs: knobs.clone(),
        }
    }

    /// Sets the scan that the next ones are matched to.
    pub fn set_reference(&mut self, scan: &Scan) {
        self.reference.set(scan);
        self.search.prepare(&self.reference);
    }

    /// Starts to match a scan. `first_guess`: pose of the sensed laser in the reference laser's frame.
    pub fn begin<'a>(&'a mut self, sensed: &'a Scan, first_guess: Pose2) -> Refinement<'a> {
        let all_if_zero = |count: u32| if count == 0 { usize::MAX } else { count as usize };
        let finest = all_if_zero(self.knobs.max_rays).min(sensed.valid_len());
        let coarsest = all_if_zero(self.knobs.coarse_rays);
        self.trace.clear();
        self.pairs.clear();
        self.rays_chosen = 0;
        let mut refinement = Refinement {
            matcher: self,
            scan: sensed,
            finest,
            next_rays: 0,
            level_start: 0,
            first_guess,
            pose: first_guess,
            stopped: None,
        };
        refinement.use_rays(coarsest);
        refinement
    }
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
    first_guess: Pose2,
    pose: Pose2,
    stopped: Option<StopReason>,
}

impl Refinement<'_> {
    /// One iteration; does nothing once it has stopped. Answers why it stopped, `None` while there is more to gain.
    pub fn refine(&mut self) -> Option<StopReason> {
        if self.stopped.is_none() {
            self.begin_level();
            match self.iterate() {
                Err(StopReason::IterationLimit) => self.stopped = Some(StopReason::IterationLimit),
                Err(_) if self.next_rays < self.finest => self.use_rays(LEVEL_RATIO * self.next_rays),
                outcome => self.stopped = outcome.err(),
            }
        }
        self.stopped
    }

    /// From the next iteration on about this many rays take part, as far as there are so many and they are allowed.
    pub fn use_rays(&mut self, count: usize) {
        // A level with nearly all rays is better taken with all.
        self.next_rays = if 2 * count > self.finest { self.finest } else { count };
    }

    /// Number of sensed rays that take part in the next iteration, or nearly so.
    pub fn next_rays(&self) -> usize {
        self.next_rays
    }

    /// Chooses the rays, where they are others than before.
    fn begin_level(&mut self) {
        let m = &mut *self.matcher;
        if m.rays_chosen == self.next_rays {
            return;
        }
        let order = RayOrder::first(self.next_rays, self.scan.valid_len());
        m.sensed.clear();
        let chosen = self.scan.rays().enumerate().filter(|(i, _)| order.contains(*i));
        m.sensed.extend(chosen.map(|(_, (_, direction, range))| direction * range));
        m.nearest.clear();
        m.nearest.resize(m.sensed.len(), Nearest::NONE);
        m.rays_chosen = self.next_rays;
        self.level_start = m.trace.len();
    }

    /// The whole of PL-ICP.
    fn iterate(&mut self) -> Result<(), StopReason> {
        let m = &mut *self.matcher;
        if m.reference.is_empty() {
            return Err(StopReason::TooFewCorrespondences);
        }
        let transform = self.pose.transform();
        m.moved.clear();
        m.moved.extend(m.sensed.iter().map(|&p| transform.apply(p)));
        m.search.find(&m.reference, &m.moved, m.knobs.max_correspondence_distance, &mut m.nearest);
        pair_up(&m.reference, &m.moved, &m.nearest, m.solver.metric(), &mut m.pairs);
        let correspondences = m.pairs.len();
        m.rejection.apply(&mut m.pairs, &m.nearest, m.reference.len());
        let share = correspondences as f64 / m.sensed.len() as f64;
        if share < m.knobs.min_correspondence_ratio || m.pairs.len() < FEWEST_PAIRS {
            return Err(StopReason::TooFewCorrespondences);
        }
        let pose = m.solver.solve(&m.quadratic_form(), &self.pose).ok_or(StopReason::Singular)?;
        let moved = self.pose.between(&pose);
        self.pose = pose;
        let earlier = m.record(pose, correspondences, self.level_start);
        let epsilons = if m.rays_chosen < self.finest { COARSE_EPSILONS } else { 1.0 };
        let (translation, rotation) = (epsilons * m.knobs.epsilon_translation, epsilons * m.knobs.epsilon_rotation);
        if moved.distance() <= translation && moved.theta.abs() <= rotation {
            return Err(StopReason::Converged);
        }
        if let Some(start) = earlier {
            self.pose = m.best_since(start);
            return Err(StopReason::Cycle);
        }
        if m.trace.len() >= m.knobs.max_iterations as usize {
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
        self.first_guess
    }

    /// What each iteration did so far.
    pub fn trace(&self) -> &[IterationTrace] {
        &self.matcher.trace
    }

    /// Number of sensed rays that carry a measurement.
    pub fn rays(&self) -> usize {
        self.scan.valid_len()
    }

    /// Points of the reference scan, m, in its laser's frame.
    pub fn reference_points(&self) -> &[Point] {
        self.matcher.reference.points()
    }

    /// The pairs of the last iteration as (sensed point moved to the pose, nearest reference point), m, in the reference laser's frame.
    pub fn matched_points(&self) -> impl Iterator<Item = (Point, Point)> + '_ {
        let transform = self.pose.transform();
        let m = &*self.matcher;
        m.pairs.iter().map(move |pair| (transform.apply(m.sensed[pair.sensed as usize]), m.reference.points()[pair.ray as usize]))
    }

    /// How well the pairs of the last iteration fix [`Self::pose`]; `None` before the first iteration.
    pub fn uncertainty(&mut self) -> Option<Uncertainty> {
        let m = &mut *self.matcher;
        let residual = m.trace.last()?.mean_residual;
        // The residual holds the noise of both scans; the mean of |e| is sqrt(2/pi) of a normal e's standard deviation.
        let observed_noise = residual * (std::f64::consts::PI / 4.0).sqrt();
        let solution = Solution {
            reference: &m.reference,
            sensed: &m.sensed,
            pairs: &m.pairs,
            pose: self.pose,
            metric: m.solver.metric(),
            range_noise: observed_noise.max(m.knobs.range_noise),
        };
        Some(m.uncertainty.estimate(&solution))
    }
}

impl Matcher {
    fn quadratic_form(&self) -> QuadraticForm {
        let mut form = QuadraticForm::default();
        for pair in &self.pairs {
            let p = self.sensed[pair.sensed as usize];
            match self.solver.metric() {
                Metric::PointToLine => {
                    let segment = self.reference.segment(pair.segment as usize);
                    form.add_line(p, segment.normal, segment.offset, 1.0);
                }
                Metric::PointToPoint => {
                    form.add(p, self.reference.points()[pair.ray as usize], &nalgebra::Matrix2::identity());
                }
            }
        }
        form
    }

    /// Adds to the trace; answers the earlier iteration with the same pairs, if there is one from `level_start` on.
    #[allow(clippy::cast_possible_truncation)] // a scan has at most 10 000 rays
    fn record(&mut self, pose: Pose2, correspondences: usize, level_start: usize) -> Option<usize> {
        let fingerprint = fingerprint(&self.pairs);
        let of_level = self.trace.iter().enumerate().skip(level_start);
        let earlier = of_level.clone().find(|(_, iteration)| iteration.fingerprint == fingerprint).map(|(i, _)| i);
        let sum: f64 = self.pairs.iter().map(|pair| pair.squared_error.sqrt()).sum();
        self.trace.push(IterationTrace {
            pose,
            rays: self.sensed.len() as u32,
            correspondences: correspondences as u32,
            inliers: self.pairs.len() as u32,
            mean_residual: sum / self.pairs.len() as f64,
            fingerprint,
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

/// Pairs each sensed point that has a nearest ray with the segment there.
#[allow(clippy::cast_possible_truncation)] // a scan has at most 10 000 rays
fn pair_up(reference: &Reference, moved: &[Point], nearest: &[Nearest], metric: Metric, pairs: &mut Vec<Pair>) {
    pairs.clear();
    for (i, (&point, found)) in moved.iter().zip(nearest).enumerate() {
        if !found.found() {
            continue;
        }
        let Some(segment) = reference.segment_at(found.ray as usize, point) else { continue };
        let squared_error = match metric {
            Metric::PointToLine => {
                let line = reference.segment(segment);
                (line.normal.dot(&point) - line.offset).powi(2)
            }
            Metric::PointToPoint => found.squared_distance,
        };
        pairs.push(Pair { sensed: i as u32, ray: found.ray, segment: segment as u32, squared_error });
    }
}

/// A hash of which points are paired (FNV-1a, by words).
fn fingerprint(pairs: &[Pair]) -> u64 {
    pairs.iter().fold(0xcbf2_9ce4_8422_2325, |hash, pair| {
        let word = u64::from(pair.sensed) << 32 | u64::from(pair.ray) << 1 | u64::from(pair.segment == pair.ray);
        (hash ^ word).wrapping_mul(0x0000_0100_0000_01b3)
    })
}
