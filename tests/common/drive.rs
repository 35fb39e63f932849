//! A drive through a room as a bag, and the recorded outputs of matching it.

use std::collections::HashMap;
use std::path::Path;
use std::sync::{Arc, LazyLock};

use anytime_scan_matcher::anytime::clock::MonotonicClock;
use anytime_scan_matcher::app::{App, ScanProcessor as _, planar_pose};
use anytime_scan_matcher::config::Config;
use anytime_scan_matcher::geometry::Pose2;
use anytime_scan_matcher::io::bag::{Bag, BagWriter, Compression};
use anytime_scan_matcher::io::simulated_bag::record;
use anytime_scan_matcher::io::tum::TumWriter;
use anytime_scan_matcher::knobs::Seconds;
use anytime_scan_matcher::messages::geometry_msgs::{Pose, PoseStamped};
use anytime_scan_matcher::messages::nav_msgs::Odometry;
use anytime_scan_matcher::messages::sensor_msgs::LaserScan;
use anytime_scan_matcher::messages::std_msgs::Header;
use anytime_scan_matcher::messages::tf2_msgs::TFMessage;
use anytime_scan_matcher::messages::{Definition, Message};
use anytime_scan_matcher::simulation::built_in::BuiltIn;
use anytime_scan_matcher::simulation::drive::Settings;
use anytime_scan_matcher::simulation::scene::Scene;
use anytime_scan_matcher::time::Stamp;
use rosrust::RosMsg;
use rosrust_msg::anytime_scan_matcher::MatchReport;
use speedy::{Readable, Writable};

use super::{Laser, room_range};

/// The topics to record: the scans and the node's outputs.
pub const TOPICS: [&str; 5] = ["/scan", "/scan_match_location", "/icp_state", "/icp_report", "/tf"];
/// Pose of the laser on the base in the drives.
pub const LASER_IN_BASE: Pose2 = Pose2 { x: 0.1, y: 0.0, theta: 0.0 };
/// The same as a parameter.
pub const MOUNT: &str = "_odometry/laser_in_base:=[0.1, 0, 0]";
const START: u32 = 1_700_000_000;
pub const PERIOD: f64 = 0.025;

pub fn at(seconds: f64) -> Stamp {
    Stamp::from_ros(START, 0).offset_by(seconds)
}

/// The start pose of the drive in the room.
pub fn room_from_odom() -> Pose2 {
    Pose2::new(-1.0, -1.0, 0.3)
}

/// The true pose of the base, on a circle that starts at the origin.
pub fn base_pose(seconds: f64) -> Pose2 {
    let (radius, angle) = (1.2, 0.4 * seconds);
    Pose2::new(radius * angle.sin(), radius * (1.0 - angle.cos()), angle)
}

pub fn pose_message(pose: Pose2) -> Pose {
    let mut message = Pose::default();
    (message.position.x, message.position.y) = (pose.x, pose.y);
    (message.orientation.z, message.orientation.w) = (0.5 * pose.theta).sin_cos();
    message
}

pub fn header(seconds: f64, frame: &str) -> Header {
    Header { seq: 0, stamp: at(seconds).into(), frame_id: frame.into() }
}

#[allow(clippy::cast_possible_truncation)] // messages carry f32
pub fn scan(number: u32, seconds: f64, laser: Laser) -> LaserScan {
    let room_from_laser = room_from_odom() * base_pose(seconds) * LASER_IN_BASE;
    let ranges = laser
        .geometry()
        .directions()
        .iter()
        .map(|&direction| room_range(room_from_laser.translation(), room_from_laser.transform().rotate(direction)) as f32)
        .collect();
    LaserScan {
        header: Header { seq: number, ..header(seconds, "laser") },
        angle_min: laser.angle_min as f32,
        angle_max: (laser.angle_min + laser.increment * (laser.beams - 1) as f64) as f32,
        angle_increment: laser.increment as f32,
        range_min: 0.05,
        range_max: 30.0,
        ranges,
        ..LaserScan::default()
    }
}

/// Wheel odometry that is 2 % too long.
pub fn odometry(seconds: f64) -> Odometry {
    let truth = base_pose(seconds);
    let mut message = Odometry { header: header(seconds, "odom"), child_frame_id: "base_link".into(), ..Odometry::default() };
    message.pose.pose = pose_message(Pose2::new(1.02 * truth.x, 1.02 * truth.y, truth.theta));
    message
}

/// Writes a bag with `scans` scans at 40 Hz, each some time after the odometry of its stamp, and the messages of `extra`.
pub fn write(path: &Path, scans: u32, extra: impl FnOnce(&mut BagWriter)) {
    write_with_beams(path, scans, 541, extra);
}

pub fn write_with_beams(path: &Path, scans: u32, beams: usize, extra: impl FnOnce(&mut BagWriter)) {
    let laser = Laser::with_field_of_view(270.0, beams);
    let mut writer = BagWriter::create(path, Compression::None).unwrap();
    for number in 0..scans {
        let seconds = f64::from(number) * PERIOD;
        writer.write("/odom", at(seconds), &odometry(seconds)).unwrap();
        writer.write("/scan", at(seconds + 0.012), &scan(number, seconds, laser)).unwrap();
    }
    extra(&mut writer);
    writer.finish().unwrap();
}

/// Writes the bag of a simulated drive through a room: 1081 beams with noise, at 40 Hz. Returns the number of scans.
pub fn simulate(path: &Path, seconds: f64) -> usize {
    let mut settings = Settings::default();
    settings.drive.duration = Seconds(seconds);
    let bag = BagWriter::create(path, Compression::None).unwrap();
    let scene = Scene::built_in(BuiltIn::Room).unwrap();
    record(&settings, &scene, bag, TumWriter::new(std::io::sink())).unwrap().try_into().unwrap()
}

/// The poses that the application estimates for a bag, message by message.
pub fn offline(path: &Path) -> HashMap<Stamp, Pose2> {
    let mut config = Config::default();
    config.odometry.laser_in_base = Some(LASER_IN_BASE.into());
    let mut app = App::new(&config, Arc::new(MonotonicClock::default())).unwrap();
    let mut poses = HashMap::new();
    for message in Bag::open(path).unwrap().messages(Some(&["/scan", "/odom"])) {
        let message = message.unwrap();
        if message.connection.topic == "/odom" {
            app.on_odometry(&message.decode().unwrap()).unwrap();
        } else {
            let estimate = app.on_scan(&message.decode().unwrap(), std::time::Duration::ZERO);
            poses.insert(estimate.stamp, estimate.registration.map_from_base());
        }
    }
    poses
}

/// The recorded messages.
pub struct Recording {
    pub poses: HashMap<Stamp, Pose2>,
    pub reports: Vec<MatchReport>,
    pub states: Vec<i32>,
    /// Stamps of the transforms from odom to `base_link`.
    pub transforms: Vec<Stamp>,
    /// The same from map to odom.
    pub map_transforms: Vec<Stamp>,
}

impl Recording {
    /// Reads the topics below this namespace ("" or "/name").
    pub fn read(path: &Path, namespace: &str) -> Self {
        let mut recording = Self {
            poses: HashMap::new(),
            reports: Vec::new(),
            states: Vec::new(),
            transforms: Vec::new(),
            map_transforms: Vec::new(),
        };
        for message in Bag::open(path).unwrap().messages(None) {
            let message = message.unwrap();
            match message.connection.topic.strip_prefix(namespace).unwrap_or(&message.connection.topic) {
                "/scan_match_location" => {
                    let pose: PoseStamped = message.decode().unwrap();
                    assert_eq!(pose.header.frame_id, "map");
                    recording.poses.insert(pose.header.stamp.into(), planar_pose(&pose.pose).unwrap());
                }
                "/icp_report" => recording.reports.push(MatchReport::decode(&message.data[..]).unwrap()),
                "/icp_state" => recording.states.push(i32::decode(&message.data[..]).unwrap()),
                "/tf" => {
                    let tf: TFMessage = message.decode().unwrap();
                    let stamps = |parent: &'static str, child: &'static str| {
                        let own = tf.transforms.iter().filter(move |t| t.header.frame_id == parent && t.child_frame_id == child);
                        own.map(|t| Stamp::from(t.header.stamp))
                    };
                    recording.transforms.extend(stamps("odom", "base_link"));
                    recording.map_transforms.extend(stamps("map", "odom"));
                }
                _ => {}
            }
        }
        recording
    }

    /// The number of answered and dropped scans by the last report.
    pub fn accounted_for(&self) -> usize {
        self.reports.len() + self.reports.last().map_or(0, |report| report.dropped as usize)
    }

    /// Checks that every scan from the first to the last answer is answered or counted as dropped. Scans before and after are unknown, because
    /// connections come and go. The drive has `scans` scans.
    pub fn check_accounts(&self, scans: usize) {
        let stamps: Vec<f64> = self.timed_reports().map(|(seconds, _)| seconds).collect();
        let (Some(first), Some(last)) = (stamps.first(), stamps.last()) else { panic!("no answers") };
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a number of scans
        let between = ((last - first) / PERIOD).round() as usize + 1;
        let accounted = self.accounted_for();
        assert!((between..=scans).contains(&accounted), "{accounted} of {between}, from {first} s to {last} s");
        assert!(between * 10 >= scans * 9, "only {between} of {scans}");
    }

    /// Checks that every answer has one report, one pose and one edge.
    pub fn check_consistency(&self) {
        assert_eq!(self.states.len(), self.reports.len());
        assert_eq!(self.poses.len(), self.reports.len());
        assert!(self.states.iter().zip(self.states.iter().skip(1)).all(|(a, b)| a + b == 1), "every message must be an edge");
    }

    /// The reports, with their time in the drive, s.
    pub fn timed_reports(&self) -> impl Iterator<Item = (f64, &MatchReport)> {
        let seconds =
            |report: &MatchReport| Stamp::from_ros(report.header.stamp.sec, report.header.stamp.nsec).seconds_since(at(0.0));
        self.reports.iter().map(move |report| (seconds(report), report))
    }
}

/// A scan that announces four billion ranges and has none.
#[derive(Readable, Writable)]
pub struct EndlessScan {
    pub header: Header,
    pub numbers: [f32; 7],
    pub ranges: u32,
}

impl EndlessScan {
    pub fn new(number: u32, seconds: f64) -> Self {
        Self { header: Header { seq: number, ..header(seconds, "laser") }, numbers: [0.1; 7], ranges: u32::MAX }
    }
}

impl Message for EndlessScan {
    const TYPE: &'static str = LaserScan::TYPE;

    fn definition() -> &'static Definition {
        LaserScan::definition()
    }
}

/// `std_msgs/String`.
#[derive(Readable, Writable)]
pub struct Text {
    pub data: String,
}

impl Message for Text {
    const TYPE: &'static str = "std_msgs/String";

    fn definition() -> &'static Definition {
        static DEFINITION: LazyLock<Definition> = LazyLock::new(|| Definition::new(Text::TYPE, "string data\n"));
        &DEFINITION
    }
}
