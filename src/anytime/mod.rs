//! Anytime operation: refine a match until its contract ends.

pub mod clock;
pub mod contract;
pub mod cost_model;
pub mod interrupt;

use std::time::Duration;

use clock::Clock;
use contract::Contract;
use cost_model::{CostModel, Phase};
use interrupt::Interrupt;

use crate::geometry::PoseCovariance;
use crate::matching::{Refinement, StopReason};

/// A budget should allow for this many iterations of the coarsest level.
const PLANNED_ITERATIONS: u32 = 4;
/// Fewer rays than this are no plan: they leave the pose to chance.
const FEWEST_RAYS: usize = 32;

/// From step to step the way left shrinks by a ratio within these: faster is luck, slower would never end.
const RATIOS: (f64, f64) = (0.5, 0.9);

/// A contract on one scan: its time counts from the scan's arrival.
#[derive(Clone, Copy, Debug)]
pub struct Task {
    /// What is asked for.
    pub contract: Contract,
    /// Reading of the clock when the scan arrived.
    pub arrival: Duration,
    /// Reading of the clock when the scan was taken up.
    pub taken_up: Duration,
}

impl Task {
    /// The reading of the clock by which the answer is due.
    pub fn deadline(&self) -> Option<Duration> {
        self.contract.time_budget.map(|budget| self.arrival.saturating_add(budget))
    }
}

/// Errors of an answer, one sigma.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ErrorEstimate {
    /// Of the position, m.
    pub translation: f64,
    /// Of the heading, rad.
    pub rotation: f64,
}

impl ErrorEstimate {
    /// Nothing is known.
    pub const UNKNOWN: Self = Self { translation: f64::INFINITY, rotation: f64::INFINITY };

    /// From a covariance.
    pub fn of_covariance(covariance: &PoseCovariance) -> Self {
        Self { translation: (covariance.m11 + covariance.m22).max(0.0).sqrt(), rotation: covariance.m33.max(0.0).sqrt() }
    }
}

/// Keeps the contract of one scan.
pub struct Driver<'a> {
    task: Task,
    clock: &'a dyn Clock,
    interrupt: &'a dyn Interrupt,
    costs: &'a mut CostModel,
    refined: Option<Duration>,
}

impl<'a> Driver<'a> {
    /// For one scan. `interrupt` may end its refinement early; `costs` says what is ahead, and learns.
    pub fn new(task: Task, clock: &'a dyn Clock, interrupt: &'a dyn Interrupt, costs: &'a mut CostModel) -> Self {
        Self { task, clock, interrupt, costs, refined: None }
    }

    /// Reading of the clock when the refinement was over; `None` while there has been none.
    pub fn refined(&self) -> Option<Duration> {
        self.refined
    }

    /// Refines until the match is done, good enough, called for, or out of time.
    ///
    /// An iteration is begun only when it and all that follows it still fit before the deadline, at the costs that the model guards
    /// against.
    pub fn drive(&mut self, refinement: &mut Refinement) -> StopReason {
        let mut now = self.clock.now();
        self.costs.observe(Phase::Setup, refinement.rays(), now.saturating_sub(self.task.taken_up));
        if let Some(deadline) = self.task.deadline() {
            self.plan(refinement, deadline.saturating_sub(now));
        }
        self.refined = Some(now);
        loop {
            let rays = refinement.next_rays();
            if self.interrupt.is_requested() {
                return StopReason::Interrupted;
            }
            if self.task.deadline().is_some_and(|deadline| now + self.cost_of_iteration_and_answer(rays) > deadline) {
                return StopReason::Budget;
            }
            let stop = refinement.refine();
            let before = std::mem::replace(&mut now, self.clock.now());
            self.costs.observe(Phase::Iteration, rays, now.saturating_sub(before));
            self.refined = Some(now);
            if let Some(reason) = stop {
                return reason;
            }
            if self.is_good_enough(refinement) {
                return StopReason::ErrorBound;
            }
        }
    }

    /// Begins with as few rays as it takes for some iterations to fit into the time left. Finer levels follow as time allows.
    fn plan(&self, refinement: &mut Refinement, left: Duration) {
        let fits = |rays: usize| {
            let all_but_the_last = self.costs.typical(Phase::Iteration, rays) * (PLANNED_ITERATIONS - 1);
            all_but_the_last + self.cost_of_iteration_and_answer(rays) <= left
        };
        let mut rays = refinement.next_rays();
        while !fits(rays) && rays / 2 >= FEWEST_RAYS {
            rays /= 2;
        }
        if rays < refinement.next_rays() {
            refinement.use_rays(rays);
        }
    }

    /// One of the two may be slow; that both are is as good as out of the question.
    fn cost_of_iteration_and_answer(&self, rays: usize) -> Duration {
        let slow = |phase| self.costs.guarded(phase, rays);
        let usual = |phase| self.costs.typical(phase, rays);
        let slow_iteration = slow(Phase::Iteration) + usual(Phase::Closing);
        slow_iteration.max(usual(Phase::Iteration) + slow(Phase::Closing))
    }

    fn is_good_enough(&self, refinement: &mut Refinement) -> bool {
        let contract = &self.task.contract;
        contract.has_error_bound() && !refinement.is_searching() && {
            let rest = left_to_converge(refinement);
            // The uncertainty takes longer to compute.
            contract.is_satisfied_by(rest.translation, rest.rotation) && {
                let covariance = refinement.uncertainty().and_then(|known| known.covariance);
                let error = estimated_error(refinement, covariance.as_ref());
                contract.is_satisfied_by(error.translation, error.rotation)
            }
        }
    }
}

/// Error of the pose reached so far: the noise of the scans, and what is left to converge.
pub fn estimated_error(refinement: &Refinement, covariance: Option<&PoseCovariance>) -> ErrorEstimate {
    let Some(covariance) = covariance else { return ErrorEstimate::UNKNOWN };
    let (noise, rest) = (ErrorEstimate::of_covariance(covariance), left_to_converge(refinement));
    ErrorEstimate { translation: noise.translation.hypot(rest.translation), rotation: noise.rotation.hypot(rest.rotation) }
}

/// How far the pose still has to go: closest-point iterations converge like a geometric series, whose ratio the last two steps show.
/// Unknown before the second one.
fn left_to_converge(refinement: &Refinement) -> ErrorEstimate {
    let (before, between) = match refinement.trace() {
        [] | [_] => return ErrorEstimate::UNKNOWN,
        [first, _] => (refinement.first_guess(), first.pose),
        [.., before, between, _] => (before.pose, between.pose),
    };
    let (step_before, step) = (before.between(&between), between.between(&refinement.pose()));
    let rest = |before: f64, last: f64| {
        let ratio = (last / before).clamp(RATIOS.0, RATIOS.1); // of NaN, 0 by 0, NaN
        if last > 0.0 { last * ratio / (1.0 - ratio) } else { 0.0 }
    };
    ErrorEstimate {
        translation: rest(step_before.distance(), step.distance()),
        rotation: rest(step_before.theta.abs(), step.theta.abs()),
    }
}
