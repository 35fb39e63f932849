//! Overload, and unreliable clocks.

use std::net::TcpStream;
use std::sync::LazyLock;
use std::time::{Duration, Instant};

use anytime_scan_matcher::app::planar_pose;
use anytime_scan_matcher::messages::geometry_msgs::PoseStamped;
use anytime_scan_matcher::messages::nav_msgs::Odometry;
use anytime_scan_matcher::messages::own::MatchReport;
use anytime_scan_matcher::messages::sensor_msgs::LaserScan;
use anytime_scan_matcher::messages::{Definition, Message, Time};
use speedy::{Readable, Writable};

use super::bench::{Bench, send};
use crate::common::drive::{self, MOUNT, PERIOD};
use crate::common::graph::{Graph, Process, TIMEOUT};
use crate::common::wire::Publisher;

/// Sends `count` scans, `period` apart; returns the report on the last one.
fn send_scans(bench: &mut Bench, count: u32, period: Duration) -> MatchReport {
    let start = Instant::now();
    let mut last = bench.next_scan();
    for number in 0..count {
        send(&mut bench.scans, &last);
        if number + 1 < count {
            last = bench.next_scan();
        }
        std::thread::sleep((start + period * (number + 1)).saturating_duration_since(Instant::now()));
    }
    bench.reports.find(|report: &MatchReport| report.header.stamp == last.header.stamp)
}

/// Checks that the first `sent` scans are answered or counted as dropped. The sequence number of an answer counts the answers.
fn check_accounts(report: &MatchReport, sent: u32) {
    eprintln!("{} of {sent} answered, {} dropped", report.header.seq, report.dropped);
    assert_eq!(report.header.seq + report.dropped, sent);
}

fn interrupt(mut node: Process) {
    node.signal("INT");
    assert_eq!(node.exit_code(TIMEOUT), Some(0), "{}", node.log());
}

#[test]
fn the_newest_scan_of_a_burst_is_answered_and_the_others_are_counted() {
    let Some(mut bench) = Bench::start(541) else { return };
    bench.step();
    let memory = bench.resources().memory;
    let mut sent = 1;
    for (count, hertz) in [(1000, 1e6), (200, 200.0), (1000, 1000.0), (1000, 1e6)] {
        let report = send_scans(&mut bench, count, Duration::from_secs_f64(1.0 / hertz));
        sent += count;
        check_accounts(&report, sent);
    }
    let grown = bench.resources().memory.saturating_sub(memory);
    assert!(grown < 8_000, "{grown} kB more");
    interrupt(bench.node);
}

/// As when a bag is played much faster than real time: messages arrive at once, and in any order.
#[test]
fn scans_that_arrive_at_once_and_before_their_odometry_are_all_in_the_map() {
    const SCANS: u32 = 40;
    let start = |graph: &Graph| {
        let mapper = graph.spawn(env!("CARGO_BIN_EXE_mapper"), &["__name:=scan_matcher", MOUNT, "_odometry/max_wait:=5"]);
        mapper.expect_log("; poses on ");
        mapper
    };
    let Some(mut bench) = Bench::start_with(541, start) else { return };
    let mut wheels = Publisher::new::<Odometry>(&bench.graph, "/wheels", "/odom").link();
    let mut time = 0.0;
    let mut tell = |time: &mut f64| {
        send(&mut wheels, &drive::odometry(*time));
        *time += PERIOD;
    };
    tell(&mut time);
    bench.step();
    let scans: Vec<LaserScan> = (0..SCANS).map(|_| bench.next_scan()).collect();
    for scan in &scans {
        send(&mut bench.scans, scan);
    }
    std::thread::sleep(Duration::from_millis(100)); // wait until the odometry is in transit
    (0..SCANS).for_each(|_| tell(&mut time));
    let last = scans[scans.len() - 1].header.stamp;
    let report = bench.reports.find(|report: &MatchReport| report.header.stamp == last);
    assert_eq!((report.header.seq, report.dropped), (SCANS + 1, 0));
    let pose = bench.poses.find(|pose: &PoseStamped| pose.header.stamp == last);
    let error = bench.truth().between(&planar_pose(&pose.pose).unwrap());
    assert!(error.distance() < 0.02, "{error:?}");
}

#[test]
fn floods_of_odometry_and_late_odometry_do_no_harm() {
    let Some(mut bench) = Bench::start(541) else { return };
    let mut wheels = Publisher::new::<Odometry>(&bench.graph, "/wheels", "/odom").link();
    let at_once = |from: f64, wheels: &mut TcpStream| {
        (0..1000).for_each(|i| send(wheels, &drive::odometry(from + f64::from(i) * 0.001)));
    };
    at_once(0.0, &mut wheels);
    let memory = bench.resources().memory;
    for _ in 0..40 {
        bench.step();
    }
    for second in 1..4 {
        at_once(f64::from(second), &mut wheels);
        (0..40).for_each(|_| bench.check_step());
    }
    for number in 80..160 {
        send(&mut wheels, &drive::odometry(f64::from(number) * PERIOD)); // of two seconds ago
        bench.check_step();
    }
    let grown = bench.resources().memory.saturating_sub(memory);
    assert!(grown < 8_000, "{grown} kB more");
    interrupt(bench.node);
}

/// `rosgraph_msgs/Clock`.
#[derive(Readable, Writable)]
struct ClockMessage {
    clock: Time,
}

impl Message for ClockMessage {
    const TYPE: &'static str = "rosgraph_msgs/Clock";

    fn definition() -> &'static Definition {
        static DEFINITION: LazyLock<Definition> = LazyLock::new(|| Definition::new(ClockMessage::TYPE, "time clock\n"));
        &DEFINITION
    }
}

#[test]
fn a_clock_that_jumps_or_stops_does_not_stop_the_node() {
    let start = |graph: &crate::common::graph::Graph| {
        graph.output("rosparam", &["set", "use_sim_time", "true"]);
        graph.node(&[MOUNT])
    };
    let Some(mut bench) = Bench::start_with(181, start) else { return };
    let mut clock = Publisher::new::<ClockMessage>(&bench.graph, "/clock_tower", "/clock").link();
    bench.step();
    for seconds in [0.0, 1e6, -1e6, 3.0] {
        send(&mut clock, &ClockMessage { clock: drive::at(seconds).into() });
        bench.check_step();
    }
    drop(clock);
    bench.check_step();
    interrupt(bench.node);
}
