//! A long drive with a fault every few seconds.

use std::io::Write;
use std::net::Shutdown;
use std::time::Duration;

use anytime_scan_matcher::app::App;
use anytime_scan_matcher::config::Config;
use anytime_scan_matcher::messages::nav_msgs::Odometry;
use anytime_scan_matcher::messages::sensor_msgs::LaserScan;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::bench::{Bench, Resources};
use crate::common::drive::LASER_IN_BASE;
use crate::common::wire::{Listener, Publisher, connect, frame};

const FAULTS: u32 = 7;
/// Tolerated change of open files: each of the master's three threads keeps a connection to the node, which takes two, and connections end.
const FILE_TOLERANCE: u64 = 8;

/// Injects one of the [`FAULTS`] faults.
fn fault(kind: u32, bench: &mut Bench, rng: &mut Pcg64) {
    match kind {
        0 => {
            bench.scans.shutdown(Shutdown::Both).unwrap();
            bench.scans = bench.lidar.link();
        }
        1 => {
            bench.scans.write_all(&u32::MAX.to_le_bytes()).unwrap();
            bench.scans = bench.lidar.link();
        }
        2 => {
            let silent = Publisher::new::<LaserScan>(&bench.graph, "/silent", "/scan");
            drop(silent.accept());
            silent.unregister(&bench.graph);
        }
        3 => {
            let mad = Publisher::new::<Odometry>(&bench.graph, "/mad", "/odom");
            let mut stream = mad.link();
            (0..100).for_each(|_| stream.write_all(&frame(&rng.random::<[u8; 16]>())).unwrap());
            mad.unregister(&bench.graph);
        }
        4 => drop(connect(&bench.graph, "/icp_report")),
        5 => drop(Listener::new(&bench.graph, "/scan_match_debug")),
        _ => {
            bench.graph.stop_master();
            bench.graph.start_master();
            bench.lidar.register(&bench.graph);
            let known = || bench.graph.call_master("lookupNode", &["/test", "/scan_matcher"]).contains("http://");
            assert!(crate::common::graph::eventually(known), "{}", bench.node.log());
        }
    }
}

/// Checks that every answer equals that of an undisturbed application, and that the node does not grow.
fn soak(scans: u32, fault_every: u32) {
    let Some(mut bench) = Bench::start(181) else { return };
    let mut config = Config::default();
    config.odometry.laser_in_base = Some(LASER_IN_BASE.into());
    let mut undisturbed =
        App::new(&config, std::sync::Arc::new(anytime_scan_matcher::anytime::clock::MonotonicClock::default())).unwrap();
    let mut rng = Pcg64::seed_from_u64(5);
    let mut early: Option<Resources> = None;
    for number in 1..=scans {
        let scan = bench.next_scan();
        let expected = undisturbed.on_scan(&scan, Duration::ZERO).registration.map_from_base();
        let (pose, _) = bench.answer(&scan);
        let error = pose.between(&expected);
        assert!(error.distance() < 1e-9 && error.theta.abs() < 1e-9, "scan {number}: {error:?}: {}", bench.node.log());
        if number % fault_every == 0 {
            fault((number / fault_every) % FAULTS, &mut bench, &mut rng);
        }
        if number == scans / 4 {
            early = Some(bench.resources());
        }
    }
    std::thread::sleep(Duration::from_secs(2)); // connections to peers that have left end
    let (early, late) = (early.unwrap(), bench.resources());
    eprintln!("{early:?}, at the end {late:?}");
    assert!(late.memory < early.memory + 2_000 && late.memory < 30_000, "{early:?} {late:?}");
    assert!(late.threads <= early.threads + 4 && late.files <= early.files + FILE_TOLERANCE, "{early:?} {late:?}");
}

#[test]
fn a_minute_of_faults() {
    soak(2400, 120);
}

/// An hour of scans: `cargo test --release --test live -- --ignored an_hour_of_faults --nocapture`.
#[test]
#[ignore = "takes ten minutes"]
fn an_hour_of_faults() {
    soak(144_000, 400);
}
