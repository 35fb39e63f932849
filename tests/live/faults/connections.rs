//! Connections that break, stall or never start.

use std::net::TcpStream;
use std::time::{Duration, Instant};

use anytime_scan_matcher::messages::nav_msgs::Odometry;
use anytime_scan_matcher::messages::own::MatchReport;
use anytime_scan_matcher::messages::sensor_msgs::LaserScan;
use socket2::SockRef;

use super::bench::{Bench, send};
use crate::common::graph::eventually;
use crate::common::wire::{Listener, Publisher, connect};

#[test]
fn a_broken_connection_is_reconnected() {
    let Some(mut bench) = Bench::start(541) else { return };
    bench.step();
    for _ in 0..3 {
        bench.scans.shutdown(std::net::Shutdown::Both).unwrap();
        let broken = Instant::now();
        bench.scans = bench.lidar.link();
        eprintln!("connected again after {:.2} s", broken.elapsed().as_secs_f64());
        bench.check_step();
    }
    assert!(bench.node.log().contains("topic /scan: no connection to /lidar"), "{}", bench.node.log());
}

#[test]
fn silent_or_malformed_publishers_do_not_block_others() {
    let Some(mut bench) = Bench::start(541) else { return };
    bench.step();
    let silent = Publisher::new::<LaserScan>(&bench.graph, "/silent", "/scan");
    let _no_header = silent.accept();
    let _no_header_on_odometry = Publisher::new::<Odometry>(&bench.graph, "/silent_too", "/odom").accept();
    bench.check_step();
    let later = Publisher::new::<LaserScan>(&bench.graph, "/later", "/scan");
    bench.lidar.unregister(&bench.graph);
    bench.scans = later.link();
    bench.check_step();
    bench.node.expect_log("topic /scan: no connection to /silent");
}

#[test]
fn subscribers_that_do_not_read_and_silent_clients_do_not_block_others() {
    let Some(mut bench) = Bench::start(541) else { return };
    bench.step();
    let files = bench.resources().files;
    let stalled = Listener::new(&bench.graph, "/scan_match_debug");
    SockRef::from(&stalled.stream).set_recv_buffer_size(4096).unwrap();
    let half_open: Vec<_> = (0..2).map(|_| connect(&bench.graph, "/scan_match_debug")).collect();
    let half_open_service = TcpStream::connect(bench.graph.service_address("/scan_matcher/reset")).unwrap();
    assert!(bench.graph.trigger("/scan_matcher/reset").contains("initial pose"));
    let mut healthy = Listener::new(&bench.graph, "/scan_match_debug"); // behind those that send nothing
    let memory = bench.resources().memory;
    let received = std::thread::spawn(move || {
        let mut count = 0;
        while healthy.stream.set_read_timeout(Some(Duration::from_secs(2))).is_ok() && healthy.next_bytes().is_ok() {
            count += 1;
        }
        count
    });
    let scans = 400;
    for _ in 0..scans {
        std::thread::sleep(Duration::from_millis(5));
        let scan = bench.next_scan();
        send(&mut bench.scans, &scan);
        let _: MatchReport = bench.reports.find(|report: &MatchReport| report.header.stamp == scan.header.stamp);
    }
    let received = received.join().unwrap();
    eprintln!("{received} of {} markers", 3 * scans);
    assert!(received > 3 * scans * 9 / 10, "{received}");
    let grown = bench.resources().memory.saturating_sub(memory);
    assert!(grown < 8_000, "{grown} kB more");
    // All have been disconnected, although those that do not read are still connected on their side.
    let cut_off = || {
        bench.step();
        bench.resources().files <= files
    };
    assert!(eventually(cut_off), "{files} files, now {:?}", bench.resources());
    drop((stalled, half_open, half_open_service));
}
