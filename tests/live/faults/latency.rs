//! Latency from sending a scan to receiving its pose, over loopback, compared with an echo: a roscpp node that answers each scan with a
//! pose, and raw bytes.

use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::time::{Duration, Instant};

use anytime_scan_matcher::messages::geometry_msgs::PoseStamped;
use anytime_scan_matcher::messages::sensor_msgs::LaserScan;

use super::bench::{Bench, send};
use super::roscpp::Echo;
use crate::common::graph::installed;
use crate::common::wire::Listener;

/// Sends scans at `hertz`; returns the latencies of those that were answered, in ascending order.
fn measure(scans: &[LaserScan], hertz: f64, link: &mut TcpStream, poses: &mut Listener) -> Vec<Duration> {
    let stamps: Vec<_> = scans.iter().map(|scan| scan.header.stamp).collect();
    let last = *stamps.last().unwrap();
    let (mut stream, scans) = (link.try_clone().unwrap(), scans.to_vec());
    let sender = std::thread::spawn(move || {
        let start = Instant::now();
        let send_one = |(number, scan): (u32, &LaserScan)| {
            let due = start + Duration::from_secs_f64(f64::from(number) / hertz);
            std::thread::sleep(due.saturating_duration_since(Instant::now()));
            let sent = Instant::now();
            send(&mut stream, scan);
            sent
        };
        (0..).zip(&scans).map(send_one).collect::<Vec<_>>()
    });
    let mut answers = Vec::new();
    while answers.last().is_none_or(|(stamp, _)| *stamp != last) {
        let pose: PoseStamped = poses.next();
        answers.push((pose.header.stamp, Instant::now()));
    }
    let sent = sender.join().unwrap();
    let sent_at = |stamp| sent[stamps.iter().position(|s| *s == stamp).unwrap()];
    let mut latencies: Vec<Duration> = answers.iter().map(|(stamp, came)| came.duration_since(sent_at(*stamp))).collect();
    latencies.sort_unstable();
    latencies
}

/// The latencies of a raw echo: it receives the bytes of a scan and returns as many as a pose has.
fn measure_echo(count: u32, hertz: f64, bytes: usize) -> Vec<Duration> {
    const POSE: usize = 100;
    let listener = TcpListener::bind("localhost:0").unwrap();
    let mut here = TcpStream::connect(listener.local_addr().unwrap()).unwrap();
    let (mut there, _) = listener.accept().unwrap();
    here.set_nodelay(true).unwrap();
    there.set_nodelay(true).unwrap();
    std::thread::spawn(move || {
        let mut scan = vec![0; bytes];
        while there.read_exact(&mut scan).is_ok() {
            there.write_all(&scan[..POSE]).unwrap();
        }
    });
    let once = |_| {
        std::thread::sleep(Duration::from_secs_f64(1.0 / hertz));
        let start = Instant::now();
        here.write_all(&vec![0; bytes]).unwrap();
        here.read_exact(&mut [0; POSE]).unwrap();
        start.elapsed()
    };
    let mut latencies: Vec<Duration> = (0..count).map(once).collect();
    latencies.sort_unstable();
    latencies
}

/// After this time the node started last polls the master at its normal rate.
const SETTLED: Duration = Duration::from_secs(3);

fn print(what: &str, latencies: &[Duration]) {
    let [median, tail, longest] = [50, 99, 100].map(|percent| latencies[(latencies.len() * percent).div_ceil(100) - 1]);
    eprintln!("{what}: {} answers, p50 {median:?}, p99 {tail:?}, max {longest:?}", latencies.len());
}

/// `at_least`: minimum number of answered scans, even on a busy machine.
fn compare(beams: usize, count: u32, hertz: f64, echo: Option<&Echo>, at_least: usize) {
    let Some(mut bench) = Bench::alone(beams) else { return };
    bench.step();
    std::thread::sleep(SETTLED);
    let scans: Vec<LaserScan> = (0..count).map(|_| bench.next_scan()).collect();
    let ours = measure(&scans, hertz, &mut bench.scans, &mut bench.poses);
    print(&format!("{beams} beams at {hertz} Hz"), &ours);
    if let Some(echo) = echo {
        let _running = echo.start(&bench.graph);
        let mut link = bench.lidar.link();
        print("  an echo by roscpp", &measure(&scans, hertz, &mut link, &mut Echo::listener(&bench.graph)));
    }
    print("  an echo of bare bytes", &measure_echo(count, hertz, 4 * beams));
    assert!(ours.len() > at_least, "{}", ours.len());
}

/// `slow` scans at 40 Hz, and `fast` scans at 1 kHz.
fn compare_at_both_rates(slow: u32, fast: u32) {
    if !installed("roscore") {
        return;
    }
    let echo = Echo::compile();
    compare(1081, slow, 40.0, echo.as_ref(), slow as usize * 3 / 4);
    compare(181, fast, 1000.0, echo.as_ref(), fast as usize * 3 / 40);
}

#[test]
fn latency_of_a_pose() {
    compare_at_both_rates(200, 2000);
}

/// For documented figures: `cargo test --test live -- --ignored latency --nocapture`.
#[test]
#[ignore = "takes a minute and a half"]
fn latency_of_a_pose_over_many_scans() {
    compare_at_both_rates(800, 4000);
}
