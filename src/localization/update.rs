//! Particles and beams that fit into the time there is; the search as work that can be stopped.

use super::model::Model;
use super::search::Search;
use super::streams::Streams;
use crate::anytime::contract::Contract;
use crate::anytime::cost_model::Phase;
use crate::anytime::{Outlook, Work};
use crate::matching::StopReason;

/// Of the beams wanted this part is to be cast; rather than fewer, particles are given up.
const LEAST_BEAMS: f64 = 0.25;
/// Fewer particles than this are no cloud.
const FEWEST_PARTICLES: usize = 100;
/// Looking for the robot all over the map, after an answer: bounded in itself, and in whole steps. The costs of these are not those of
/// following it, and nothing is planned by them.
pub(super) struct Searching<'a> {
    pub(super) search: &'a mut Search,
    pub(super) model: &'a Model,
    pub(super) streams: &'a mut Streams,
}

impl Work for Searching<'_> {
    fn size(&self, _phase: Phase) -> usize {
        0
    }

    fn plan(&mut self, _outlook: &Outlook) {}

    fn step(&mut self) -> Option<StopReason> {
        if self.search.has_work() {
            self.search.work(self.model, self.streams);
        }
        (!self.search.has_work()).then_some(StopReason::Converged)
    }

    fn is_good_enough(&mut self, _contract: &Contract) -> bool {
        false
    }
}

/// How many of `particles` there is time to move and to compare with a part of `beams`.
pub(super) fn particles_for(outlook: &Outlook, particles: usize, beams: usize) -> usize {
    let beams = ((beams as f64 * LEAST_BEAMS).ceil() as usize).max(1);
    let fits = |particles: usize| {
        let pieces = [(Phase::Setup, particles), (Phase::Iteration, particles * beams), (Phase::Closing, particles)];
        outlook.allows_for(&pieces)
    };
    let mut count = particles;
    while !fits(count) && count > FEWEST_PARTICLES {
        count = (count * 7 / 8).max(FEWEST_PARTICLES);
    }
    count
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;
    use crate::anytime::cost_model::CostModel;

    #[test]
    fn particles_are_given_up_as_the_time_is_short() {
        let mut costs = CostModel::new(0.999);
        for particles in [128, 1024, 4096] {
            costs.observe(Phase::Setup, particles, Duration::from_nanos(100) * u32::try_from(particles).unwrap());
            costs.observe(Phase::Iteration, 15 * particles, Duration::from_nanos(300) * u32::try_from(particles).unwrap());
            costs.observe(Phase::Closing, particles, Duration::from_nanos(100) * u32::try_from(particles).unwrap());
        }
        costs.learn();
        let planned = |microseconds| {
            let left = Duration::from_micros(microseconds);
            particles_for(&Outlook::new(&costs, left, left), 4000, 60)
        };
        assert_eq!([planned(5000), planned(2100), planned(1)], [4000, 4000, FEWEST_PARTICLES]);
        assert!((1700..=2000).contains(&planned(1000)), "{}", planned(1000));
        let (unknown, left) = (CostModel::new(0.9), Duration::from_nanos(1));
        assert_eq!(particles_for(&Outlook::new(&unknown, left, left), 4000, 60), 4000, "nothing is known yet");
    }
}
