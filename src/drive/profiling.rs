//! The table of the table policy: the expected error by time budget, and the conditions it holds for. It is read from the
//! configured profile or, without one, measured on this course and machine.

use std::path::Path;
use std::time::Duration;

use super::closed_loop::{Setup, drive};
use super::{DriveError, EstimatorKind};
use crate::anytime::contract::Contract;
use crate::anytime::mode::{Mode, make_non_increasing};
use crate::control::policy::{Policy, Table};
use crate::io::profile_file::Profile;
use crate::profile::variant::Variant;

/// Time budgets to profile, as fractions of the scan period.
const BUDGET_FRACTIONS: [f64; 7] = [0.025, 0.05, 0.1, 0.2, 0.4, 0.7, 1.0];
/// Laps per profiled budget: bursts come at different positions in each lap.
const LAPS: u32 = 4;

/// The table for the estimator of a setup.
pub(super) fn table(setup: &Setup) -> Result<Table, DriveError> {
    let Some(path) = &setup.config.contract.profile else { return measure(setup) };
    let matching = &setup.config.matching;
    let variant = match setup.estimator {
        EstimatorKind::ParticleFilter => Variant::Filter,
        _ => Variant::Matcher { search: matching.correspondence, solver: matching.solver },
    };
    let profile = Profile::load(Path::new(path))?;
    let known = profile.variant(&variant.to_string())?;
    Ok(Table { modes: known.modes(), conditions: known.conditions })
}

/// Measures each mode over some laps, steered by the true poses, at the speed and under the load that the table is for. The
/// conditions are those of the longest budget.
fn measure(setup: &Setup) -> Result<Table, DriveError> {
    let drive_mode = |fraction: f64| {
        let delay = Duration::from_secs_f64(fraction / setup.lidar.rate);
        let contract = Contract { time_budget: Some(delay), ..Contract::default() };
        let profiled = Setup { policy: Policy::Fixed(contract), laps: LAPS, steer_by_truth: true, ..setup.clone() };
        drive(&profiled).map(|run| (Mode { delay, error: run.lateral_and_heading_error() }, run.conditions()))
    };
    let measured: Vec<_> =
        crate::parallel::map(BUDGET_FRACTIONS.into_iter(), drive_mode).into_iter().collect::<Result<_, _>>()?;
    let conditions = measured.last().map(|(_, conditions)| *conditions).unwrap_or_default();
    let mut modes: Vec<Mode> = measured.into_iter().map(|(mode, _)| mode).collect();
    // A smaller error with a smaller budget is chance: errors must not rise with the budget.
    let components: [fn(&mut Mode) -> &mut f64; 2] = [|mode| &mut mode.error.translation, |mode| &mut mode.error.rotation];
    for component in components {
        let mut errors: Vec<f64> = modes.iter_mut().map(|mode| *component(mode)).collect();
        make_non_increasing(&mut errors);
        modes.iter_mut().zip(errors).for_each(|(mode, error)| *component(mode) = error);
    }
    Ok(Table { modes, conditions })
}
