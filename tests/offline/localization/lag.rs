//! Odometry with a time offset to the scans, because drivers stamp messages at different times after the measurement.

use std::convert::Infallible;
use std::sync::Arc;
use std::time::Duration;

use anytime_scan_matcher::anytime::clock::VirtualClock;
use anytime_scan_matcher::app::ScanProcessor as _;
use anytime_scan_matcher::app::localizer::Localizer;
use anytime_scan_matcher::config::Config;
use anytime_scan_matcher::geometry::Pose2;
use anytime_scan_matcher::knobs::Seconds;
use anytime_scan_matcher::messages::sensor_msgs::LaserScan;
use anytime_scan_matcher::simulation::drive::{Settings, SimulatedMessage, simulate};
use anytime_scan_matcher::simulation::scene::Scene;
use anytime_scan_matcher::time::Stamp;

use super::{Truth, at_truth, feed, process, shifted};
use crate::common::corridor;

/// The messages of a drive in order, if odometry is stamped and arrives `late` seconds late.
fn messages(late: f64) -> Vec<SimulatedMessage> {
    let mut settings = Settings::default();
    settings.drive.duration = Seconds(40.0);
    settings.lidar.rate = 20.0;
    let mut messages: Vec<(Stamp, SimulatedMessage)> = Vec::new();
    simulate::<Infallible>(&settings, &Scene::in_map(corridor(), 4).unwrap(), |time, message| {
        let shift = if matches!(message, SimulatedMessage::Odometry(_)) { late } else { 0.0 };
        messages.push((time.offset_by(shift), shifted(message, shift)));
        Ok(())
    })
    .unwrap();
    messages.sort_by_key(|&(time, _)| time);
    messages.into_iter().map(|(_, message)| message).collect()
}

/// RMS of the position error in the second half of the drive, m, after some turns, and the estimated lag, s. A scan waits for its odometry
/// until the next scan arrives.
fn localized(late: f64) -> (f64, f64) {
    let mut config = Config::default();
    config.localization.particles = 1000;
    let mut localizer = Localizer::new(corridor(), &config, Arc::new(VirtualClock::new(Duration::ZERO))).unwrap();
    let (mut truth, mut held, mut errors) = (Truth::default(), None::<(LaserScan, Pose2)>, Vec::new());
    for message in messages(late) {
        let is_scan = matches!(message, SimulatedMessage::Scan(_));
        let can_wait = |scan: &LaserScan, localizer: &Localizer| localizer.wait_for_inputs(&scan.header).is_some();
        if let Some((scan, truth)) = held.take_if(|(scan, _)| is_scan || !can_wait(scan, &localizer)) {
            let error = process(&mut localizer, &scan).unwrap().map_from_base.between(&truth);
            errors.push(error.distance());
        }
        let scan = feed(&mut localizer, message, &mut truth, at_truth);
        held = scan.map(|scan| (scan, truth.latest())).or(held);
    }
    let after = &errors[errors.len() / 2..];
    ((after.iter().map(|error| error * error).sum::<f64>() / after.len() as f64).sqrt(), localizer.odometry_lag())
}

#[test]
fn odometry_stamped_early_or_late_is_as_good() {
    let (in_time, _) = localized(0.0);
    for late in [-0.2, 0.2] {
        let (error, lag) = localized(late);
        eprintln!("odometry {late} s late: {error:.4} m, in time {in_time:.4} m; lag {lag:.3} s");
        assert!((lag + late).abs() < 0.03 && error < 1.3 * in_time, "{late} s: {error} m after {in_time} m, lag {lag} s");
    }
}
