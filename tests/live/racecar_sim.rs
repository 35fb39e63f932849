//! The matcher with a simulator that has the topics of `racecar_simulator`: it publishes the truth, and teleports the car.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io::Write as _;
use std::os::unix::fs::PermissionsExt as _;
use std::path::Path;
use std::thread;
use std::time::Duration;

use anytime_scan_matcher::app::planar_pose;
use anytime_scan_matcher::geometry::Pose2;
use anytime_scan_matcher::io::bag::Bag;
use anytime_scan_matcher::messages::ackermann_msgs::{AckermannDrive, AckermannDriveStamped};
use anytime_scan_matcher::messages::geometry_msgs::{PoseStamped, PoseWithCovarianceStamped, Twist, Vector3};
use anytime_scan_matcher::messages::nav_msgs::Odometry;
use anytime_scan_matcher::messages::sensor_msgs::LaserScan;
use anytime_scan_matcher::messages::tf2_msgs::TFMessage;
use anytime_scan_matcher::messages::{self, header_stamp};
use anytime_scan_matcher::time::Stamp;
use rosrust::RosMsg as _;
use rosrust_msg::anytime_scan_matcher::MatchReport;

use crate::common::drive::pose_message;
use crate::common::graph::{Graph, PACKAGE, Process, TIMEOUT, eventually};
use crate::common::skipped::skip;
use crate::common::wire::{Listener, Publisher, frame, publish};

/// The pose to which the simulator teleports the car, far from its current one.
const TELEPORT_TO: [Pose2; 2] = [Pose2 { x: 0.0, y: 6.1, theta: 3.1 }, Pose2 { x: 11.4, y: 0.0, theta: 1.57 }];

/// Minimum size of a recording that contains scans, bytes.
const RECORDED: u64 = 500_000;
/// Maximum gap without scans and odometry over which a matcher in a corridor can know the driven distance, s.
const MAX_GAP: f64 = 0.25;

/// The recorded poses of the car.
#[derive(Default)]
struct Drive {
    truth: BTreeMap<Stamp, Pose2>,
    found: BTreeMap<Stamp, Pose2>,
    failed: BTreeSet<Stamp>,
    parents: BTreeMap<String, BTreeSet<String>>,
    scans: Vec<LaserScan>,
}

impl Drive {
    fn read(bag: &Path) -> Self {
        let mut drive = Self::default();
        for message in Bag::open(bag).unwrap().messages(None) {
            let message = message.unwrap();
            match message.connection.topic.as_str() {
                "/odom" => {
                    let odometry: Odometry = message.decode().unwrap();
                    drive.truth.insert(odometry.header.stamp.into(), planar_pose(&odometry.pose.pose).unwrap());
                }
                "/scan_match_location" => {
                    let pose: PoseStamped = message.decode().unwrap();
                    assert_eq!(pose.header.frame_id, "map");
                    drive.found.insert(pose.header.stamp.into(), planar_pose(&pose.pose).unwrap());
                }
                "/icp_report" => {
                    let report = MatchReport::decode(&message.data[..]).unwrap();
                    if !report.ok {
                        drive.failed.insert(Stamp::from_ros(report.header.stamp.sec, report.header.stamp.nsec));
                    }
                }
                "/tf" => {
                    for transform in message.decode::<TFMessage>().unwrap().transforms {
                        drive.parents.entry(transform.child_frame_id).or_default().insert(transform.header.frame_id);
                    }
                }
                "/scan" => drive.scans.push(message.decode().unwrap()),
                _ => {}
            }
        }
        drive
    }

    /// Stamps of the first poses after a teleport, recognised by a speed that the car cannot reach.
    fn teleports(&self) -> Vec<Stamp> {
        let pairs = self.truth.iter().zip(self.truth.iter().skip(1));
        pairs.filter(|((_, a), (_, b))| a.between(b).distance() > 3.0).map(|(_, (stamp, _))| *stamp).collect()
    }

    /// The longest time without an answer, s.
    fn longest_gap(&self) -> f64 {
        let pairs = self.found.keys().zip(self.found.keys().skip(1));
        pairs.map(|(a, b)| b.seconds_since(*a)).fold(0.0, f64::max)
    }

    /// Answers between two times with the truth of their stamps.
    fn answers(&self, from: Stamp, to: Stamp) -> Vec<(Pose2, Pose2)> {
        let answers: Vec<_> =
            self.found.range(from..to).filter_map(|(stamp, pose)| Some((*pose, *self.truth.get(stamp)?))).collect();
        assert!(answers.len() > 20, "{} answers from {from} to {to}", answers.len());
        answers
    }
}

/// Maximum error of the answers, after alignment of the first one if `aligned`.
fn worst(answers: &[(Pose2, Pose2)], aligned: bool) -> f64 {
    let (first_found, first_truth) = answers[0];
    let offset = if aligned { first_truth * first_found.inverse() } else { Pose2::IDENTITY };
    answers.iter().map(|(found, truth)| truth.between(&(offset * *found)).distance()).fold(0.0, f64::max)
}

fn wait(seconds: f64) {
    thread::sleep(Duration::from_secs_f64(seconds));
}

/// Runs the launch file while the car drives by itself and is teleported twice; returns the recording.
fn drive(graph: &Graph, use_odom: &str) -> Drive {
    let launch: Process = graph
        .launch("racecar_simulator.launch", &["simulator:=built_in", "autopilot:=true", "rate:=200", "scan_rate:=100", use_odom]);
    launch.expect_log("simulating a racecar in corridor");
    launch.expect_log("from /tf");
    let recorder = graph.record(&["/scan", "/odom", "/scan_match_location", "/icp_report", "/tf"]);
    // The recording begins when its connections are established.
    let recording = graph.dir.path().join("recorded.bag.active");
    assert!(eventually(|| fs::metadata(&recording).is_ok_and(|file| file.len() > RECORDED)), "{}", recorder.log());
    wait(4.0);
    let mut message = PoseWithCovarianceStamped::default();
    message.pose.pose = pose_message(TELEPORT_TO[0]);
    publish(graph, "/initialpose", &message, 2); // simulator and matcher
    wait(4.0);
    publish(graph, "/pose", &PoseStamped { pose: pose_message(TELEPORT_TO[1]), ..PoseStamped::default() }, 1);
    wait(3.0);
    let drive = Drive::read(&graph.finish_recording(recorder));
    assert!(!launch.log().contains("stops publishing"), "it publishes no transform anyway: {}", launch.log());
    drive
}

#[test]
fn poses_are_right_with_a_simulator_that_teleports() {
    let Some(graph) = Graph::alone() else { return };
    for use_odom in ["use_odom:=true", "use_odom:=false"] {
        let drive = drive(&graph, use_odom);
        let gap = drive.longest_gap();
        if use_odom == "use_odom:=false" && gap > MAX_GAP {
            skip(&format!("this machine was too busy for {gap:.2} s ({use_odom})"));
            continue;
        }
        let [announced, unannounced] = drive.teleports()[..] else { panic!("{:?}", drive.teleports()) };
        let (start, end) = (*drive.found.keys().next().unwrap(), *drive.found.keys().last().unwrap());
        // It is unknown whether the car or the matcher receives the message first.
        let settle = 1.5;
        let before_answers = drive.answers(start, announced.offset_by(-settle));
        // The car drives before the matcher receives its first scan.
        let (start_offset, before) = (worst(&before_answers, false), worst(&before_answers, true));
        let announced_answers = drive.answers(announced.offset_by(settle), unannounced);
        // Between the two receptions the car keeps driving.
        let (reception_offset, after_announced) = (worst(&announced_answers, false), worst(&announced_answers, true));
        let after_unannounced = worst(&drive.answers(unannounced.offset_by(settle), end), true);
        let failed = drive.failed.range(start..announced.offset_by(-settle)).count()
            + drive.failed.range(unannounced.offset_by(settle)..).count();
        eprintln!(
            "{use_odom}: off by {:.1} mm, {:.1} mm after /initialpose ({:.1} mm from the time of reception), {:.1} mm after /pose, {failed} failed, at \
             most {gap:.2} s without an answer",
            1e3 * before,
            1e3 * after_announced,
            1e3 * reception_offset,
            1e3 * after_unannounced
        );
        assert!(
            before < 0.05 && start_offset < 5.0 && after_announced < 0.05 && reception_offset < 5.0 && after_unannounced < 0.05,
            "{use_odom}"
        );
        assert_eq!(failed, 0);
        let parent = |child: &str| drive.parents[child].iter().map(String::as_str).collect::<Vec<_>>();
        assert_eq!((parent("base_link"), parent("laser"), parent("icp_odom")), (vec!["map"], vec!["base_link"], vec!["map"]));
        assert_eq!(drive.parents.len(), 3);
        let scan = &drive.scans[0];
        assert_eq!((scan.ranges.len(), scan.scan_time.to_bits(), scan.time_increment.to_bits()), (1080, 0, 0));
    }
}

/// Sends `RViz`'s "2D Pose Estimate" repeatedly: simulator and matcher both receive it, one of them first.
fn set_poses(scan_rate: u32) {
    const TRIALS: usize = 40;
    let Some(graph) = Graph::start() else { return };
    let places = [TELEPORT_TO[0], Pose2::new(-11.5, 0.0, -1.57), TELEPORT_TO[1], Pose2::new(0.0, -6.1, 0.0)];
    let argument = format!("_scan_rate:={scan_rate}");
    let simulator = graph.spawn(env!("CARGO_BIN_EXE_racecar_sim"), &["_autopilot:=true", "_rate:=200", &argument]);
    simulator.expect_log("simulating a racecar in corridor");
    let node = graph.node(&["odom:=no_odom", "_odom_frame:=icp_odom"]);
    node.expect_log("from /tf");
    let speaker = Publisher::new::<PoseWithCovarianceStamped>(&graph, "/speaker", "/initialpose");
    let mut links = [speaker.link(), speaker.link()];
    let recorder = graph.record(&["/odom", "/scan_match_location"]);
    wait(1.0);
    for number in 0..TRIALS {
        let mut message = PoseWithCovarianceStamped::default();
        message.pose.pose = pose_message(places[number % places.len()]);
        let bytes = frame(&messages::encode(&message).unwrap());
        links.rotate_left(number % 2); // alternate which one receives it first
        for link in &mut links {
            link.write_all(&bytes).unwrap();
        }
        wait(0.4);
    }
    let drive = Drive::read(&graph.finish_recording(recorder));
    let teleports = drive.teleports();
    assert!(teleports.len() >= TRIALS - 1, "{} teleports", teleports.len()); // the car may already be there
    let errors: Vec<f64> = teleports
        .iter()
        .filter_map(|teleport| {
            let settled = drive.found.range(teleport.offset_by(0.2)..teleport.offset_by(0.38));
            let (found, truth) =
                settled.filter_map(|(stamp, pose)| Some((pose, interpolated(&drive.truth, *stamp)?))).next_back()?;
            Some(truth.between(found).distance())
        })
        .collect();
    let wrong = errors.iter().filter(|error| **error > 0.1).count();
    eprintln!(
        "{scan_rate} Hz: {wrong} of {} wrong, the worst by {:.3} m",
        errors.len(),
        errors.iter().copied().fold(0.0, f64::max)
    );
    assert!(errors.len() >= TRIALS - 4 && wrong == 0, "{errors:?}");
}

#[test]
fn poses_set_while_scans_are_in_transit_are_right() {
    set_poses(40);
}

#[test]
fn poses_set_at_a_high_scan_rate_are_right() {
    set_poses(200);
}

#[test]
fn poses_set_at_the_highest_scan_rate_are_right() {
    set_poses(1000);
}

/// The true pose of the car at a time.
fn interpolated(truth: &BTreeMap<Stamp, Pose2>, stamp: Stamp) -> Option<Pose2> {
    let (before, a) = truth.range(..=stamp).next_back()?;
    let (after, b) = truth.range(stamp..).next()?;
    let span = after.seconds_since(*before);
    Some(if span > 0.0 { a.interpolate(b, stamp.seconds_since(*before) / span) } else { *a })
}

/// The car stands still without commands, and drives with commands on either topic.
#[test]
fn the_simulator_obeys_drive_and_cmd_vel() {
    let Some(graph) = Graph::start() else { return };
    let mut simulator = graph.spawn(env!("CARGO_BIN_EXE_racecar_sim"), &["_world:=room", "_rate:=100", "_scan_rate:=20"]);
    simulator.expect_log("simulating a racecar in room");
    let recorder = graph.record(&["/odom"]);
    let forward = Twist { linear: Vector3 { x: 0.5, ..Vector3::default() }, angular: Vector3 { z: 0.3, ..Vector3::default() } };
    wait(1.0);
    publish(&graph, "/cmd_vel", &forward, 1);
    wait(2.0);
    let backward = AckermannDrive { speed: -0.4, steering_angle: 0.2, ..AckermannDrive::default() };
    publish(&graph, "/drive", &AckermannDriveStamped { drive: backward, ..AckermannDriveStamped::default() }, 1);
    wait(2.0);
    publish(&graph, "/cmd_vel", &Twist::default(), 1);
    wait(1.0);
    let truth: Vec<Pose2> = Drive::read(&graph.finish_recording(recorder)).truth.into_values().collect();
    let (first, last) = (truth[0], truth[truth.len() - 1]);
    let steps: Vec<Pose2> = truth.iter().zip(truth.iter().skip(1)).map(|(a, b)| a.between(b)).collect();
    let standing = |steps: &[Pose2]| steps.iter().all(|step| step.distance() < 1e-12);
    assert!(
        standing(&steps[..20]) && standing(&steps[steps.len() - 20..]),
        "at rest before the first command, and after the last"
    );
    let turn_per_metre = |forwards: bool| {
        let moving = steps.iter().filter(|step| if forwards { step.x > 1e-4 } else { step.x < -1e-4 });
        let (distance, rotation) =
            moving.fold((0.0, 0.0), |(distance, rotation), step| (distance + step.x, rotation + step.theta));
        assert!(distance.abs() > 0.3, "{distance} m, from {first:?} to {last:?}");
        rotation / distance
    };
    assert!((turn_per_metre(true) - 0.6).abs() < 0.05, "{}", turn_per_metre(true));
    assert!((turn_per_metre(false) - 0.2_f64.tan() / 0.3302).abs() < 0.05, "{}", turn_per_metre(false));
    simulator.signal("INT");
    assert_eq!(simulator.exit_code(Duration::from_secs(2)), Some(0));
    for (argument, remedy) in [("_world:=nowhere.yaml", "nowhere.yaml"), ("_scan_beam:=3", "did you mean 'scan_beams'?")] {
        let mut simulator = graph.spawn(env!("CARGO_BIN_EXE_racecar_sim"), &[argument]);
        assert_eq!(simulator.exit_code(TIMEOUT), Some(1), "{argument}");
        assert!(simulator.log().contains(remedy), "{}", simulator.log());
        graph.output("rosparam", &["delete", "/racecar_sim"]);
    }
}

/// F1TENTH's simulator is not packaged for Debian, so dummy packages with the same names of launch files and nodes stand in for it. The nodes
/// do nothing.
fn write_simulator(graph: &Graph, package: &str) {
    let folder = graph.dir.path().join(package);
    fs::create_dir_all(folder.join("launch")).unwrap();
    fs::write(folder.join("package.xml"), format!("<package><name>{package}</name></package>")).unwrap();
    let node = |name: &str, kind: &str| format!("<node pkg=\"{package}\" name=\"{name}\" type=\"{kind}\"/>");
    let nodes = [(package, "simulator"), ("mux_controller", "mux"), ("rviz", "simulator")].map(|(name, kind)| node(name, kind));
    fs::write(folder.join("launch/simulator.launch"), format!("<launch>{}</launch>", nodes.concat())).unwrap();
    for program in ["simulator", "mux"].map(|name| folder.join(name)) {
        fs::write(&program, "#!/bin/sh\nexec sleep 100\n").unwrap();
        fs::set_permissions(&program, fs::Permissions::from_mode(0o755)).unwrap();
    }
}

fn packages(graph: &Graph) -> String {
    format!("{}:{PACKAGE}:/usr/share", graph.dir.path().display())
}

#[test]
fn the_launch_file_starts_f1tenths_simulator_if_installed() {
    let Some(graph) = Graph::without_master() else { return };
    for package in ["racecar_simulator", "f1tenth_simulator"] {
        write_simulator(&graph, package);
    }
    let launch = |simulator: &str, rviz: &str| {
        let mut roslaunch = graph.command("roslaunch");
        roslaunch.env("ROS_PACKAGE_PATH", packages(&graph)).args(["--nodes", "anytime_scan_matcher", "racecar_simulator.launch"]);
        roslaunch.args([format!("simulator:={simulator}"), format!("rviz:={rviz}")]).output().unwrap()
    };
    for (simulator, expected) in [
        ("racecar_simulator", vec!["/mux_controller", "/racecar_simulator", "/rviz", "/scan_matcher"]),
        ("f1tenth_simulator", vec!["/f1tenth_simulator", "/mux_controller", "/rviz", "/scan_matcher"]),
        ("built_in", vec!["/racecar_sim", "/scan_matcher"]),
    ] {
        for (rviz, more) in [("false", None), ("true", Some("/scan_matcher_rviz"))] {
            let output = launch(simulator, rviz);
            let nodes = String::from_utf8(output.stdout).unwrap();
            let mut nodes: Vec<&str> = nodes.split_whitespace().collect();
            nodes.sort_unstable();
            let expected: Vec<&str> = expected.iter().copied().chain(more).collect();
            assert_eq!(nodes, expected, "{}", String::from_utf8_lossy(&output.stderr));
        }
    }
    let unknown = launch("gazebo", "false");
    let reported = String::from_utf8_lossy(&unknown.stderr);
    assert!(!unknown.status.success() && reported.contains("simulator:=gazebo is none of auto, f1tenth_simulator"), "{reported}");
}

#[test]
fn the_launch_file_finds_the_installed_simulator_and_does_not_predict_from_the_truth() {
    let Some(graph) = Graph::start() else { return };
    let nodes = |running: &[&str]| {
        let state = || graph.output("rosnode", &["list"]);
        assert!(eventually(|| running.iter().all(|node| state().lines().any(|line| line == *node))), "{running:?}: {}", state());
    };
    let own = graph.launch("racecar_simulator.launch", &["autopilot:=true", "rate:=100", "scan_rate:=20", "world:=room"]);
    own.expect_log("simulator:=built_in");
    own.expect_log("simulating a racecar in room");
    nodes(&["/racecar_sim", "/scan_matcher"]);
    own.expect_log("matching /scan with /no_odom");
    drop(own);

    for package in ["racecar_simulator", "f1tenth_simulator"] {
        write_simulator(&graph, package); // the second is preferred
        let path = packages(&graph);
        let theirs = graph.launch_with("racecar_simulator.launch", &["use_odom:=true"], &[("ROS_PACKAGE_PATH", &path)]);
        theirs.expect_log(&format!("simulator:={package}"));
        theirs.expect_log("matching /scan with /odom");
    }
}

/// As fast as `racecar_simulator`: 1000 Hz on a quiet machine. A busy one must reach a quarter of that.
#[test]
fn scans_and_odometry_are_published_at_1000_hz() {
    const MOMENT: f64 = 5.0;
    let Some(graph) = Graph::alone() else { return };
    let simulator = graph.spawn(env!("CARGO_BIN_EXE_racecar_sim"), &["_autopilot:=true"]);
    simulator.expect_log("simulating a racecar in corridor");
    let rate = |topic: &str| {
        let mut listener = Listener::of(&graph, "/racecar_sim", topic);
        thread::spawn(move || {
            let mut next = || header_stamp(&listener.next_bytes().unwrap()).unwrap();
            let (first, mut seconds, mut count) = (next(), 0.0, 0.0);
            while seconds < MOMENT {
                (seconds, count) = (next().seconds_since(first), count + 1.0);
            }
            count / seconds
        })
    };
    let [scans, odometry] = ["/scan", "/odom"].map(rate).map(|rate| rate.join().unwrap());
    eprintln!("{scans:.1} scans and {odometry:.1} poses a second");
    assert!(scans > 250.0 && odometry > 250.0, "{scans:.1} {odometry:.1}");
}
