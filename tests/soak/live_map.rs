//! The cost of building a map while a car drives: a laser with 1080 beams at 40 Hz.

use std::convert::Infallible;
use std::sync::Arc;
use std::time::{Duration, Instant};

use anytime_scan_matcher::anytime::clock::MonotonicClock;
use anytime_scan_matcher::anytime::interrupt::NeverInterrupt;
use anytime_scan_matcher::app::sensed::SensorMessage;
use anytime_scan_matcher::app::{App, ScanProcessor as _};
use anytime_scan_matcher::config::Config;
use anytime_scan_matcher::geometry::Pose2;
use anytime_scan_matcher::io::bag::Bag;
use anytime_scan_matcher::knobs::Seconds;
use anytime_scan_matcher::mapping::{EvidenceGrid, LiveMap, Mapper};
use anytime_scan_matcher::messages::sensor_msgs::LaserScan;
use anytime_scan_matcher::simulation::built_in::BuiltIn;
use anytime_scan_matcher::simulation::drive::{Settings, SimulatedMessage, simulate};
use anytime_scan_matcher::simulation::scene::Scene;

use crate::common::shared;

/// Scans drawn at a time, as in the node.
const PORTION: usize = 16;

/// `SECONDS=600 cargo test --release --test soak live_map -- --nocapture` drives for ten minutes.
#[test]
fn mapping_takes_a_small_fraction_of_a_core() {
    let seconds = std::env::var("SECONDS").ok().and_then(|seconds| seconds.parse().ok()).unwrap_or(60.0);
    let mut settings = Settings::default();
    settings.drive.duration = Seconds(seconds);
    (settings.lidar.beams, settings.lidar.rate) = (1080, 40.0);
    let mut config = Config::default();
    // As in the node.
    (config.odometry.close_loops, config.odometry.max_keyframes) = (false, 100);
    let mut app = App::new(&config, Arc::new(MonotonicClock::default())).unwrap();
    let mut map = LiveMap::new(&config.matching, &config.rejection, 0.05);
    let (mut matching, mut adding, mut working, mut drawing, mut worst) = <[Duration; 5]>::default().into();
    let (mut scans, mut keyframes, mut distance) = (0_u32, 0_u32, 0.0);
    let mut last = None;
    let mut truth = Vec::new();
    simulate::<Infallible>(&settings, &Scene::built_in(BuiltIn::Corridor).unwrap(), |_, message| {
        match message {
            SimulatedMessage::Mount(message) => app.on_transforms(&message).unwrap(),
            SimulatedMessage::Odometry(message) => app.on_odometry(&message).unwrap(),
            SimulatedMessage::Scan(scan) => {
                scans += 1;
                let begun = Instant::now();
                let mut estimate = app.on_scan(&scan, begun.elapsed());
                app.conclude(&mut estimate);
                matching += begun.elapsed();
                let seen = app.posed_scan(&SensorMessage::Scan(scan), &estimate);
                app.maintain(&NeverInterrupt);
                let Some((posed_scan, measured)) = seen else { return Ok(()) };
                let pose = posed_scan.odom_from_base;
                let moved = last.map(|last: Pose2| last.between(&pose));
                if moved.is_some_and(|moved| moved.distance() < 0.05 && moved.theta.abs() < 0.05) {
                    return Ok(());
                }
                distance += moved.map_or(0.0, |moved| moved.distance());
                last = Some(pose);
                let begun = Instant::now();
                keyframes += u32::from(map.add(posed_scan, &measured));
                adding += begun.elapsed();
                worst = worst.max(begun.elapsed());
                let begun = Instant::now();
                map.work(PORTION);
                working += begun.elapsed();
                worst = worst.max(begun.elapsed());
                if scans.is_multiple_of(40) {
                    let begun = Instant::now();
                    drop(map.changed_grid().and_then(EvidenceGrid::to_map));
                    drawing += begun.elapsed();
                }
            }
            SimulatedMessage::Truth { map_from_base, .. } => truth.push(map_from_base),
        }
        Ok(())
    })
    .unwrap();
    let part = |time: Duration| 100.0 * time.as_secs_f64() / seconds;
    println!(
        "{scans} scans, {distance:.0} m, {keyframes} keyframes: matching {:.1} % of a core, keyframes and loops {:.1} %, drawing {:.1} %, \
         maps {:.1} %; longest portion {worst:?}",
        part(matching),
        part(adding),
        part(working),
        part(drawing)
    );
    let map_from_odom = map.map_from_odom();
    let start = truth[0];
    let end = truth[truth.len() - 1];
    let error = |pose: Pose2| start.between(&end).between(&pose);
    let odom = last.unwrap();
    println!("end: by odometry {:?}, on the map {:?}", error(odom), error(map_from_odom * odom));
    let begun = Instant::now();
    map.settle();
    println!("settled in {:?}, {:?}", begun.elapsed(), map.mapper().progress());
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    println!("{:?}", status.lines().find(|line| line.starts_with("VmRSS")));
    assert!(error(map_from_odom * odom).distance() < 0.1);
}

/// The live map of a real log, compared with the map built from it offline.
#[test]
fn the_live_map_of_a_real_log_equals_the_offline_map() {
    let Some(path) = shared("data/intel/intel.bag") else { return };
    let mut config = Config::default();
    (config.odometry.close_loops, config.odometry.max_keyframes) = (false, 100);
    let mut app = App::new(&config, Arc::new(MonotonicClock::default())).unwrap();
    let mut map = LiveMap::new(&config.matching, &config.rejection, 0.05);
    let mut afterwards = Mapper::new(&config.matching, &config.rejection);
    let bag = Bag::open(&path).unwrap();
    for message in bag.messages(None).map(Result::unwrap) {
        if message.connection.topic == "/odom" {
            app.on_odometry(&message.decode().unwrap()).unwrap();
            continue;
        }
        let scan: LaserScan = message.decode().unwrap();
        let estimate = app.on_scan(&scan, Duration::ZERO);
        let seen = app.posed_scan(&SensorMessage::Scan(scan), &estimate);
        app.maintain(&NeverInterrupt);
        let Some((posed_scan, measured)) = seen else { continue };
        afterwards.add(posed_scan.clone());
        map.add(posed_scan, &measured);
        map.work(PORTION);
    }
    map.settle();
    afterwards.finish();
    let poses = |mapper: &Mapper| mapper.graph().poses().to_vec();
    let (live, after) = (poses(map.mapper()), poses(&afterwards));
    let apart: Vec<f64> = live.iter().zip(&after).map(|(a, b)| (a.translation() - b.translation()).norm()).collect();
    let worst = apart.iter().copied().fold(0.0, f64::max);
    println!("{} keyframes, at most {worst:.3} m apart; {:?} {:?}", live.len(), map.mapper().progress(), afterwards.progress());
    assert!(live.len() == after.len() && worst < 0.3, "{worst}");
}
