//! A test bench: a node with one lidar, whose answer to each scan is checked.

use std::fs;
use std::io::Write;
use std::net::TcpStream;

use anytime_scan_matcher::app::planar_pose;
use anytime_scan_matcher::geometry::Pose2;
use anytime_scan_matcher::messages::geometry_msgs::PoseStamped;
use anytime_scan_matcher::messages::own::MatchReport;
use anytime_scan_matcher::messages::sensor_msgs::LaserScan;
use anytime_scan_matcher::messages::{Message, encode};

use crate::common::Laser;
use crate::common::drive::{self, MOUNT, PERIOD};
use crate::common::graph::{Graph, NODE, Process};
use crate::common::wire::{Listener, Publisher, frame};

pub struct Bench {
    pub node: Process,
    pub lidar: Publisher,
    pub scans: TcpStream,
    pub poses: Listener,
    pub reports: Listener,
    pub laser: Laser,
    next: u32,
    // Last: dropping it ends the master.
    pub graph: Graph,
}

impl Bench {
    /// `None` if ROS is not installed.
    pub fn start(beams: usize) -> Option<Self> {
        Self::start_with(beams, |graph| graph.node(&[MOUNT]))
    }

    /// Limits the address space of the node, kB.
    pub fn start_with_limit(beams: usize, kilobytes: u32) -> Option<Self> {
        Self::start_with(beams, |graph| {
            let script = format!("ulimit -v {kilobytes}; exec \"$0\" \"$@\"");
            let node = graph.spawn("sh", &["-c", &script, NODE, MOUNT]);
            node.expect_log("; poses on ");
            node
        })
    }

    /// With the machine to itself.
    pub fn alone(beams: usize) -> Option<Self> {
        Some(Self::on(Graph::alone()?, beams, |graph| graph.node(&[MOUNT])))
    }

    pub fn start_with(beams: usize, start: impl FnOnce(&Graph) -> Process) -> Option<Self> {
        Some(Self::on(Graph::start()?, beams, start))
    }

    fn on(graph: Graph, beams: usize, start: impl FnOnce(&Graph) -> Process) -> Self {
        let node = start(&graph);
        let lidar = Publisher::new::<LaserScan>(&graph, "/lidar", "/scan");
        let scans = lidar.link();
        let (poses, reports) = (Listener::new(&graph, "/scan_match_location"), Listener::new(&graph, "/icp_report"));
        let laser = Laser::with_field_of_view(270.0, beams);
        Self { node, lidar, scans, poses, reports, laser, next: 0, graph }
    }

    /// The next scan of the drive.
    pub fn next_scan(&mut self) -> LaserScan {
        let number = self.next;
        self.next += 1;
        drive::scan(number, f64::from(number) * PERIOD, self.laser)
    }

    /// The true pose of the car at the last scan.
    pub fn truth(&self) -> Pose2 {
        drive::base_pose(f64::from(self.next - 1) * PERIOD)
    }

    /// Sends the next scan and waits for its answer.
    pub fn step(&mut self) -> (Pose2, MatchReport) {
        let scan = self.next_scan();
        self.answer(&scan)
    }

    pub fn answer(&mut self, scan: &LaserScan) -> (Pose2, MatchReport) {
        send(&mut self.scans, scan);
        let report = self.reports.find(|report: &MatchReport| report.header.stamp == scan.header.stamp);
        let pose = self.poses.find(|pose: &PoseStamped| pose.header.stamp == scan.header.stamp);
        (planar_pose(&pose.pose).unwrap(), report)
    }

    /// Checks that the next scan is matched at the true pose.
    pub fn check_step(&mut self) {
        let (pose, report) = self.step();
        let error = pose.between(&self.truth());
        assert!(report.outcome == rosrust_msg::anytime_scan_matcher::MatchReport::MATCHED, "{report:?}: {}", self.node.log());
        assert!(error.distance() < 0.05 && error.theta.abs() < 0.05, "{error:?}");
    }

    pub fn resources(&self) -> Resources {
        Resources::of(self.node.id())
    }
}

pub fn send<T: Message>(stream: &mut TcpStream, message: &T) {
    stream.write_all(&frame(&encode(message).unwrap())).unwrap();
}

/// Resources used by a process.
#[derive(Clone, Copy, Debug)]
pub struct Resources {
    /// Resident, kB.
    pub memory: u64,
    pub threads: u64,
    pub files: u64,
}

impl Resources {
    pub fn of(process: u32) -> Self {
        let status = fs::read_to_string(format!("/proc/{process}/status")).unwrap();
        let number = |name: &str| {
            let line = status.lines().find(|line| line.starts_with(name)).unwrap();
            line.split_whitespace().nth(1).unwrap().parse().unwrap()
        };
        let files = fs::read_dir(format!("/proc/{process}/fd")).unwrap().count() as u64;
        Self { memory: number("VmRSS:"), threads: number("Threads:"), files }
    }
}
