//! The way of a scan to its answer, the same for all that answers scans.

use std::time::Duration;

use super::localizer::{Fix, Localizer};
use super::sensed::Sensed;
use super::{App, Estimate};
use crate::anytime::interrupt::Interrupt;

/// What answers scans, each within a contract.
pub trait Answering: Sized {
    /// The answer.
    type Answer;

    /// Takes a scan that arrived when the clock read `arrival`; [`Self::answer`] does all of its way.
    fn take_up(&mut self, scan: &Sensed, arrival: Duration) -> Self::Answer;

    /// Takes the time: what an answer is wanted for has been handed over.
    fn conclude(&mut self, answer: &mut Self::Answer);

    /// Work that can wait until an answer is out: the next scan is answered sooner and better for it. `next`: it is here.
    fn maintain(&mut self, next: &dyn Interrupt);

    /// Answers a scan that arrived when the clock read `arrival`. `hand_over` hands over what the answer is wanted for; the time is taken
    /// then. Everything else can be said of the answer before [`Answered::maintain`].
    fn answer(
        &mut self,
        scan: &Sensed,
        arrival: Duration,
        hand_over: impl FnOnce(&mut Self, &mut Self::Answer),
    ) -> Answered<'_, Self> {
        let mut answer = self.take_up(scan, arrival);
        hand_over(self, &mut answer);
        self.conclude(&mut answer);
        Answered { by: self, answer }
    }
}

/// An answer that is out, while what can be done at leisure has yet to be done.
#[must_use = "the next scan waits for what is not done now: call maintain"]
pub struct Answered<'a, A: Answering> {
    by: &'a mut A,
    answer: A::Answer,
}

impl<A: Answering> Answered<'_, A> {
    /// What has answered, and the answer.
    pub fn parts(&mut self) -> (&mut A, &A::Answer) {
        (self.by, &self.answer)
    }

    /// Does what could wait, until the `next` scan is here.
    pub fn maintain(self, next: &dyn Interrupt) -> A::Answer {
        self.by.maintain(next);
        self.answer
    }
}

impl Answering for App {
    type Answer = Estimate;

    fn take_up(&mut self, scan: &Sensed, arrival: Duration) -> Estimate {
        self.on_sensed(scan, arrival)
    }

    fn conclude(&mut self, estimate: &mut Estimate) {
        Self::conclude(self, estimate);
    }

    fn maintain(&mut self, next: &dyn Interrupt) {
        Self::maintain(self, next);
    }
}

impl Answering for Localizer {
    type Answer = Fix;

    fn take_up(&mut self, scan: &Sensed, arrival: Duration) -> Fix {
        self.on_sensed(scan, arrival)
    }

    fn conclude(&mut self, fix: &mut Fix) {
        Self::conclude(self, fix);
    }

    fn maintain(&mut self, next: &dyn Interrupt) {
        Self::maintain(self, next);
    }
}
