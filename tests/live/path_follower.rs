//! The follower beside the built-in simulator.

use std::fs::{self, File};
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::thread;
use std::time::Duration;

use anytime_scan_matcher::app::planar_pose;
use anytime_scan_matcher::control::path::Projection;
use anytime_scan_matcher::drive::course::Course;
use anytime_scan_matcher::geometry::Pose2;
use anytime_scan_matcher::io::bag::Bag;
use anytime_scan_matcher::messages::nav_msgs::Odometry;
use anytime_scan_matcher::messages::own::FollowerReport;

use crate::common::graph::{Graph, PACKAGE, Process, eventually, within};
use crate::common::skipped::skip;

/// The car touches a wall when it is this near to the middle of its rear axle, m.
const GIRTH: f64 = 0.2;

/// What was recorded of a drive.
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

    /// Way that the car went, m.
    fn length(&self) -> f64 {
        self.truth.windows(2).map(|pair| pair[0].between(&pair[1]).distance()).sum()
    }

    /// True distances from a path, m, in order.
    fn errors(&self, course: &Course) -> Vec<f64> {
        let nearest = |pose: &Pose2| course.path.project(pose, 0.0, course.path.length()).map(|place: Projection| place.distance);
        let mut errors: Vec<f64> = self.truth.iter().step_by(5).filter_map(nearest).collect();
        errors.sort_by(f64::total_cmp);
        errors
    }
}

fn corridor() -> PathBuf {
    Path::new(PACKAGE).join("maps/corridor.yaml")
}

fn launch(graph: &Graph, world: &Path, start: &Pose2, arguments: &[&str]) -> Process {
    let (world, start) =
        (format!("world:={}", world.display()), format!("initial_pose:=[{}, {}, {}]", start.x, start.y, start.theta));
    let launch = graph.launch("drive.launch", &[&[world.as_str(), &start][..], arguments].concat());
    launch.expect_log("follows paths");
    launch
}

/// Records truth and reports until the car has gone so far, in at most so many seconds.
fn record(graph: &Graph, seconds: u64) -> Drive {
    let recorder = graph.record(&["/odom", "/follower/report"]);
    thread::sleep(Duration::from_secs(seconds));
    Drive::read(&graph.finish_recording(recorder))
}

#[test]
fn two_laps_at_four_metres_a_second_without_a_touch() {
    let Some(graph) = Graph::start() else { return };
    let levine = Path::new(PACKAGE).join("../shared/data/maps/levine.yaml");
    let world = if levine.exists() {
        levine
    } else {
        skip("no ../shared/data/maps: two laps of the corridor instead of levine");
        corridor()
    };
    let course = Course::load(world.to_str().unwrap(), None).unwrap();
    let _launch = launch(&graph, &world, &course.start(0.0), &["speed:=4", "estimator:=particle_filter"]);
    let seconds = (2.0 * course.path.length() / 3.0) as u64 + 5;
    let drive = record(&graph, seconds);
    let (errors, laps) = (drive.errors(&course), drive.length() / course.path.length());
    let mean = errors.iter().sum::<f64>() / errors.len() as f64;
    let worst = *errors.last().unwrap();
    let room = drive.truth.iter().map(|pose| course.world.clearance(pose.translation())).fold(f64::INFINITY, f64::min);
    let stops: Vec<_> = drive.reports.iter().filter(|report| !report.driving).map(|report| report.reason.as_str()).collect();
    println!("{laps:.2} laps, {mean:.3} m off on average, {worst:.3} m at most, {room:.2} m of room, {} stops", stops.len());
    assert!(laps >= 2.0, "{laps} laps: {:?}", stops.first());
    assert!(room > GIRTH && worst < 0.25, "{worst} m off, {room} m of room");
}

#[test]
fn it_follows_goals_stops_when_poses_end_and_starts_again() {
    let Some(graph) = Graph::start() else { return };
    let start = Pose2::new(0.0, -6.1, 0.0);
    let launch = launch(&graph, &corridor(), &start, &["speed:=2", "estimator:=truth", "path:=none"]);
    launch.expect_log("stands: no path");
    let goal = "{header: {frame_id: map}, pose: {position: {x: 6.0, y: -5.9}, orientation: {w: 1.0}}}";
    let mut publisher = graph.spawn("rostopic", &["pub", "-1", "/move_base_simple/goal", "geometry_msgs/PoseStamped", goal]);
    launch.expect_log("drives");
    launch.expect_log("stands: arrived");
    publisher.exit_code(Duration::from_secs(20));
    let drive = record(&graph, 1);
    let end = drive.truth.last().unwrap();
    assert!((end.x - 6.0).hypot(end.y + 5.9) < 0.15, "{end:?}");
    assert!(drive.reports.iter().all(|report| report.reason == "arrived" && report.speed == 0.0));
    // Paths with holes, NaN, of one point and in an unknown frame, then a good one.
    let script = graph.dir.path().join("paths.py");
    File::create(&script).and_then(|mut file| file.write_all(PATHS.as_bytes())).unwrap();
    let mut paths = graph.spawn("/usr/bin/python3", &[script.to_str().unwrap()]);
    launch.expect_log("refused: point 1 of the path is not finite");
    launch.expect_log("/tf does not say how they lie");
    launch.expect_log("the path has no length");
    assert!(within(Duration::from_secs(20), || launch.log().matches("stands: arrived").count() >= 2), "{}", launch.log());
    paths.exit_code(Duration::from_secs(20));
    assert!(eventually(|| fs::metadata(&script).is_ok()));
}

/// Publishes paths nobody should send, and one, in another frame, that is to be followed: 3 m on.
const PATHS: &str = r"
import rospy
from nav_msgs.msg import Path
from geometry_msgs.msg import PoseStamped
rospy.init_node('paths')
publisher = rospy.Publisher('/path', Path, queue_size=1)
def send(frame, points):
    path = Path()
    path.header.stamp = rospy.Time.now()
    path.header.frame_id = frame
    for x, y in points:
        pose = PoseStamped()
        pose.pose.position.x, pose.pose.position.y, pose.pose.orientation.w = x, y, 1
        path.poses.append(pose)
    publisher.publish(path)
    rospy.sleep(1.2)
while publisher.get_num_connections() == 0: rospy.sleep(0.05)
send('map', [(6, -5.9), (float('nan'), 0), (9, -5.9)])
send('moon', [(6, -5.9), (9, -5.9)])
send('map', [(6, -5.9)])
send('base_link', [(0, 0), (0.5, 0), (3, 0)])
rospy.sleep(2)
";
