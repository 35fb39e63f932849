//! Scans whose rays are measured one after the other.

use std::convert::Infallible;
use std::sync::Arc;
use std::time::Duration;

use anytime_scan_matcher::anytime::clock::VirtualClock;
use anytime_scan_matcher::app::localizer::Localizer;
use anytime_scan_matcher::config::Config;
use anytime_scan_matcher::knobs::Seconds;
use anytime_scan_matcher::simulation::drive::{Settings, simulate};
use anytime_scan_matcher::simulation::scene::Scene;

use super::{Truth, at_truth, feed, process};
use crate::common::corridor;

/// RMS of the position error at 7 m/s with sweeps of 45 ms, m.
fn rmse(deskew: bool) -> f64 {
    let mut settings = Settings::default();
    (settings.drive.duration, settings.vehicle.speed) = (Seconds(10.0), 7.0);
    (settings.lidar.rate, settings.lidar.scan_duration) = (20.0, Seconds(0.045));
    let mut config = Config::default();
    (config.localization.particles, config.odometry.deskew) = (1000, deskew);
    let mut localizer = Localizer::new(corridor(), &config, Arc::new(VirtualClock::new(Duration::ZERO))).unwrap();
    let (mut truth, mut errors) = (Truth::default(), Vec::new());
    simulate::<Infallible>(&settings, &Scene::in_map(corridor(), 4).unwrap(), |_, message| {
        if let Some(scan) = feed(&mut localizer, message, &mut truth, at_truth) {
            let belief = process(&mut localizer, &scan).unwrap();
            // The message arrives with the last ray, and is stamped with the first.
            let then = truth.at(scan.header.stamp.into());
            errors.push(belief.map_from_base.between(&then).distance().powi(2));
        }
        Ok(())
    })
    .unwrap();
    (errors.iter().sum::<f64>() / errors.len() as f64).sqrt()
}

#[test]
fn the_motion_during_a_sweep_does_not_shift_the_pose() {
    let (deskewed, raw) = (rmse(true), rmse(false));
    eprintln!("{deskewed:.3} m, without deskewing {raw:.3} m");
    assert!(deskewed < 0.05 && deskewed < 0.6 * raw, "{deskewed} m, without {raw} m");
}
