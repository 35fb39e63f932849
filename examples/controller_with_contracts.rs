//! A simulated controller that shortens the time budget as it drives faster, without ROS:
//! `cargo run --release --example controller_with_contracts --no-default-features --features cli`.
#![allow(clippy::print_stdout)] // an example prints its results

use std::error::Error;
use std::sync::Arc;
use std::time::Duration;

use anytime_scan_matcher::anytime::clock::{Clock, MonotonicClock};
use anytime_scan_matcher::anytime::contract::Contract;
use anytime_scan_matcher::anytime::interrupt::NeverInterrupt;
use anytime_scan_matcher::app::{App, ScanProcessor as _};
use anytime_scan_matcher::config::Config;
use anytime_scan_matcher::simulation::built_in::BuiltIn;
use anytime_scan_matcher::simulation::drive::{Settings, SimulatedMessage, simulate};
use anytime_scan_matcher::simulation::scene::Scene;

/// The contract at a speed in m/s: a budget of 1 ms at rest and of 0.1 ms from 5 m/s, and an error bound of 5 mm.
fn contract(speed: f64) -> Contract {
    let budget = (1.0 - 0.18 * speed.abs()).max(0.1);
    Contract {
        time_budget: Some(Duration::from_secs_f64(1e-3 * budget)),
        translation_error_bound: Some(0.005),
        rotation_error_bound: None,
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let clock: Arc<dyn Clock> = Arc::new(MonotonicClock::default());
    let mut app = App::new(&Config::default(), Arc::clone(&clock))?;
    app.warm_up()?; // learns the cost of each step on this machine

    let (mut scans, mut late, mut slowest, mut off) = (0, 0, Duration::ZERO, 0.0);
    let mut truth = Vec::new();
    simulate::<Box<dyn Error>>(&Settings::default(), &Scene::built_in(BuiltIn::Corridor)?, |_time, message| {
        match message {
            SimulatedMessage::Mount(mount) => app.on_transforms(&mount)?,
            SimulatedMessage::Odometry(odometry) => app.on_odometry(&odometry)?,
            SimulatedMessage::Truth { map_from_base, .. } => truth.push(map_from_base),
            SimulatedMessage::Scan(scan) => {
                let mut estimate = app.on_scan(&scan, clock.now());
                // Here the pose would be handed to the controller. `conclude` stops the clock.
                app.conclude(&mut estimate);
                app.set_contract(contract(estimate.registration.twist.vx)); // for the next scan
                app.maintain(&NeverInterrupt); // work that can wait until the answer is out
                scans += 1;
                late += usize::from(!estimate.deadline_met());
                slowest = slowest.max(estimate.elapsed);
                // Both poses are relative to the start of the car.
                let driven = truth.first().zip(truth.last()).map(|(start, now)| start.between(now)).unwrap_or_default();
                off = driven.between(&estimate.registration.map_from_base()).distance();
            }
        }
        Ok(())
    })?;
    println!("{scans} scans, {late} late, the slowest answer took {slowest:?}, {:.1} mm off at the end", 1e3 * off);
    Ok(())
}
