//! Point clouds in bags: floor and ceiling must not count as walls in `replay`, `localize`, `profile` and `info`.

use std::path::{Path, PathBuf};

use anytime_scan_matcher::io::bag::{Bag, BagWriter, Compression};
use anytime_scan_matcher::messages::geometry_msgs::TransformStamped;
use anytime_scan_matcher::messages::nav_msgs::Odometry;
use anytime_scan_matcher::messages::sensor_msgs::{LaserScan, PointCloud2, PointField};
use anytime_scan_matcher::messages::tf2_msgs::TFMessage;

use crate::common::program::{failure, json};

/// Number of scans of the demo that are turned into clouds.
const SCANS: usize = 120;
/// Height of the sensor above the base's origin, m.
const HEIGHT: f32 = 0.4;

fn shipped(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(name)
}

/// The cloud of a multi-layer sensor where a laser sees `scan`: walls at three heights, with floor and ceiling in front of them.
fn cloud(scan: &LaserScan) -> PointCloud2 {
    let mut data = Vec::new();
    for (i, range) in scan.ranges.iter().enumerate() {
        let (sin, cos) = (scan.angle_min + i as f32 * scan.angle_increment).sin_cos();
        let wall = [0.2, 0.4, 1.9].map(|height: f32| (*range, height));
        let inside = [(range.min(1.0), 0.01), (range.min(1.4), -0.02), (0.6 * range, 2.6)];
        for (reach, height) in wall.into_iter().chain(inside).filter(|(reach, _)| reach.is_finite()) {
            data.extend([reach * cos, reach * sin, height - HEIGHT].map(f32::to_le_bytes).into_iter().flatten());
        }
    }
    let field = |name: &str, offset| PointField { name: name.into(), offset, datatype: PointField::FLOAT32, count: 1 };
    PointCloud2 {
        header: scan.header.clone(),
        height: 1,
        width: data.len() as u32 / 12,
        fields: vec![field("x", 0), field("y", 4), field("z", 8)],
        point_step: 12,
        row_step: data.len() as u32,
        data,
        ..PointCloud2::default()
    }
}

/// Writes the beginning of the demo with clouds on `topic` instead of scans.
fn write(path: &Path, topic: &str) {
    let demo = Bag::open(shipped("bags/demo.bag")).unwrap();
    let mut writer = BagWriter::create(path, Compression::Lz4).unwrap();
    let mut scans = 0;
    for message in demo.messages(Some(&["/scan", "/odom", "/tf_static"])).map(Result::unwrap) {
        match message.connection.topic.as_str() {
            "/scan" if scans < SCANS => {
                scans += 1;
                writer.write(topic, message.time, &cloud(&message.decode().unwrap())).unwrap();
            }
            "/odom" => writer.write("/odom", message.time, &message.decode::<Odometry>().unwrap()).unwrap(),
            "/tf_static" => {
                let mut mounts: TFMessage = message.decode().unwrap();
                let raise = |mount: &mut TransformStamped| mount.transform.translation.z = HEIGHT.into();
                mounts.transforms.iter_mut().for_each(raise);
                writer.write_latched("/tf_static", message.time, &mounts).unwrap();
            }
            _ => {}
        }
    }
    writer.finish().unwrap();
}

#[test]
fn replay_and_localize_use_clouds_without_floor_and_ceiling() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.bag");
    write(&path, "/cloud");
    let (bag, truth, map) = (path.to_str().unwrap(), shipped("bags/demo.tum"), shipped("maps/corridor.yaml"));
    let (truth, map) = (truth.to_str().unwrap(), map.to_str().unwrap());
    let picture = dir.path().join("a.svg");
    let replay =
        json(&["replay", bag, "--scan-topic", "/cloud", "--truth", truth, "--json", "--plot", picture.to_str().unwrap()]);
    assert!(replay["matched"] == SCANS && replay["ate_rmse_m"].as_f64().unwrap() < 0.005, "{replay}");
    assert!(picture.exists());
    let by_parameter = json(&["replay", bag, "--set", "cloud.input=true", "--truth", truth, "--json"]);
    assert_eq!(by_parameter["ate_rmse_m"], replay["ate_rmse_m"], "the parameter must select the topic /cloud");
    let limits = ["--set", "cloud.min_height=-100", "--set", "cloud.max_height=100"];
    let floor = json(&[&["replay", bag, "--scan-topic", "/cloud", "--truth", truth, "--json"], &limits[..]].concat());
    assert!(floor["ate_rmse_m"].as_f64().unwrap() > 0.005, "without limits floor and ceiling are matched: {floor}");
    let localize = json(&["localize", bag, "--map", map, "--scan-topic", "/cloud", "--truth", truth, "--json"]);
    assert!(localize["scans"] == SCANS && localize["position_rmse_m"].as_f64().unwrap() < 0.05, "{localize}");
}

#[test]
fn info_and_errors_list_clouds() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.bag");
    write(&path, "/velodyne_points");
    let path = path.to_str().unwrap();
    let info = json(&["info", path, "--json"]);
    let cloud = &info["clouds"][0];
    assert!(cloud["topic"] == "/velodyne_points" && cloud["usable"] == SCANS && cloud["unusable"] == 0, "{cloud}");
    assert!((cloud["lowest_m"].as_f64().unwrap() + 0.42).abs() < 1e-5, "{cloud}");
    assert!(!info["problems"].to_string().contains("no usable scans"), "{info}");
    let error = failure(&["replay", path], 1);
    assert!(error.contains("topics with sensor_msgs/PointCloud2: /velodyne_points"), "{error}");
}
