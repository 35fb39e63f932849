//! The node as a replacement for `laser_scan_matcher`.

use std::path::{Path, PathBuf};

use anytime_scan_matcher::app::planar_pose;
use anytime_scan_matcher::geometry::{Point, Pose2};
use anytime_scan_matcher::io::bag::{Bag, BagWriter, Compression};
use anytime_scan_matcher::messages::geometry_msgs::{PoseStamped, PoseWithCovarianceStamped};
use anytime_scan_matcher::messages::sensor_msgs::{PointCloud2, PointField};
use anytime_scan_matcher::messages::tf2_msgs::TFMessage;
use anytime_scan_matcher::scan::ScanConverter;
use anytime_scan_matcher::time::Stamp;
use rosrust::RosMsg as _;
use rosrust_msg::geometry_msgs::{Pose2D, PoseWithCovariance};

use crate::common::Laser;
use crate::common::drive::{at, base_pose, header, odometry, room_from_odom};
use crate::common::graph::Graph;

const SCANS: u32 = 80;
const OUTPUTS: [&str; 5] = ["/pose2D", "/pose_stamped", "/pose_with_covariance", "/pose_with_covariance_stamped", "/tf"];

/// The points of a scan from `pose`, in single precision.
#[allow(clippy::cast_possible_truncation)] // messages carry 32 bits
fn cloud(seconds: f64, pose: Pose2) -> PointCloud2 {
    let message = Laser::with_field_of_view(270.0, 541).message(at(seconds), pose);
    let scan = ScanConverter::default().convert(&message, false).unwrap();
    let points: Vec<Point> = (0..scan.len()).filter_map(|i| scan.point(i)).collect();
    let field = |name: &str, offset| PointField { name: name.into(), offset, datatype: PointField::FLOAT32, count: 1 };
    let width = u32::try_from(points.len()).unwrap();
    let number = |value: f64| (value as f32).to_le_bytes();
    PointCloud2 {
        header: header(seconds, "laser"),
        height: 1,
        width,
        fields: vec![field("x", 0), field("y", 4), field("z", 8)],
        point_step: 12,
        row_step: 12 * width,
        data: points.iter().flat_map(|point| [number(point.x), number(point.y), number(0.0)]).flatten().collect(),
        is_dense: true,
        ..PointCloud2::default()
    }
}

/// Writes a drive of a robot whose laser is at its centre, as scans or clouds.
fn write(graph: &Graph, clouds: bool) -> PathBuf {
    let path = graph.dir.path().join("drive.bag");
    let mut writer = BagWriter::create(&path, Compression::None).unwrap();
    for number in 0..SCANS {
        let seconds = f64::from(number) * 0.025;
        let (pose, recorded) = (room_from_odom() * base_pose(seconds), at(seconds + 0.012));
        writer.write("/odom", at(seconds), &odometry(seconds)).unwrap();
        if clouds {
            let mut message = cloud(seconds, pose);
            message.header.seq = number;
            writer.write("/cloud", recorded, &message).unwrap();
        } else {
            let mut message = Laser::with_field_of_view(270.0, 541).message(at(seconds), pose);
            message.header.seq = number;
            writer.write("/scan", recorded, &message).unwrap();
        }
    }
    writer.finish().unwrap();
    path
}

/// Checks poses, which are relative to that of the first answered scan.
fn assert_on_the_way(poses: &[(Stamp, Pose2)]) {
    let truth = |stamp: &Stamp| base_pose(stamp.seconds_since(at(0.0)));
    let start = truth(poses.iter().map(|(stamp, _)| stamp).min().unwrap());
    for (stamp, pose) in poses {
        let error = start.between(&truth(stamp)).between(pose);
        assert!(error.distance() < 0.02 && error.theta.abs() < 0.02, "at {stamp}: {error:?}");
    }
}

/// Checks every pose of a recording; returns the number of messages on each topic of [`OUTPUTS`].
fn check(recorded: &Path) -> [usize; 5] {
    let (mut counts, mut poses) = ([0; 5], Vec::new());
    for message in Bag::open(recorded).unwrap().messages(None) {
        let message = message.unwrap();
        let topic = OUTPUTS.iter().position(|topic| *topic == message.connection.topic).unwrap();
        counts[topic] += 1;
        match topic {
            0 => assert!(Pose2D::decode(&message.data[..]).unwrap().theta.is_finite()),
            1 => {
                let pose: PoseStamped = message.decode().unwrap();
                assert_eq!(pose.header.frame_id, "world");
                poses.push((pose.header.stamp.into(), planar_pose(&pose.pose).unwrap()));
            }
            2 => {
                let message = PoseWithCovariance::decode(&message.data[..]).unwrap();
                assert!(message.covariance[0] > 0.0 && message.pose.orientation.w.is_finite());
            }
            3 => {
                let pose: PoseWithCovarianceStamped = message.decode().unwrap();
                poses.push((pose.header.stamp.into(), planar_pose(&pose.pose.pose).unwrap()));
                assert!(pose.pose.covariance[0][0] > 0.0 && pose.pose.covariance[5][5] > 0.0, "filters reject zero covariances");
            }
            _ => {
                let [transform] = &message.decode::<TFMessage>().unwrap().transforms[..] else { panic!() };
                assert_eq!((transform.header.frame_id.as_str(), transform.child_frame_id.as_str()), ("world", "base_link"));
                let place = &transform.transform.translation;
                let heading = transform.transform.rotation.yaw();
                poses.push((transform.header.stamp.into(), Pose2::new(place.x, place.y, heading)));
            }
        }
    }
    assert_on_the_way(&poses);
    counts
}

#[test]
fn the_launch_file_replaces_laser_scan_matcher() {
    let Some(graph) = Graph::start() else { return };
    let params = graph.dir.path().join("params.yaml");
    std::fs::write(&params, "max_iterations: 10\nkf_dist_linear: 0.2\nuse_sigma_weights: 0\ncloud_res: 0.05\n").unwrap();
    let params = format!("params:={}", params.display());
    for clouds in [false, true] {
        let bag = write(&graph, clouds);
        let input = format!("use_cloud_input:={clouds}");
        let arguments = [
            params.as_str(),
            input.as_str(),
            "publish_pose_stamped:=true",
            "publish_pose_with_covariance:=true",
            "publish_pose_with_covariance_stamped:=true",
        ];
        let launch = graph.launch("laser_scan_matcher_compat.launch", &arguments);
        launch.expect_log("these parameters have no effect in this node and are ignored: cloud_res, use_sigma_weights");
        launch.expect_log(if clouds { "matching /cloud with /odom" } else { "matching /scan with /odom" });
        let recorder = graph.record(&OUTPUTS);
        graph.play(&bag, &[]);
        let counts = check(&graph.finish_recording(recorder));
        assert!(counts.iter().all(|&count| count > 60), "{clouds}: {counts:?}");
    }
}
