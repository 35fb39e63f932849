//! Two lasers on one robot, one upside down and one facing backward, each with its own node.

use std::f64::consts::PI;
use std::path::Path;

use anytime_scan_matcher::geometry::Pose2;
use anytime_scan_matcher::io::bag::{BagWriter, Compression};
use anytime_scan_matcher::messages::geometry_msgs::{Quaternion, TransformStamped};
use anytime_scan_matcher::messages::tf2_msgs::TFMessage;
use anytime_scan_matcher::time::Stamp;

use crate::common::Laser;
use crate::common::drive::{Recording, at, base_pose, header, odometry, room_from_odom};
use crate::common::graph::Graph;

const SCANS: u32 = 80;

/// A laser on the robot.
struct Mounted {
    name: &'static str,
    place: Pose2,
    on_its_head: bool,
}

const LASERS: [Mounted; 2] = [
    Mounted { name: "front", place: Pose2 { x: 0.2, y: 0.05, theta: 0.3 }, on_its_head: true },
    Mounted { name: "rear", place: Pose2 { x: -0.25, y: -0.1, theta: PI }, on_its_head: false },
];

impl Mounted {
    fn transform(&self) -> TransformStamped {
        let mut message = TransformStamped { header: header(0.0, "base_link"), ..TransformStamped::default() };
        message.child_frame_id = format!("{}_laser", self.name);
        message.transform = self.place.into();
        if self.on_its_head {
            // Half a turn about its own x axis, then the heading.
            let (sin, cos) = (0.5 * self.place.theta).sin_cos();
            message.transform.rotation = Quaternion { x: cos, y: sin, z: 0.0, w: 0.0 };
        }
        message
    }

    fn write_scan(&self, writer: &mut BagWriter, number: u32, seconds: f64) {
        let pose = room_from_odom() * base_pose(seconds) * self.place;
        let mut scan = Laser::with_field_of_view(200.0, 401).message(at(seconds), pose);
        if self.on_its_head {
            scan.ranges.reverse();
        }
        scan.header.seq = number;
        scan.header.frame_id = format!("{}_laser", self.name);
        writer.write(&format!("/{}/scan", self.name), at(seconds + 0.012), &scan).unwrap();
    }
}

fn write(path: &Path) {
    let mut writer = BagWriter::create(path, Compression::None).unwrap();
    let transforms = LASERS.iter().map(Mounted::transform).collect();
    writer.write("/tf_static", at(0.0), &TFMessage { transforms }).unwrap();
    for number in 0..SCANS {
        let seconds = 0.1 + f64::from(number) * 0.025;
        writer.write("/vesc/odom", at(seconds), &odometry(seconds)).unwrap();
        for laser in &LASERS {
            laser.write_scan(&mut writer, number, seconds);
        }
    }
    writer.finish().unwrap();
}

#[test]
fn an_upside_down_and_a_backward_laser_give_the_same_trajectory() {
    let Some(graph) = Graph::start() else { return };
    let bag = graph.dir.path().join("drive.bag");
    write(&bag);
    let mut nodes = Vec::new();
    for laser in &LASERS {
        let namespace = format!("__ns:={}", laser.name);
        let publish = format!("_publish_tf:={}", laser.name == "front");
        nodes.push(graph.node(&[&namespace, "odom:=/vesc/odom", &publish]));
    }
    let recorder = graph.record(&[
        "/front/scan_match_location",
        "/front/icp_report",
        "/rear/scan_match_location",
        "/rear/icp_report",
        "/tf",
    ]);
    graph.play(&bag, &[]);
    let recorded = graph.finish_recording(recorder);
    for (laser, node) in LASERS.iter().zip(&nodes) {
        let recording = Recording::read(&recorded, &format!("/{}", laser.name));
        assert!(recording.reports.iter().all(|report| report.ok) && recording.reports.len() > 60, "{}", node.log());
        assert_eq!(node.log().contains("upside down"), laser.on_its_head, "{}", node.log());
        let (first, start) = recording.poses.iter().min_by_key(|(stamp, _)| **stamp).unwrap();
        for (stamp, pose) in &recording.poses {
            let truth = |stamp: &Stamp| base_pose(stamp.seconds_since(at(0.0)));
            let error = truth(first).between(&truth(stamp)).between(&start.between(pose));
            assert!(error.distance() < 0.02 && error.theta.abs() < 0.02, "{} at {stamp}: {error:?}", laser.name);
        }
    }
}
