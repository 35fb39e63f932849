//! A clock that is set while the robot drives.

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

use super::{Truth, at_truth, feed, process, shifted};
use crate::common::corridor;

/// The maximum position error in the second half of the time after the clock was set by `step` seconds, m, and the number of scans that were
/// not used.
fn driven_on(step: f64, with_odometry: bool) -> (f64, usize) {
    let mut settings = Settings::default();
    settings.drive.duration = Seconds(16.0);
    settings.lidar.rate = 20.0;
    let mut config = Config::default();
    config.localization.particles = 1000;
    let mut localizer = Localizer::new(corridor(), &config, Arc::new(VirtualClock::new(Duration::ZERO))).unwrap();
    let (mut truth, mut begin, mut worst, mut skipped) = (Truth::default(), None, 0.0_f64, 0);
    let mut held = None::<(LaserScan, Pose2)>;
    simulate::<Infallible>(&settings, &Scene::in_map(corridor(), 4).unwrap(), |time, message| {
        let seconds = time.seconds_since(*begin.get_or_insert(time));
        if with_odometry || !matches!(message, SimulatedMessage::Odometry(_)) {
            let message = if seconds > 8.0 { shifted(message, step) } else { message };
            let scan = feed(&mut localizer, message, &mut truth, at_truth);
            held = scan.map(|scan| (scan, truth.latest())).or(held.take());
        }
        // As in the node, a scan waits until its odometry has arrived.
        let is_due = |localizer: &Localizer, scan: &LaserScan| localizer.wait_for_inputs(&scan.header).is_none();
        if let Some((scan, truth)) = held.take_if(|(scan, _)| is_due(&localizer, scan)) {
            match process(&mut localizer, &scan) {
                Ok(_) if seconds < 12.0 => {}
                Ok(belief) => worst = worst.max(belief.map_from_base.between(&truth).distance()),
                Err(_) => skipped += 1,
            }
        }
        Ok(())
    })
    .unwrap();
    (worst, skipped)
}

#[test]
fn setting_the_clock_during_a_drive_does_no_harm() {
    for (step, with_odometry) in [
        (-0.6, true),
        (-0.9, true),
        (-1.5, true),
        (-100.0, true),
        (0.6, true),
        (-0.9, false),
        (0.6, false),
        (0.9, false),
        (1.5, false),
    ] {
        let (worst, skipped) = driven_on(step, with_odometry);
        eprintln!("clock set by {step} s, odometry: {with_odometry}: {worst:.3} m at most, {skipped} scans skipped");
        assert!(worst < 0.05 && skipped <= 1, "{step} s, {with_odometry}: {worst} m, {skipped} scans skipped");
    }
}
