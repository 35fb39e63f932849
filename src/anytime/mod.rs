//! Anytime operation: work on an answer until its contract ends.

pub mod clock;
pub mod contract;
pub mod cost_model;
pub mod interrupt;
pub mod mode;
mod preemption;
mod refinement;
pub mod timer;

use std::time::Duration;

use clock::Clock;
use contract::Contract;
use cost_model::{CostModel, Phase};
use interrupt::Interrupt;
pub use refinement::estimated_error;

use crate::geometry::PoseCovariance;
use crate::matching::StopReason;

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

/// Part of a time budget at most that is kept back for preemptions: late now and then is better than no match at all.
const MOST_RESERVED: u32 = 2;

/// The time that is left before a deadline, and what is known of costs.
#[derive(Clone, Copy)]
pub struct Outlook<'a> {
    costs: &'a CostModel,
    left: Duration,
    reserve: Duration,
}

impl<'a> Outlook<'a> {
    /// `left`: of the time budget.
    pub fn new(costs: &'a CostModel, left: Duration, time_budget: Duration) -> Self {
        Self { costs, left, reserve: costs.reserve().min(time_budget / MOST_RESERVED) }
    }

    /// Whether there is time for pieces of work of these sizes, with the contract's confidence.
    pub fn allows_for(&self, pieces: &[(Phase, usize)]) -> bool {
        self.costs.guarded_sum(pieces, self.reserve) < self.left
    }
}

/// Work on an answer, step by step; after every step there is an answer to be had.
pub trait Work {
    /// How much there is to do in a phase, of an iteration the next one: in rays, or what else its cost grows with.
    fn size(&self, phase: Phase) -> usize;

    /// Makes itself as small as it must be to be of use in time.
    fn plan(&mut self, outlook: &Outlook);

    /// The next step; if it was the last one, why.
    fn step(&mut self) -> Option<StopReason>;

    /// Whether the answer is within the error bounds of the contract. It has some.
    fn is_good_enough(&mut self, contract: &Contract) -> bool;
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
    /// For one scan. `interrupt` may end the work on it early; `costs` says what is ahead, and learns.
    pub fn new(task: Task, clock: &'a dyn Clock, interrupt: &'a dyn Interrupt, costs: &'a mut CostModel) -> Self {
        Self { task, clock, interrupt, costs, refined: None }
    }

    /// Reading of the clock when the last step was over; `None` while there has been none.
    pub fn refined(&self) -> Option<Duration> {
        self.refined
    }

    /// What there is time for from now on; `None`: there is no deadline.
    pub fn outlook(&self) -> Option<Outlook<'_>> {
        self.outlook_at(self.clock.now())
    }

    fn outlook_at(&self, now: Duration) -> Option<Outlook<'_>> {
        let (deadline, time_budget) = (self.task.deadline()?, self.task.contract.time_budget?);
        Some(Outlook::new(self.costs, deadline.saturating_sub(now), time_budget))
    }

    /// Works until it is done, good enough, called for, or out of time.
    ///
    /// A step is begun only when it and all that follows it still fit before the deadline, at the costs that the model guards against.
    pub fn drive(&mut self, work: &mut impl Work) -> StopReason {
        self.clock.worked(Phase::Setup, work.size(Phase::Setup));
        let mut now = self.clock.now();
        self.costs.observe(Phase::Setup, work.size(Phase::Setup), now.saturating_sub(self.task.taken_up));
        if let Some(outlook) = self.outlook_at(now) {
            work.plan(&outlook);
        }
        self.refined = Some(now);
        loop {
            let size = work.size(Phase::Iteration);
            if self.interrupt.is_requested() {
                return StopReason::Interrupted;
            }
            let step_and_answer = [(Phase::Iteration, size), (Phase::Closing, work.size(Phase::Closing))];
            if self.outlook_at(now).is_some_and(|outlook| !outlook.allows_for(&step_and_answer)) {
                return StopReason::Budget;
            }
            let stop = work.step();
            self.clock.worked(Phase::Iteration, size);
            let before = std::mem::replace(&mut now, self.clock.now());
            self.costs.observe(Phase::Iteration, size, now.saturating_sub(before));
            self.refined = Some(now);
            if let Some(reason) = stop {
                return reason;
            }
            let contract = &self.task.contract;
            if contract.has_error_bound() && work.is_good_enough(contract) {
                return StopReason::ErrorBound;
            }
        }
    }
}
