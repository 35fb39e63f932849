//! A match as an anytime algorithm.

use super::contract::Contract;
use super::cost_model::Phase;
use super::{AnytimeAlgorithm, ErrorEstimate, RemainingBudget};
use crate::geometry::PoseCovariance;
use crate::matching::{Refinement, StopReason};

/// Number of iterations on the coarsest level that a budget should allow for.
const PLANNED_ITERATIONS: usize = 4;
/// Minimum number of rays to plan with: with fewer the pose is left to chance.
const MIN_RAYS: usize = 32;

/// Range of the convergence ratio from step to step: a smaller one is luck, a larger one would never end.
const CONVERGENCE_RATIOS: (f64, f64) = (0.5, 0.9);

impl AnytimeAlgorithm for Refinement<'_> {
    fn size(&self, phase: Phase) -> usize {
        if phase == Phase::Setup { self.rays() } else { self.next_rays() }
    }

    /// Starts with so few rays that some iterations fit into the time left. Finer levels follow as time allows.
    fn plan(&mut self, remaining: &RemainingBudget) {
        let fits = |rays: usize| {
            let mut pieces = [(Phase::Iteration, rays); PLANNED_ITERATIONS + 1];
            pieces[PLANNED_ITERATIONS].0 = Phase::Closing;
            remaining.fits(&pieces)
        };
        let mut rays = self.next_rays();
        while !fits(rays) && rays / 2 >= MIN_RAYS {
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
            let remaining_error = convergence_error(self);
            // The uncertainty takes longer to compute.
            contract.is_satisfied_by(remaining_error.translation, remaining_error.rotation) && {
                let covariance = self.uncertainty().and_then(|known| known.covariance);
                let error = estimated_error(self, covariance.as_ref());
                contract.is_satisfied_by(error.translation, error.rotation)
            }
        }
    }
}

/// Error of the current pose: sensor noise and remaining convergence error.
pub fn estimated_error(refinement: &Refinement, covariance: Option<&PoseCovariance>) -> ErrorEstimate {
    let Some(covariance) = covariance else { return ErrorEstimate::UNKNOWN };
    let (noise, remaining_error) = (ErrorEstimate::of_covariance(covariance), convergence_error(refinement));
    ErrorEstimate {
        translation: noise.translation.hypot(remaining_error.translation),
        rotation: noise.rotation.hypot(remaining_error.rotation),
    }
}

/// Remaining convergence error: closest-point iterations converge like a geometric series, with the ratio of the last two steps.
/// Unknown before the second step.
fn convergence_error(refinement: &Refinement) -> ErrorEstimate {
    let (before, between) = match refinement.trace() {
        [] | [_] => return ErrorEstimate::UNKNOWN,
        [first, _] => (refinement.first_guess(), first.pose),
        [.., before, between, _] => (before.pose, between.pose),
    };
    let (step_before, step) = (before.between(&between), between.between(&refinement.pose()));
    let remaining_error = |before: f64, last: f64| {
        let ratio = (last / before).clamp(CONVERGENCE_RATIOS.0, CONVERGENCE_RATIOS.1); // of NaN, 0 by 0, NaN
        if last > 0.0 { last * ratio / (1.0 - ratio) } else { 0.0 }
    };
    ErrorEstimate {
        translation: remaining_error(step_before.distance(), step.distance()),
        rotation: remaining_error(step_before.theta.abs(), step.theta.abs()),
    }
}
