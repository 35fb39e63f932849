//! A controller that allows less time the faster it drives, in simulation, without ROS:
//! `cargo run --release --example controller_with_contracts --no-default-features --features cli`.
#![allow(clippy::print_stdout)] // an example speaks to its reader

use std::error::Error;
use std::sync::Arc;
use std::time::Duration;

use anytime_scan_matcher::anytime::clock::{Clock, MonotonicClock};
use anytime_scan_matcher::anytime::contract::Contract;
use anytime_scan_matcher::anytime::interrupt::Never;
use anytime_scan_matcher::app::{Answering as _, App};
use anytime_scan_matcher::config::Config;
use anytime_scan_matcher::simulation::built_in::BuiltIn;
use anytime_scan_matcher::simulation::drive::{Settings, SimulatedMessage, simulate};
use anytime_scan_matcher::simulation::scene::Scene;

/// 1 ms at rest, 0.1 ms at 5 m/s; 5 mm are good enough.
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
    app.warm_up()?; // learns what steps cost on this machine

    let (mut scans, mut late, mut slowest, mut off) = (0, 0, Duration::ZERO, 0.0);
    let mut truth = Vec::new();
    simulate::<Box<dyn Error>>(&Settings::default(), &Scene::built_in(BuiltIn::Corridor)?, |_time, message| {
        match message {
            SimulatedMessage::Mount(mount) => app.on_transforms(&mount)?,
            SimulatedMessage::Odometry(odometry) => app.on_odometry(&odometry)?,
            SimulatedMessage::Truth { map_from_base, .. } => truth.push(map_from_base),
            SimulatedMessage::Scan(scan) => {
                let mut estimate = app.on_scan(&scan, clock.now());
                // Here the pose would go to whoever steers. `conclude` takes the time.
                app.conclude(&mut estimate);
                app.set_contract(contract(estimate.registration.twist.vx)); // for the next scan
                app.maintain(&Never); // what can wait until the answer is out
                scans += 1;
                late += usize::from(!estimate.deadline_met());
                slowest = slowest.max(estimate.elapsed);
                // Both from where the car started.
                let driven = truth.first().zip(truth.last()).map(|(start, now)| start.between(now)).unwrap_or_default();
                off = driven.between(&estimate.registration.map_from_base()).distance();
            }
        }
        Ok(())
    })?;
    println!("{scans} scans, {late} late, the slowest answer took {slowest:?}, {:.1} mm off at the end", 1e3 * off);
    Ok(())
}
