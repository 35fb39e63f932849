//! The table of a policy: what error to expect of a time budget, and in which conditions. By the profile that the configuration names, else as
//! driven on this course and this machine.

use std::path::Path;
use std::time::Duration;

use super::closed_loop::{Setup, drive};
use super::{DriveError, EstimatorKind};
use crate::anytime::contract::Contract;
use crate::anytime::mode::{Mode, make_falling};
use crate::control::policy::{Policy, Table};
use crate::io::profile_file::Profile;
use crate::profile::variant::Variant;

/// Time budgets as parts of the scan period.
const PARTS: [f64; 7] = [0.025, 0.05, 0.1, 0.2, 0.4, 0.7, 1.0];
/// Laps that are profiled: bursts come at other places in each.
const LAPS: u32 = 4;

/// The table of a setup's estimator.
pub(super) fn table(setup: &Setup) -> Result<Table, DriveError> {
    let Some(path) = &setup.config.contract.profile else { return driven(setup) };
    let matching = &setup.config.matching;
    let variant = match setup.estimator {
        EstimatorKind::ParticleFilter => Variant::Filter,
        _ => Variant::Matcher { search: matching.correspondence, solver: matching.solver },
    };
    let profile = Profile::load(Path::new(path))?;
    let known = profile.variant(&variant.to_string())?;
    Ok(Table { modes: known.modes(), conditions: known.conditions })
}

/// Laps by the truth for each mode, at the speed and under the load that the table is for. The conditions are those of the longest budget.
fn driven(setup: &Setup) -> Result<Table, DriveError> {
    let drive_mode = |part: f64| {
        let delay = Duration::from_secs_f64(part / setup.lidar.rate);
        let contract = Contract { time_budget: Some(delay), ..Contract::default() };
        let profiled = Setup { policy: Policy::Fixed(contract), laps: LAPS, by_truth: true, ..setup.clone() };
        drive(&profiled).map(|run| (Mode { delay, error: run.noticed_error() }, run.conditions()))
    };
    let driven: Vec<_> = crate::parallel::map(PARTS.into_iter(), drive_mode).into_iter().collect::<Result<_, _>>()?;
    let conditions = driven.last().map(|(_, conditions)| *conditions).unwrap_or_default();
    let mut modes: Vec<Mode> = driven.into_iter().map(|(mode, _)| mode).collect();
    // What less time is better at is luck.
    let figures: [fn(&mut Mode) -> &mut f64; 2] = [|mode| &mut mode.error.translation, |mode| &mut mode.error.rotation];
    for figure in figures {
        let mut errors: Vec<f64> = modes.iter_mut().map(|mode| *figure(mode)).collect();
        make_falling(&mut errors);
        modes.iter_mut().zip(errors).for_each(|(mode, error)| *figure(mode) = error);
    }
    Ok(Table { modes, conditions })
}
