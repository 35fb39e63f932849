//! Practice before the first scan: the costs of an answer become known, and code and memory warm.

use std::convert::Infallible;
use std::sync::Arc;

use super::{Answering as _, App};
use crate::anytime::contract::ContractKnobs;
use crate::anytime::cost_model::CostModel;
use crate::anytime::interrupt::Never;
use crate::config::Config;
use crate::knobs::Seconds;
use crate::simulation::built_in::BuiltIn;
use crate::simulation::drive::{Settings, SimulatedMessage, simulate};
use crate::simulation::scene::Scene;

/// Length of the drive, s: some dozens of scans, which take about as many milliseconds.
const DURATION: f64 = 1.5;
/// Rays that are used at most, one practice after the other; 0: all. Answers from few rays must be known as well.
const RAYS: [u32; 4] = [32, 128, 512, 0];

/// The costs of matching a short simulated drive with the knobs of `app`, to completion.
pub(super) fn practise(app: &App) -> CostModel {
    let drive = simulated_drive();
    let mut costs = CostModel::new(app.intake.config.contract.confidence);
    for max_rays in RAYS {
        costs = practise_with(app, max_rays, &drive, costs);
    }
    costs
}

fn simulated_drive() -> Vec<SimulatedMessage> {
    let mut settings = Settings::default();
    settings.drive.duration = Seconds(DURATION);
    let mut messages = Vec::new();
    // The built-in room can be driven through; without it there would be nothing to practise on.
    if let Ok(scene) = Scene::built_in(BuiltIn::Room) {
        let Ok(()) = simulate(&settings, &scene, |_, message| {
            messages.push(message);
            Ok::<(), Infallible>(())
        });
    }
    messages
}

fn practise_with(app: &App, max_rays: u32, drive: &[SimulatedMessage], costs: CostModel) -> CostModel {
    let mut config = Config { contract: ContractKnobs::default(), ..app.intake.config.clone() };
    config.matching.max_rays = max_rays;
    let Ok(mut practice) = App::new(&config, Arc::clone(&app.intake.clock)) else { return costs };
    practice.intake.costs = costs;
    for message in drive {
        // Simulated messages are never rejected.
        match message {
            SimulatedMessage::Scan(scan) => {
                let mut estimate = practice.on_scan(scan, practice.intake.clock.now());
                practice.conclude(&mut estimate);
                practice.maintain(&Never);
            }
            SimulatedMessage::Odometry(odometry) => drop(practice.on_odometry(odometry)),
            SimulatedMessage::Mount(transforms) => drop(practice.on_transforms(transforms)),
            SimulatedMessage::Truth { .. } => {}
        }
    }
    practice.intake.costs
}
