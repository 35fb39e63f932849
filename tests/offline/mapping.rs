//! `anytime map` and `anytime evaluate --map`: simulated drives, a laser that sees the robot, extending a map, bad input.

use std::fs;
use std::path::{Path, PathBuf};

use anytime_scan_matcher::geometry::Pose2;
use anytime_scan_matcher::io::bag::{BagWriter, Compression};
use anytime_scan_matcher::io::simulated_bag::record;
use anytime_scan_matcher::io::tum::{self, TumWriter};
use anytime_scan_matcher::knobs::Seconds;
use anytime_scan_matcher::messages::sensor_msgs::{Imu, LaserScan};
use anytime_scan_matcher::messages::std_msgs::Header;
use anytime_scan_matcher::simulation::built_in::BuiltIn;
use anytime_scan_matcher::simulation::drive::{Settings, SimulatedMessage, mount_message, simulate};
use anytime_scan_matcher::simulation::scene::Scene;
use anytime_scan_matcher::time::Stamp;
use serde_json::Value;

use crate::common::program::{failure, json};

const CORRIDOR: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/maps/corridor.yaml");

/// Settings of drives in the corridor: a laser like a SICK's, and a slow car.
fn settings(seed: u32, seconds: f64) -> Settings {
    let mut settings = Settings::default();
    (settings.drive.seed, settings.drive.duration) = (seed, Seconds(seconds));
    (settings.lidar.beams, settings.lidar.rate, settings.lidar.noise) = (271, 10.0, 0.02);
    settings
}

/// A drive in its own folder: the bag, the truth, and the parameter that puts the map into the frame of the truth.
struct Drive {
    folder: tempfile::TempDir,
    bag: String,
    start: String,
}

impl Drive {
    fn new(seed: u32, seconds: f64) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let (bag, truth) = (folder.path().join("drive.bag"), folder.path().join("truth.tum"));
        let mut poses = Vec::new();
        let writer = BagWriter::create_whole(&bag, Compression::None).unwrap();
        let scene = Scene::built_in(BuiltIn::Corridor).unwrap();
        record(&settings(seed, seconds), &scene, writer, TumWriter::new(&mut poses)).unwrap();
        fs::write(&truth, poses).unwrap();
        let Pose2 { x, y, theta } = tum::read(&truth).unwrap().ends().0.pose;
        Self { folder, bag: bag.to_str().unwrap().into(), start: format!("odometry.initial_pose=[{x}, {y}, {theta}]") }
    }

    fn path(&self, name: &str) -> String {
        self.folder.path().join(name).to_str().unwrap().into()
    }

    /// Builds a map from its bag, or from others.
    fn map(&self, bags: &[&str], name: &str, more: &[&str]) -> Value {
        let (out, tum) = (self.path(name), self.path(&format!("{name}.tum")));
        let mut arguments = vec!["map", "--out", &out, "--tum", &tum, "--set", &self.start, "--clock", "virtual", "--json"];
        arguments.extend_from_slice(more);
        arguments.extend_from_slice(bags);
        json(&arguments)
    }

    /// Compares a map with the corridor.
    fn compare(&self, name: &str) -> Value {
        json(&["evaluate", "--map", &self.path(&format!("{name}.yaml")), "--truth-map", CORRIDOR, "--json"])
    }

    /// The same, but only walls that rays of the drive hit count as missed.
    fn compare_met(&self, name: &str) -> Value {
        let map = self.path(&format!("{name}.yaml"));
        json(&["evaluate", "--map", &map, "--truth-map", CORRIDOR, "--drive", &self.bag, "--json"])
    }

    /// RMSE of a trajectory after alignment, m.
    fn ate(&self, name: &str) -> f64 {
        let (tum, truth) = (self.path(&format!("{name}.tum")), self.path("truth.tum"));
        json(&["evaluate", &tum, "--truth", &truth, "--json"])["ate_rmse_m"].as_f64().unwrap()
    }
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value} is not a number"))
}

#[test]
fn the_map_of_a_drive_is_accurate_and_repeatable() {
    let drive = Drive::new(1, 45.0);
    let summary = drive.map(&[&drive.bag], "a", &[]);
    assert!(number(&summary["loops"]) > 20.0 && number(&summary["distance_m"]) > 80.0, "{summary}");
    assert_eq!((&summary["problems"], &summary["self_hits"]), (&Value::Array(vec![]), &Value::Array(vec![])));
    assert!(drive.ate("a") < 0.02, "{}", drive.ate("a"));
    let found = drive.compare("a");
    assert!(number(&found["occupied_to_truth"]["over_10_cm"]) < 0.001, "{found}");
    assert!(number(&found["truth_to_occupied"]["over_10_cm"]) < 0.05, "{found}");
    let met = drive.compare_met("a");
    assert!(number(&met["truth_to_occupied"]["over_10_cm"]) < 0.007, "{met}");
    assert_eq!(met["occupied_to_truth"], found["occupied_to_truth"]);
    // The walls of this world are lines through the middle of a cell, so the half of the cell in front of them is free.
    assert!(number(&found["free_truly_free"]) > 0.97, "{found}");
    assert_eq!(drive.map(&[&drive.bag], "b", &[]), summary);
    for ending in ["pgm", "png", "graph", "tum"] {
        let read = |name: &str| fs::read(drive.path(&format!("{name}.{ending}"))).unwrap();
        assert!(read("a") == read("b"), "{ending}");
    }
    let yaml = fs::read_to_string(drive.path("a.yaml")).unwrap();
    assert!(yaml.starts_with("image: a.pgm\nresolution: 0.050000\norigin: [-"), "{yaml}");
    assert!(yaml.ends_with(", 0.000000]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n\n"), "{yaml}");
    assert!(fs::read(drive.path("a.pgm")).unwrap().starts_with(b"P5\n# CREATOR: map_saver.cpp 0.050 m/pix\n"));
}

/// Writes the drive's messages between two times, s, with scans modified by `change`.
fn part(drive: &Drive, name: &str, seed: u32, (from, to): (f64, f64), change: impl Fn(&mut LaserScan)) -> String {
    let path = drive.folder.path().join(name);
    let mut writer = BagWriter::create_whole(&path, Compression::None).unwrap();
    let scene = Scene::built_in(BuiltIn::Corridor).unwrap();
    let settings = settings(seed, to);
    let mount = mount_message(Stamp::default(), settings.lidar.laser_in_base);
    let mut start = None;
    simulate(&settings, &scene, |time, message| {
        if time.seconds_since(*start.get_or_insert(time)) < from {
            return Ok(());
        }
        match message {
            SimulatedMessage::Odometry(odometry) => writer.write("/odom", time, &odometry),
            SimulatedMessage::Scan(mut scan) => {
                change(&mut scan);
                writer.write("/tf_static", time, &mount)?;
                writer.write("/scan", time, &scan)
            }
            _ => Ok(()),
        }
    })
    .unwrap();
    writer.finish().unwrap();
    path.to_str().unwrap().into()
}

#[test]
fn rays_that_hit_the_robot_are_not_walls() {
    let drive = Drive::new(2, 1.0);
    let corner = |scan: &mut LaserScan| {
        for (i, range) in scan.ranges.iter_mut().enumerate().skip(240).take(20) {
            *range = 0.35 + 0.01 * ((13 * i) as f32).sin();
        }
    };
    let bag = part(&drive, "corner.bag", 2, (0.0, 30.0), corner);
    let summary = drive.map(&[&bag], "masked", &[]);
    let sectors = summary["self_hits"].as_array().unwrap();
    assert_eq!(sectors.len(), 1, "{summary}");
    let [from, to, range] = [0, 1, 2].map(|i| number(&sectors[0][i]));
    assert!((to - from - 20f64.to_radians()).abs() < 0.03 && range < 0.5, "{summary}");
    assert!(number(&drive.compare("masked")["occupied_to_truth"]["over_10_cm"]) < 0.001);
    let unmasked = drive.map(&[&bag], "unmasked", &["--mask-self", "off"]);
    assert_eq!(unmasked["self_hits"], Value::Array(vec![]));
    let image = |name: &str| fs::read(drive.path(&format!("{name}.pgm"))).unwrap();
    assert!(image("unmasked") != image("masked"), "otherwise this tests nothing");
    let by_hand = format!("scan.masked_sectors={}", summary["self_hits"]);
    drive.map(&[&bag], "by_hand", &["--mask-self", "off", "--set", &by_hand]);
    assert!(image("by_hand") == image("masked"));
}

#[test]
fn a_map_can_be_extended_from_any_start() {
    let drive = Drive::new(3, 30.0);
    let summary = drive.map(&[&drive.bag], "first", &[]);
    let more = part(&drive, "more.bag", 3, (9.0, 30.0), |_| {});
    let first = drive.path("first.graph");
    let both = drive.map(&[&more], "both", &["--extend", &first]);
    assert_eq!(both["problems"], Value::Array(vec![]), "{both}");
    assert!(
        number(&both["keyframes"]) > number(&summary["keyframes"]) + 50.0
            && number(&both["loops"]) > number(&summary["loops"]) + 50.0
    );
    let found = drive.compare("both");
    assert!(number(&found["occupied_to_truth"]["over_10_cm"]) < 0.001, "{found}");
    // The new poses are in the frame of the old map.
    let truth = tum::read(Path::new(&drive.path("truth.tum"))).unwrap();
    let path = tum::read(Path::new(&drive.path("both.tum"))).unwrap();
    let off = |pose: &anytime_scan_matcher::evaluation::trajectory::StampedPose| {
        truth.interpolated(pose.stamp).map_or(0.0, |truth| truth.between(&pose.pose).distance())
    };
    let worst = path.poses().iter().map(off).fold(0.0, f64::max);
    assert!(worst < 0.1, "{worst}");
    // Two bags in one run give the same result.
    let together = drive.map(&[&drive.bag, &more], "together", &[]);
    assert_eq!((&together["problems"], &together["keyframes"]), (&both["problems"], &both["keyframes"]));
}

#[test]
fn invalid_graph_files_are_reported_and_nothing_is_lost() {
    let drive = Drive::new(4, 3.0);
    drive.map(&[&drive.bag], "old", &[]);
    let whole = fs::read(drive.path("old.graph")).unwrap();
    let before = fs::read(drive.path("old.pgm")).unwrap();
    let problem = |bytes: &[u8]| {
        let (graph, out) = (drive.path("bad.graph"), drive.path("old"));
        fs::write(&graph, bytes).unwrap();
        failure(&["map", &drive.bag, "--out", &out, "--extend", &graph], 1)
    };
    let changed = |place: usize, value: u8| {
        let mut bytes = whole.clone();
        bytes[place] = value;
        bytes
    };
    assert!(problem(&whole[..whole.len() / 2]).contains("cut off"));
    assert!(problem(&whole[..10]).contains("cut off"));
    assert!(problem(&changed(8, 77)).contains("version 77"));
    assert!(problem(&changed(whole.len() - 40, whole[whole.len() - 40] ^ 1)).contains("damaged"));
    assert!(problem(b"#ROSBAG V2.0\n").contains("not a graph file"));
    assert!(failure(&["map", &drive.bag, "--out", &drive.path("x"), "--extend", "no/such.graph"], 1).contains("no/such.graph"));
    assert!(fs::read(drive.path("old.pgm")).unwrap() == before && !PathBuf::from(drive.path("x.pgm")).exists());
    let parts = fs::read_dir(drive.folder.path())
        .unwrap()
        .filter(|entry| entry.as_ref().unwrap().file_name().to_string_lossy().ends_with(".part"));
    assert_eq!(parts.count(), 0);
}

#[test]
fn bags_without_usable_scans_are_reported() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let bag = path("no_scans.bag");
    let mut writer = BagWriter::create_whole(Path::new(&bag), Compression::None).unwrap();
    writer.write("/imu/data", Stamp::from_ros(1, 0), &Imu::default()).unwrap();
    writer.finish().unwrap();
    assert!(failure(&["map", &bag, "--out", &path("a")], 1).contains("/scan"));
    let bag = path("blind.bag");
    let mut writer = BagWriter::create_whole(Path::new(&bag), Compression::None).unwrap();
    let header = Header { stamp: Stamp::from_ros(1, 0).into(), ..Header::default() };
    let scan = LaserScan { header, angle_increment: 0.01, range_max: 10.0, ranges: vec![f32::NAN; 100], ..LaserScan::default() };
    writer.write("/scan", Stamp::from_ros(1, 0), &scan).unwrap();
    writer.finish().unwrap();
    assert!(failure(&["map", &bag, "--out", &path("a")], 1).contains("no scan on /scan could be used"));
    assert!(failure(&["map", &bag, "--out", &path("no/such/folder/a")], 1).contains("cannot create"));
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 2, "only the bags must be left");
}

#[test]
fn a_robot_at_rest_maps_what_it_sees() {
    let drive = Drive::new(5, 1.0);
    let still = {
        let path = drive.folder.path().join("still.bag");
        let mut writer = BagWriter::create_whole(&path, Compression::None).unwrap();
        let scene = Scene::built_in(BuiltIn::Room).unwrap();
        let mut kept: Option<LaserScan> = None;
        simulate(&settings(5, 0.2), &scene, |_, message| {
            if let SimulatedMessage::Scan(scan) = message {
                kept.get_or_insert(scan);
            }
            Ok::<(), ()>(())
        })
        .unwrap();
        let mut scan = kept.unwrap();
        for i in 0..10 {
            let stamp = Stamp::from_ros(100, 0).offset_by(0.1 * f64::from(i));
            scan.header.stamp = stamp.into();
            writer.write("/scan", stamp, &scan).unwrap();
        }
        writer.finish().unwrap();
        path.to_str().unwrap().to_owned()
    };
    let summary = drive.map(&[&still], "still", &[]);
    assert!(summary["problems"].to_string().contains("has not moved"), "{summary}");
    assert_eq!((number(&summary["keyframes"]), number(&summary["loops"]), number(&summary["scans"])), (1.0, 0.0, 10.0));
}
