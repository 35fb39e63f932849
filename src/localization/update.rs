//! The number of particles that the time budget allows, and the global search as interruptible work.

use super::model::Model;
use super::search::Search;
use super::streams::Streams;
use crate::anytime::contract::Contract;
use crate::anytime::cost_model::Phase;
use crate::anytime::{AnytimeAlgorithm, RemainingBudget};
use crate::matching::StopReason;

/// Minimum fraction of the configured beams to process. If the time is short, the number of particles is reduced instead.
const MIN_BEAM_FRACTION: f64 = 0.25;
/// Minimum number of particles that represent a cloud.
const MIN_PARTICLES: usize = 100;

/// The global search as work after an answer. It is bounded in itself and proceeds in whole steps. Its costs differ from those of
/// tracking and are not used for planning.
pub(super) struct SearchWork<'a> {
    pub(super) search: &'a mut Search,
    pub(super) model: &'a Model,
    pub(super) streams: &'a mut Streams,
}

impl AnytimeAlgorithm for SearchWork<'_> {
    fn size(&self, _phase: Phase) -> usize {
        0
    }

    fn plan(&mut self, _remaining: &RemainingBudget) {}

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

/// Number of particles, at most `particles`, that there is time to move and to compare with the minimum fraction of `beams`.
pub(super) fn particles_for(remaining: &RemainingBudget, particles: usize, beams: usize) -> usize {
    let beams = ((beams as f64 * MIN_BEAM_FRACTION).ceil() as usize).max(1);
    let fits = |particles: usize| {
        let pieces = [(Phase::Setup, particles), (Phase::Iteration, particles * beams), (Phase::Closing, particles)];
        remaining.fits(&pieces)
    };
    let mut count = particles;
    while !fits(count) && count > MIN_PARTICLES {
        count = (count * 7 / 8).max(MIN_PARTICLES);
    }
    count
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;
    use crate::anytime::cost_model::CostModel;

    #[test]
    fn fewer_particles_are_used_when_time_is_short() {
        let mut costs = CostModel::new(0.999);
        for particles in [128, 1024, 4096] {
            costs.observe(Phase::Setup, particles, Duration::from_nanos(100) * u32::try_from(particles).unwrap());
            costs.observe(Phase::Iteration, 15 * particles, Duration::from_nanos(300) * u32::try_from(particles).unwrap());
            costs.observe(Phase::Closing, particles, Duration::from_nanos(100) * u32::try_from(particles).unwrap());
        }
        costs.learn();
        let planned = |microseconds| {
            let left = Duration::from_micros(microseconds);
            particles_for(&RemainingBudget::new(&costs, left, left), 4000, 60)
        };
        assert_eq!([planned(5000), planned(2100), planned(1)], [4000, 4000, MIN_PARTICLES]);
        assert!((1700..=2000).contains(&planned(1000)), "{}", planned(1000));
        let (unknown, left) = (CostModel::new(0.9), Duration::from_nanos(1));
        assert_eq!(particles_for(&RemainingBudget::new(&unknown, left, left), 4000, 60), 4000, "nothing is known yet");
    }
}
