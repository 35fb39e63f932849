//! Scans whose rays are taken one after the other.

use std::collections::BTreeMap;
use std::convert::Infallible;
use std::sync::Arc;
use std::time::Duration;

use anytime_scan_matcher::anytime::clock::VirtualClock;
use anytime_scan_matcher::app::Answering as _;
use anytime_scan_matcher::app::localizer::Localizer;
use anytime_scan_matcher::config::Config;
use anytime_scan_matcher::knobs::Seconds;
use anytime_scan_matcher::simulation::drive::{Settings, SimulatedMessage, simulate};
use anytime_scan_matcher::simulation::scene::Scene;
use anytime_scan_matcher::time::Stamp;

use super::{at_truth, take};
use crate::common::corridor;

/// Root mean square of the position's error at 7 m/s and 45 ms a sweep, m.
fn rmse(deskew: bool) -> f64 {
    let mut settings = Settings::default();
    (settings.drive.duration, settings.vehicle.speed) = (Seconds(10.0), 7.0);
    (settings.lidar.rate, settings.lidar.scan_duration) = (20.0, Seconds(0.045));
    let mut config = Config::default();
    (config.localization.particles, config.odometry.deskew) = (1000, deskew);
    let mut localizer = Localizer::new(corridor(), &config, Arc::new(VirtualClock::new(Duration::ZERO))).unwrap();
    let (mut truth, mut errors) = (BTreeMap::new(), Vec::new());
    simulate::<Infallible>(&settings, &Scene::in_map(corridor(), 4).unwrap(), |_, message| {
        match message {
            SimulatedMessage::Mount(mount) => localizer.on_transforms(&mount).unwrap(),
            SimulatedMessage::Odometry(odometry) => localizer.on_odometry(&odometry).unwrap(),
            SimulatedMessage::Truth { stamp, map_from_base } => {
                if truth.is_empty() {
                    at_truth(&mut localizer, map_from_base);
                }
                truth.insert(stamp, map_from_base);
            }
            SimulatedMessage::Scan(scan) => {
                let belief = take(&mut localizer, &scan).unwrap();
                // The message comes with the last ray, and is of the first.
                let (_, then) = truth.range(..=Stamp::from(scan.header.stamp)).next_back().unwrap();
                errors.push(belief.map_from_base.between(then).distance().powi(2));
            }
        }
        Ok(())
    })
    .unwrap();
    (errors.iter().sum::<f64>() / errors.len() as f64).sqrt()
}

#[test]
fn the_motion_during_a_sweep_does_not_shift_the_pose() {
    let (straightened, as_it_came) = (rmse(true), rmse(false));
    eprintln!("{straightened:.3} m, without deskewing {as_it_came:.3} m");
    assert!(straightened < 0.05 && straightened < 0.6 * as_it_came, "{straightened} m, without {as_it_came} m");
}
