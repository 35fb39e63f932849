//! Practice before the first scan: the costs of an answer become known, and code and memory warm.

use std::convert::Infallible;
use std::sync::Arc;

use super::App;
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

/// The costs of matching a short simulated drive with the knobs of `app`, run to completion. `None` where its knobs keep it from
/// starting at all.
pub(super) fn practise(app: &App) -> Option<CostModel> {
    let confidence = app.config.contract.confidence;
    let config = Config { contract: ContractKnobs { confidence, ..ContractKnobs::default() }, ..app.config.clone() };
    let mut practice = App::new(&config, Arc::clone(&app.clock)).ok()?;
    let mut settings = Settings::default();
    settings.drive.duration = Seconds(DURATION);
    let scene = Scene::built_in(BuiltIn::Room).ok()?;
    let Ok(()) = simulate(&settings, &scene, |_, message| {
        // What a simulated sensor says is never refused.
        match message {
            SimulatedMessage::Scan(scan) => {
                let mut estimate = practice.on_scan(&scan, practice.clock.now());
                practice.conclude(&mut estimate);
                practice.maintain(&Never);
            }
            SimulatedMessage::Odometry(odometry) => drop(practice.on_odometry(&odometry)),
            SimulatedMessage::Mount(transforms) => drop(practice.on_transforms(&transforms)),
            SimulatedMessage::Truth { .. } => {}
        }
        Ok::<(), Infallible>(())
    });
    Some(practice.costs)
}
