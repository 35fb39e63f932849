//! Another node of our own on the graph: this test program, started again with another task.

use std::process::Command;
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

use rosrust::api::Ros;
use rosrust_msg::anytime_scan_matcher::MatchReport;
use rosrust_msg::geometry_msgs::PoseStamped;
use rosrust_msg::sensor_msgs::LaserScan;
use rosrust_msg::std_msgs::Empty;

use crate::common::graph::{Graph, Process, TIMEOUT};

/// Tells the program that it is a peer.
const TASK: &str = "SCAN_MATCHER_TEST_PEER";

/// Starts the peer that requests answers by `icp_interrupt`, `delay` after each scan. [`latencies`] reads its results.
pub fn interrupter(graph: &Graph, delay: Duration) -> Process {
    let mut command: Command = graph.command(std::env::current_exe().unwrap());
    command.args(["--exact", "peer::peer", "--ignored", "--nocapture"]).env(TASK, delay.as_micros().to_string());
    let peer = Process::spawn(command, graph.dir.path());
    peer.expect_log("ready");
    peer
}

/// Times from an interrupt to its pose, of the interrupted answers, in ascending order.
pub fn latencies(peer: &Process) -> Vec<Duration> {
    let log = peer.log();
    let microseconds = log.lines().filter_map(|line| line.strip_prefix("latency ")).map(|text| text.parse().unwrap());
    let mut latencies: Vec<Duration> = microseconds.map(Duration::from_micros).collect();
    latencies.sort_unstable();
    latencies
}

#[test]
#[ignore = "the other process of other tests"]
#[allow(clippy::print_stdout)]
fn peer() {
    let Ok(delay) = std::env::var(TASK) else { return };
    let delay = Duration::from_micros(delay.parse().unwrap());
    let ros = Ros::new("interrupter").unwrap();
    let interrupts = ros.publish::<Empty>("icp_interrupt", 10).unwrap();
    let (scan_sender, scans) = channel();
    let (pose_sender, poses) = channel();
    let (report_sender, reports) = channel();
    // There is no receiver when the process is ending.
    let _subscribers = (
        ros.subscribe("scan", 100, move |scan: LaserScan| {
            let _ = scan_sender.send(scan.header.stamp);
        })
        .unwrap(),
        ros.subscribe("scan_match_location", 100, move |pose: PoseStamped| {
            let _ = pose_sender.send((pose.header.stamp, Instant::now()));
        })
        .unwrap(),
        ros.subscribe("icp_report", 100, move |report: MatchReport| {
            let _ = report_sender.send(report);
        })
        .unwrap(),
    );
    println!("ready");
    while let Ok(stamp) = scans.recv_timeout(TIMEOUT) {
        std::thread::sleep(delay);
        let called = Instant::now();
        interrupts.send(Empty {}).unwrap();
        let Some((_, came)) = find(&poses, |(of, _)| *of == stamp) else { continue };
        let interrupted = find(&reports, |report| report.header.stamp == stamp).is_some_and(|r| r.stop_reason == "interrupted");
        if let (true, Some(latency)) = (interrupted, came.checked_duration_since(called)) {
            println!("latency {}", latency.as_micros());
        }
    }
}

/// The first message within a second for which `is_it` holds.
fn find<T>(messages: &Receiver<T>, is_it: impl Fn(&T) -> bool) -> Option<T> {
    loop {
        let message = messages.recv_timeout(Duration::from_secs(1)).ok()?;
        if is_it(&message) {
            return Some(message);
        }
    }
}
