//! The path follower with the built-in simulator.

use std::collections::VecDeque;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::thread;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use anytime_scan_matcher::app::planar_pose;
use anytime_scan_matcher::control::path::Projection;
use anytime_scan_matcher::control::speed::{SpeedLimits, SpeedProfile};
use anytime_scan_matcher::drive::course::Course;
use anytime_scan_matcher::geometry::Pose2;
use anytime_scan_matcher::io::bag::Bag;
use anytime_scan_matcher::messages;
use anytime_scan_matcher::messages::geometry_msgs::PoseStamped;
use anytime_scan_matcher::messages::nav_msgs::{Odometry, Path as PathMessage};
use anytime_scan_matcher::messages::own::FollowerReport;

use anytime_scan_matcher::time::Stamp;

use crate::common::drive::pose_message;
use crate::common::graph::{Graph, PACKAGE, Process, within};
use crate::common::skipped::skip;
use crate::common::wire::{Listener, Publisher, frame, publish};

/// The car touches a wall that is nearer than this to the centre of its rear axle, m.
const CONTACT_DISTANCE: f64 = 0.2;
/// Delay from planning a path to its publication.
const LATE: Duration = Duration::from_secs(2);

/// The recording of a drive.
struct Drive {
    truth: Vec<Pose2>,
    reports: Vec<FollowerReport>,
}

impl Drive {
    fn read(bag: &Path) -> Self {
        let mut drive = Self { truth: Vec::new(), reports: Vec::new() };
        for message in Bag::open(bag).unwrap().messages(None) {
            let message = message.unwrap();
            match message.connection.topic.as_str() {
                "/odom" => drive.truth.push(planar_pose(&message.decode::<Odometry>().unwrap().pose.pose).unwrap()),
                _ => drive.reports.push(message.decode().unwrap()),
            }
        }
        drive
    }

    /// Driven distance, m.
    fn length(&self) -> f64 {
        self.truth.windows(2).map(|pair| pair[0].between(&pair[1]).distance()).sum()
    }

    /// True distances from a path, sorted, m.
    fn errors(&self, course: &Course) -> Vec<f64> {
        // In either direction.
        let there = |pose: &Pose2| course.path.project(pose, 0.0, course.path.length());
        let back = |pose: &Pose2| there(&Pose2::new(pose.x, pose.y, pose.theta + std::f64::consts::PI));
        let distance = |place: Projection| place.distance;
        let nearest = |pose: &Pose2| [there(pose), back(pose)].into_iter().flatten().map(distance).min_by(f64::total_cmp);
        let mut errors: Vec<f64> = self.truth.iter().step_by(5).filter_map(nearest).collect();
        errors.sort_by(f64::total_cmp);
        errors
    }
}

fn corridor() -> PathBuf {
    Path::new(PACKAGE).join("maps/corridor.yaml")
}

/// The map levine if available, otherwise the corridor.
fn levine() -> PathBuf {
    let levine = Path::new(PACKAGE).join("../shared/data/maps/levine.yaml");
    if levine.exists() {
        return levine;
    }
    skip("no ../shared/data/maps: the corridor instead of levine");
    corridor()
}

fn launch(graph: &Graph, world: &Path, start: &Pose2, arguments: &[&str]) -> Process {
    let (world, start) =
        (format!("world:={}", world.display()), format!("initial_pose:=[{}, {}, {}]", start.x, start.y, start.theta));
    let launch = graph.launch("drive.launch", &[&[world.as_str(), &start][..], arguments].concat());
    launch.expect_log("simulating a racecar");
    launch.expect_log("following paths");
    launch
}

/// Records truth and reports for this time.
fn record(graph: &Graph, time: Duration) -> Drive {
    let recorder = graph.record(&["/odom", "/follower/report"]);
    thread::sleep(time);
    Drive::read(&graph.finish_recording(recorder))
}

/// The same until the car has driven `length`, m, or the time is over.
fn record_distance(graph: &Graph, length: f64, time: Duration) -> Drive {
    let recorder = graph.record(&["/odom", "/follower/report"]);
    let mut truth = Listener::of(graph, "/racecar_sim", "/odom");
    let mut next = || planar_pose(&truth.next::<Odometry>().pose.pose).unwrap();
    let (begin, mut last, mut distance) = (Instant::now(), next(), 0.0);
    while distance < length && begin.elapsed() < time {
        let pose = next();
        distance += last.between(&pose).distance();
        last = pose;
    }
    Drive::read(&graph.finish_recording(recorder))
}

#[test]
fn two_laps_at_four_metres_a_second_do_not_touch_a_wall() {
    let Some(graph) = Graph::alone() else { return };
    let world = levine();
    let course = Course::load(world.to_str().unwrap(), None).unwrap();
    let _launch = launch(&graph, &world, &course.start(0.0), &["speed:=4", "estimator:=particle_filter"]);
    let length = 2.0 * course.path.length();
    let drive = record_distance(&graph, length, Duration::from_secs_f64(length / 3.0 + 5.0));
    let (errors, laps) = (drive.errors(&course), drive.length() / course.path.length());
    let mean = errors.iter().sum::<f64>() / errors.len() as f64;
    let worst = *errors.last().unwrap();
    let room = drive.truth.iter().map(|pose| course.world.clearance(pose.translation())).fold(f64::INFINITY, f64::min);
    let stops: Vec<_> = drive.reports.iter().filter(|report| !report.driving).map(|report| report.reason.as_str()).collect();
    eprintln!("{laps:.2} laps, {mean:.3} m off on average, {worst:.3} m at most, {room:.2} m of room, {} stops", stops.len());
    assert!(laps >= 2.0, "{laps} laps: {:?}", stops.first());
    assert!(room > CONTACT_DISTANCE && worst < 0.25, "{worst} m off, {room} m of room");
}

#[test]
fn a_raceline_from_a_file_is_driven_with_the_scan_matcher_and_another_law() {
    let Some(graph) = Graph::alone() else { return };
    let course = Course::load(corridor().to_str().unwrap(), None).unwrap();
    let raceline = graph.dir.path().join("raceline.csv");
    let points = (0..200).map(|step| course.path.point(course.path.length() * f64::from(step) / 200.0));
    let lines: Vec<String> = points.map(|point| format!("{:.3}; {:.3}; 2.5", point.x, point.y)).collect();
    std::fs::write(&raceline, format!("# x_m; y_m; vx_mps\n{}\n", lines.join("\n"))).unwrap();
    let path = format!("path:={}", raceline.display());
    let arguments = ["estimator:=scan_matcher", "law:=proportional", "time_budget:=10ms", &path];
    let launch = launch(&graph, &corridor(), &course.start(0.0), &arguments);
    launch.expect_log("following paths with the control law proportional");
    launch.expect_log("driving");
    let drive = record_distance(&graph, 15.0, Duration::from_secs(20));
    let worst = *drive.errors(&course).last().unwrap();
    let fastest = drive.reports.iter().map(|report| report.speed).fold(0.0, f64::max);
    eprintln!("{:.1} m by the scan matcher, {worst:.3} m off at most, up to {fastest:.2} m/s", drive.length());
    assert!(drive.length() > 14.0 && worst < 0.25, "{} m, {worst} m off: {}", drive.length(), launch.log());
    assert!((2.0..=2.6).contains(&fastest), "{fastest} m/s: the file says 2.5");
}

#[test]
fn it_drives_to_goals_and_rejects_invalid_paths() {
    let Some(graph) = Graph::start() else { return };
    let start = Pose2::new(0.0, -6.1, 0.0);
    let launch = launch(&graph, &corridor(), &start, &["speed:=2", "estimator:=truth", "path:=none"]);
    launch.expect_log("stopped: no path");
    thread::sleep(Duration::from_secs(3)); // until poses and /tf have arrived
    let mut goal = PoseStamped { pose: pose_message(Pose2::new(6.0, -5.9, 0.0)), ..PoseStamped::default() };
    goal.header.frame_id = "map".into();
    publish(&graph, "/move_base_simple/goal", &goal, 1);
    launch.expect_log("driving");
    launch.expect_log("stopped: arrived");
    let drive = record(&graph, Duration::from_secs(1));
    let end = drive.truth.last().unwrap();
    assert!((end.x - 6.0).hypot(end.y + 5.9) < 0.15, "{end:?}");
    assert!(drive.reports.iter().all(|report| report.reason == "arrived" && report.speed == 0.0));
    // Paths with gaps, with NaN, with one point and in an unknown frame, then a valid one.
    let nan = f64::NAN;
    let send = |frame: &str, points: &[(f64, f64)], words: &str| {
        publish(&graph, "/path", &path(frame, points), 1);
        launch.expect_log(words);
        thread::sleep(Duration::from_secs(1)); // one line per second and subject is logged
    };
    send("map", &[(6.0, -5.9), (nan, 0.0), (9.0, -5.9)], "rejected: point 1 of the path is not finite");
    send("moon", &[(6.0, -5.9), (9.0, -5.9)], "no transform on /tf from its frame 'moon'");
    send("map", &[(6.0, -5.9)], "the path has no length");
    send("base_link", &[(0.0, 0.0), (0.5, 0.0), (2.5, 0.0)], "driving");
    assert!(within(Duration::from_secs(20), || launch.log().matches("stopped: arrived").count() >= 2), "{}", launch.log());
}

/// Sends the path ahead of a car at the speed limit five times a second, each time as planned two seconds before.
fn plan_late(graph: &Graph, course: &Course, limits: &SpeedLimits, time: Duration) {
    let publisher = Publisher::new::<PathMessage>(graph, "/planner", "/path");
    let mut link = publisher.link();
    let mut waiting: VecDeque<(Instant, PathMessage)> = VecDeque::new();
    let (speeds, mut along, mut speed) = (SpeedProfile::new(&course.path, limits), 0.0, 0.0);
    let (begin, mut last) = (Instant::now(), Instant::now());
    while begin.elapsed() < time {
        let seconds = last.elapsed().as_secs_f64();
        last = Instant::now();
        if begin.elapsed() > LATE {
            speed = speeds.at(along).min(speed + limits.braking * seconds);
            along += speed * seconds;
        }
        let ahead = (0..400).map(|step| course.path.point(along + 0.1 * f64::from(step))).map(|point| (point.x, point.y));
        waiting.push_back((last + LATE, path("map", &ahead.collect::<Vec<_>>())));
        while waiting.front().is_some_and(|(due, _)| *due <= Instant::now()) {
            let (_, planned) = waiting.pop_front().unwrap();
            link.write_all(&frame(&messages::encode(&planned).unwrap())).unwrap();
        }
        thread::sleep(Duration::from_millis(200));
    }
}

#[test]
fn late_and_replanned_paths_cause_no_stops_and_no_jumps() {
    let Some(graph) = Graph::alone() else { return };
    let world = levine();
    let course = Course::load(world.to_str().unwrap(), None).unwrap();
    let launch = launch(&graph, &world, &course.start(0.0), &["speed:=7", "estimator:=truth", "path:=none", "rate:=50"]);
    launch.expect_log("stopped: no path");
    let recorder = graph.record(&["/odom", "/follower/report"]);
    let limits = SpeedLimits { top: 7.0, lateral_acceleration: 4.0, braking: 3.0 };
    plan_late(&graph, &course, &limits, Duration::from_secs(20));
    let drive = Drive::read(&graph.finish_recording(recorder));
    let begin = drive.reports.iter().position(|report| report.driving).unwrap();
    // It continues on the last path, longer than paths were sent.
    let reports = &drive.reports[begin..begin + 800];
    // On a busy machine the simulator starves: stops due to old poses are not caused by the paths.
    let is_fed = |report: &FollowerReport| report.pose_age < 0.1;
    let stopped = reports.iter().filter(|report| is_fed(report) && !report.driving);
    let stops: Vec<_> = stopped.map(|report| report.reason.as_str()).collect();
    let fed = reports.windows(2).filter(|pair| pair.iter().all(is_fed));
    let steps = fed.map(|pair| (pair[1].lateral_error - pair[0].lateral_error).abs());
    let (step, fastest) = (steps.fold(0.0, f64::max), reports.iter().map(|report| report.speed).fold(0.0, f64::max));
    let worst = *drive.errors(&course).last().unwrap();
    eprintln!("{:.0} m, up to {fastest:.1} m/s, {worst:.3} m off at most, steps of {step:.3} m at most", drive.length());
    assert!(stops.is_empty(), "{} stops: {}", stops.len(), stops[0]);
    assert!(step < 0.05 && worst < 0.25 && fastest > 4.0, "step {step} m, {worst} m off, {fastest} m/s");
}

#[test]
fn it_continues_after_a_restart_and_after_a_gap_in_the_poses() {
    let Some(graph) = Graph::start() else { return };
    let (world, start) = (format!("_world:={}", corridor().display()), "_initial_pose:=[0, -6.1, 0]");
    let simulator = graph.spawn(env!("CARGO_BIN_EXE_racecar_sim"), &[&world, start, "_rate:=200", "_scan_rate:=40"]);
    simulator.expect_log("simulating a racecar");
    let map = format!("_map_file:={}", corridor().display());
    let follow = || {
        let follower = graph.spawn(env!("CARGO_BIN_EXE_path_follower"), &[&map, "_drive_round:=true", "_speed:=2", "pose:=odom"]);
        follower.expect_log("following a path");
        follower
    };
    let follower = follow();
    thread::sleep(Duration::from_secs(2));
    follower.signal("KILL");
    let follower = follow();
    let course = Course::load(corridor().to_str().unwrap(), None).unwrap();
    let drive = record(&graph, Duration::from_secs(4));
    let worst = *drive.errors(&course).last().unwrap();
    assert!(drive.length() > 4.0 && worst < 0.25, "{} m, {worst} m off", drive.length());
    assert!(drive.reports.iter().all(|report| report.driving), "{}", follower.log());
    // No poses and no scans.
    simulator.signal("STOP");
    follower.expect_log("braking: the pose is");
    simulator.signal("CONT");
    assert!(within(Duration::from_secs(20), || follower.log().contains("driving")), "{}", follower.log());
    let drive = record(&graph, Duration::from_secs(3));
    let worst = *drive.errors(&course).last().unwrap();
    assert!(drive.length() > 3.0 && worst < 0.25, "{} m, {worst} m off", drive.length());
}

fn path(frame: &str, points: &[(f64, f64)]) -> PathMessage {
    let mut path = PathMessage::default();
    path.header.frame_id = frame.into();
    path.header.stamp = Stamp::from_seconds(SystemTime::now().duration_since(UNIX_EPOCH).unwrap().as_secs_f64()).into();
    let pose = |&(x, y): &(f64, f64)| PoseStamped { pose: pose_message(Pose2::new(x, y, 0.0)), ..PoseStamped::default() };
    path.poses = points.iter().map(pose).collect();
    path
}
