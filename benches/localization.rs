//! Time of one update of the particle filter on one core: 4000 particles, 60 beams, on a real map. Measured in processor time, which
//! excludes other programs.
#![allow(missing_docs, clippy::unwrap_used, clippy::print_stderr)]

#[path = "../tests/common/mod.rs"]
mod common;

use std::convert::Infallible;
use std::sync::Arc;
use std::time::Duration;

use anytime_scan_matcher::anytime::clock::{Clock, ProcessorClock};
use anytime_scan_matcher::anytime::interrupt::NeverInterrupt;
use anytime_scan_matcher::app::ScanProcessor as _;
use anytime_scan_matcher::app::localizer::Localizer;
use anytime_scan_matcher::config::Config;
use anytime_scan_matcher::io::map_file;
use anytime_scan_matcher::raycasting::RayCasting;
use anytime_scan_matcher::simulation::drive::{Settings, SimulatedMessage, simulate};
use anytime_scan_matcher::simulation::scene::Scene;
use common::shared;

/// Times the updates of a drive. Repeating one update would find everything in the cache.
fn main() {
    let Some(path) = shared("data/maps/levine.yaml") else { return };
    let map = map_file::read(&path).unwrap();
    for &method in &[RayCasting::Cddt, RayCasting::Table, RayCasting::RayMarching] {
        let mut config = Config::default();
        config.localization.threads = 1;
        config.localization.ray_casting = Some(method);
        let mut localizer = Localizer::new(map.clone(), &config, Arc::new(ProcessorClock)).unwrap();
        let (mut times, mut started): (Vec<Duration>, bool) = (Vec::new(), false);
        let scene = Scene::in_map(map.clone(), 1).unwrap();
        simulate::<Infallible>(&Settings::default(), &scene, |_, message| {
            match message {
                SimulatedMessage::Mount(mount) => localizer.on_transforms(&mount).unwrap(),
                SimulatedMessage::Odometry(odometry) => localizer.on_odometry(&odometry).unwrap(),
                SimulatedMessage::Truth { map_from_base, .. } => {
                    if !std::mem::replace(&mut started, true) {
                        localizer.start_at(&map_from_base, None);
                    }
                }
                SimulatedMessage::Scan(scan) => {
                    let start = ProcessorClock.now();
                    localizer.on_scan(&scan, Duration::ZERO, &NeverInterrupt).belief.unwrap();
                    localizer.maintain(&NeverInterrupt);
                    times.push(ProcessorClock.now().saturating_sub(start));
                }
            }
            Ok(())
        })
        .unwrap();
        times.sort_unstable();
        let [min, median, p99, max] = [0, 50, 99, 100].map(|percent| times[(times.len() - 1) * percent / 100]);
        eprintln!("{}: {} updates, min {min:?}, p50 {median:?}, p99 {p99:?}, max {max:?}", method.name(), times.len());
    }
}
