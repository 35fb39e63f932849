//! Anytime algorithms: they refine an answer until their contract ends.

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

/// The contract of one scan: its time budget counts from the scan's arrival.
#[derive(Clone, Copy, Debug)]
pub struct ScanContract {
    /// Time budget and error bounds.
    pub contract: Contract,
    /// Clock reading when the scan arrived.
    pub arrival: Duration,
    /// Clock reading when processing of the scan started.
    pub started: Duration,
}

impl ScanContract {
    /// Clock reading at which the answer is due.
    pub fn deadline(&self) -> Option<Duration> {
        self.contract.time_budget.map(|budget| self.arrival.saturating_add(budget))
    }
}

/// Errors of a pose, one sigma.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ErrorEstimate {
    /// Position error, m.
    pub translation: f64,
    /// Heading error, rad.
    pub rotation: f64,
}

impl ErrorEstimate {
    /// The error is unknown.
    pub const UNKNOWN: Self = Self { translation: f64::INFINITY, rotation: f64::INFINITY };

    /// The errors according to a covariance.
    pub fn of_covariance(covariance: &PoseCovariance) -> Self {
        Self { translation: (covariance.m11 + covariance.m22).max(0.0).sqrt(), rotation: covariance.m33.max(0.0).sqrt() }
    }
}

/// At most this fraction (1/n) of a time budget is reserved for preemption: a late answer now and then is better than no match at
/// all.
const RESERVE_DIVISOR: u32 = 2;

/// The time left until the deadline, and the costs to expect.
#[derive(Clone, Copy)]
pub struct RemainingBudget<'a> {
    costs: &'a CostModel,
    time_left: Duration,
    reserve: Duration,
}

impl<'a> RemainingBudget<'a> {
    /// `time_left` is the part of `time_budget` that is left.
    pub fn new(costs: &'a CostModel, time_left: Duration, time_budget: Duration) -> Self {
        Self { costs, time_left, reserve: costs.reserve().min(time_budget / RESERVE_DIVISOR) }
    }

    /// Whether these pieces of work (phase and size) fit into the time left, with the contract's confidence.
    pub fn fits(&self, pieces: &[(Phase, usize)]) -> bool {
        self.costs.upper_bound_sum(pieces, self.reserve) < self.time_left
    }
}

/// An algorithm that works step by step and has an answer after every step.
pub trait AnytimeAlgorithm {
    /// Size of a phase, of the next one for iterations: the number of rays, or whatever else its cost grows with.
    fn size(&self, phase: Phase) -> usize;

    /// Reduces the work so that it fits into the time budget.
    fn plan(&mut self, remaining: &RemainingBudget);

    /// Makes the next step; returns the reason to stop if it was the last one.
    fn step(&mut self) -> Option<StopReason>;

    /// Whether the answer is within the error bounds of the contract, which has at least one.
    fn is_good_enough(&mut self, contract: &Contract) -> bool;
}

/// Runs an anytime algorithm under the contract of one scan.
pub struct ContractRunner<'a> {
    scan: ScanContract,
    clock: &'a dyn Clock,
    interrupt: &'a dyn Interrupt,
    costs: &'a mut CostModel,
    last_step_end: Option<Duration>,
}

impl<'a> ContractRunner<'a> {
    /// A runner for one scan. `interrupt` may stop it early; `costs` predicts the costs of steps and learns from them.
    pub fn new(scan: ScanContract, clock: &'a dyn Clock, interrupt: &'a dyn Interrupt, costs: &'a mut CostModel) -> Self {
        Self { scan, clock, interrupt, costs, last_step_end: None }
    }

    /// Clock reading at the end of the last step; `None` before the first one.
    pub fn last_step_end(&self) -> Option<Duration> {
        self.last_step_end
    }

    /// The budget that remains now; `None` if there is no deadline.
    pub fn remaining(&self) -> Option<RemainingBudget<'_>> {
        self.remaining_at(self.clock.now())
    }

    fn remaining_at(&self, now: Duration) -> Option<RemainingBudget<'_>> {
        let (deadline, time_budget) = (self.scan.deadline()?, self.scan.contract.time_budget?);
        Some(RemainingBudget::new(self.costs, deadline.saturating_sub(now), time_budget))
    }

    /// Runs the algorithm until it converges, is within the error bounds, is interrupted, or runs out of time.
    ///
    /// A step starts only if it and everything after it fit before the deadline, at the upper bound of their costs.
    pub fn run(&mut self, algorithm: &mut impl AnytimeAlgorithm) -> StopReason {
        self.clock.work_done(Phase::Setup, algorithm.size(Phase::Setup));
        let mut now = self.clock.now();
        self.costs.observe(Phase::Setup, algorithm.size(Phase::Setup), now.saturating_sub(self.scan.started));
        if let Some(remaining) = self.remaining_at(now) {
            algorithm.plan(&remaining);
        }
        self.last_step_end = Some(now);
        loop {
            let size = algorithm.size(Phase::Iteration);
            if self.interrupt.is_requested() {
                return StopReason::Interrupted;
            }
            let step_and_answer = [(Phase::Iteration, size), (Phase::Closing, algorithm.size(Phase::Closing))];
            if self.remaining_at(now).is_some_and(|remaining| !remaining.fits(&step_and_answer)) {
                return StopReason::Budget;
            }
            let stop = algorithm.step();
            self.clock.work_done(Phase::Iteration, size);
            let before = std::mem::replace(&mut now, self.clock.now());
            self.costs.observe(Phase::Iteration, size, now.saturating_sub(before));
            self.last_step_end = Some(now);
            if let Some(reason) = stop {
                return reason;
            }
            let contract = &self.scan.contract;
            if contract.has_error_bound() && algorithm.is_good_enough(contract) {
                return StopReason::ErrorBound;
            }
        }
    }
}
