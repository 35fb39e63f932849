//! Warm-up before the first scan: a simulated drive is matched, so that the costs of matching become known and code and memory
//! are warm.

use std::convert::Infallible;
use std::sync::Arc;

use super::{App, ScanProcessor as _};
use crate::anytime::contract::ContractKnobs;
use crate::anytime::cost_model::CostModel;
use crate::anytime::interrupt::NeverInterrupt;
use crate::config::Config;
use crate::knobs::Seconds;
use crate::simulation::built_in::BuiltIn;
use crate::simulation::drive::{Settings, SimulatedMessage, simulate};
use crate::simulation::scene::Scene;

/// Duration of the simulated drive, s: a few dozen scans, which take about as many milliseconds to match.
const DURATION: f64 = 1.5;
/// Limits of the rays used, one warm-up run for each; 0: no limit. The costs of matching few rays must be known, too.
const MAX_RAYS: [u32; 4] = [32, 128, 512, 0];

/// Measures the costs of matching a short simulated drive to convergence with the parameters of `app`.
pub(super) fn measure_costs(app: &App) -> CostModel {
    let drive = simulated_drive();
    let mut costs = CostModel::new(app.intake.config.contract.confidence);
    for max_rays in MAX_RAYS {
        costs = measure_costs_with(app, max_rays, &drive, costs);
    }
    costs
}

fn simulated_drive() -> Vec<SimulatedMessage> {
    let mut settings = Settings::default();
    settings.drive.duration = Seconds(DURATION);
    let mut messages = Vec::new();
    // The built-in room can always be driven. Without it there would be nothing to match.
    if let Ok(scene) = Scene::built_in(BuiltIn::Room) {
        let Ok(()) = simulate(&settings, &scene, |_, message| {
            messages.push(message);
            Ok::<(), Infallible>(())
        });
    }
    messages
}

fn measure_costs_with(app: &App, max_rays: u32, drive: &[SimulatedMessage], costs: CostModel) -> CostModel {
    let mut config = Config { contract: ContractKnobs::default(), ..app.intake.config.clone() };
    config.matching.max_rays = max_rays;
    let Ok(mut warm_up) = App::new(&config, Arc::clone(&app.intake.clock)) else { return costs };
    warm_up.intake.costs = costs;
    for message in drive {
        // Simulated messages are never rejected.
        match message {
            SimulatedMessage::Scan(scan) => {
                let mut estimate = warm_up.on_scan(scan, warm_up.intake.clock.now());
                warm_up.conclude(&mut estimate);
                warm_up.maintain(&NeverInterrupt);
            }
            SimulatedMessage::Odometry(odometry) => drop(warm_up.on_odometry(odometry)),
            SimulatedMessage::Mount(transforms) => drop(warm_up.on_transforms(transforms)),
            SimulatedMessage::Truth { .. } => {}
        }
    }
    warm_up.intake.costs
}
