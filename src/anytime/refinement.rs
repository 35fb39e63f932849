//! A match as work that can be stopped.

use super::contract::Contract;
use super::cost_model::Phase;
use super::{ErrorEstimate, Outlook, Work};
use crate::geometry::PoseCovariance;
use crate::matching::{Refinement, StopReason};

/// A budget should allow for this many iterations of the coarsest level.
const PLANNED_ITERATIONS: usize = 4;
/// Fewer rays than this are no plan: they leave the pose to chance.
const FEWEST_RAYS: usize = 32;

/// From step to step the way left shrinks by a ratio within these: faster is luck, slower would never end.
const RATIOS: (f64, f64) = (0.5, 0.9);

impl Work for Refinement<'_> {
    fn size(&self, phase: Phase) -> usize {
        if phase == Phase::Setup { self.rays() } else { self.next_rays() }
    }

    /// Begins with as few rays as it takes for some iterations to fit into the time left. Finer levels follow as time allows.
    fn plan(&mut self, outlook: &Outlook) {
        let fits = |rays: usize| {
            let mut pieces = [(Phase::Iteration, rays); PLANNED_ITERATIONS + 1];
            pieces[PLANNED_ITERATIONS].0 = Phase::Closing;
            outlook.allows_for(&pieces)
        };
        let mut rays = self.next_rays();
        while !fits(rays) && rays / 2 >= FEWEST_RAYS {
            rays /= 2;
        }
        if rays < self.next_rays() {
            self.use_rays(rays);
        }
    }

    fn step(&mut self) -> Option<StopReason> {
        self.refine()
    }

    fn is_good_enough(&mut self, contract: &Contract) -> bool {
        !self.is_searching() && {
            let rest = left_to_converge(self);
            // The uncertainty takes longer to compute.
            contract.is_satisfied_by(rest.translation, rest.rotation) && {
                let covariance = self.uncertainty().and_then(|known| known.covariance);
                let error = estimated_error(self, covariance.as_ref());
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
