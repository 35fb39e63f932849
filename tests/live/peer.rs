//! A node of our own on the graph: this very test program, started once more with another task.

use std::process::Command;
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

use anytime_scan_matcher::ros::generated::anytime_scan_matcher::MatchReport;
use anytime_scan_matcher::ros::generated::geometry_msgs::PoseStamped;
use anytime_scan_matcher::ros::generated::sensor_msgs::LaserScan;
use anytime_scan_matcher::ros::generated::std_msgs::Empty;
use rosrust::api::Ros;

use crate::common::graph::{Graph, PATIENCE, Process};

/// Says to the program that it is a peer.
const TASK: &str = "SCAN_MATCHER_TEST_PEER";

/// Starts the peer that calls for answers by `icp_interrupt`, so long after each scan. [`latencies`] reads what it has found out.
pub fn interrupter(graph: &Graph, delay: Duration) -> Process {
    let mut command: Command = graph.command(std::env::current_exe().unwrap());
    command.args(["--exact", "peer::peer", "--ignored", "--nocapture"]).env(TASK, delay.as_micros().to_string());
    let peer = Process::spawn(command, graph.dir.path());
    peer.expect_log("ready");
    peer
}

/// Time from the interrupt to its pose, of the answers that were interrupted, in ascending order.
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
    // Nobody listens any more when the process is ending.
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
    while let Ok(stamp) = scans.recv_timeout(PATIENCE) {
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

/// The first message of those that come within a second that `is_it`.
fn find<T>(messages: &Receiver<T>, is_it: impl Fn(&T) -> bool) -> Option<T> {
    loop {
        let message = messages.recv_timeout(Duration::from_secs(1)).ok()?;
        if is_it(&message) {
            return Some(message);
        }
    }
}
