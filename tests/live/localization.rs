//! The particle filter on a live graph: maps by topic and by file, good and bad; updates by messages and by a timer.

use std::collections::BTreeMap;
use std::convert::Infallible;
use std::fs;
use std::path::{Path, PathBuf};

use anytime_scan_matcher::app::map_message::message;
use anytime_scan_matcher::app::planar_pose;
use anytime_scan_matcher::geometry::Pose2;
use anytime_scan_matcher::io::bag::{Bag, BagWriter, Compression};
use anytime_scan_matcher::knobs::Seconds;
use anytime_scan_matcher::map::grid::Cell;
use anytime_scan_matcher::messages::decode;
use anytime_scan_matcher::messages::geometry_msgs::{Point, PointStamped, PoseWithCovarianceStamped, TransformStamped};
use anytime_scan_matcher::messages::nav_msgs::{MapMetaData, OccupancyGrid as MapMessage, Odometry};
use anytime_scan_matcher::messages::own::{Contract, FilterReport};
use anytime_scan_matcher::messages::sensor_msgs::LaserScan;
use anytime_scan_matcher::messages::std_msgs::Header;
use anytime_scan_matcher::messages::tf2_msgs::TFMessage;
use anytime_scan_matcher::simulation::drive::{Settings, SimulatedMessage, simulate};
use anytime_scan_matcher::simulation::scene::Scene;
use anytime_scan_matcher::time::Stamp;
use rosrust::{Message as _, RosMsg as _};
use rosrust_msg::geometry_msgs::PoseArray;
use rosrust_msg::nav_msgs::GetMap;

use crate::common::corridor;
use crate::common::graph::{Graph, Process, TIMEOUT, eventually};

const PROGRAM: &str = env!("CARGO_BIN_EXE_particle_filter");
pub(crate) const TOPICS: [&str; 7] =
    ["/scan", "/odom", "/pf/pose/odom", "/pf/report", "/pf/viz/particles", "/pf/viz/fake_scan", "/tf"];

/// A drive through the corridor, as a bag.
pub(crate) struct Drive {
    pub(crate) bag: PathBuf,
    start: Stamp,
    truth: BTreeMap<Stamp, Pose2>,
}

impl Drive {
    /// `extra` adds messages; it gets the start time.
    pub(crate) fn write(folder: &Path, seconds: f64, extra: impl FnOnce(&mut BagWriter, Stamp)) -> Self {
        Self::write_at(folder, seconds, 20.0, extra)
    }

    /// The same with this number of scans a second.
    fn write_at(folder: &Path, seconds: f64, rate: f64, extra: impl FnOnce(&mut BagWriter, Stamp)) -> Self {
        let mut settings = Settings::default();
        settings.drive.duration = Seconds(seconds);
        settings.lidar.rate = rate;
        let bag = folder.join("corridor.bag");
        let mut writer = BagWriter::create(&bag, Compression::None).unwrap();
        let (mut truth, mut start) = (BTreeMap::new(), None);
        simulate::<Infallible>(&settings, &Scene::in_map(corridor(), 2).unwrap(), |time, message| {
            start.get_or_insert(time);
            match message {
                SimulatedMessage::Mount(message) => writer.write_latched("/tf_static", time, &message).unwrap(),
                SimulatedMessage::Odometry(message) => writer.write("/odom", time, &message).unwrap(),
                SimulatedMessage::Scan(message) => writer.write("/scan", time, &message).unwrap(),
                SimulatedMessage::Truth { stamp, map_from_base } => drop(truth.insert(stamp, map_from_base)),
            }
            Ok(())
        })
        .unwrap();
        let start = start.unwrap();
        extra(&mut writer, start);
        writer.finish().unwrap();
        Self { bag, start, truth }
    }

    /// The parameter with the start pose of the drive.
    pub(crate) fn initial_pose(&self) -> String {
        let pose = self.truth.values().next().unwrap();
        format!("_localization/initial_pose:=[{}, {}, {}]", pose.x, pose.y, pose.theta)
    }

    /// The error of a pose; the true pose is interpolated between scans.
    fn error(&self, stamp: Stamp, pose: &Pose2) -> Pose2 {
        let before = self.truth.range(..=stamp).next_back();
        let after = self.truth.range(stamp..).next();
        let truth = match (before, after) {
            (Some((a, before)), Some((b, after))) if a < b => {
                before.interpolate(after, stamp.seconds_since(*a) / b.seconds_since(*a))
            }
            (before, after) => *before.or(after).unwrap().1,
        };
        truth.between(pose)
    }
}

/// Writes the corridor as a map file of `map_server`.
pub(crate) fn map_file(folder: &Path) -> String {
    let grid = corridor();
    let mut image = format!("P5 {} {} 255\n", grid.width(), grid.height()).into_bytes();
    for row in grid.cells().chunks_exact(grid.width()).rev() {
        image.extend(row.iter().map(|&cell| if cell == Cell::Free { 254_u8 } else { 0 }));
    }
    fs::write(folder.join("corridor.pgm"), image).unwrap();
    let yaml = folder.join("corridor.yaml");
    let fields =
        "image: corridor.pgm\nresolution: 0.05\norigin: [-4, 2, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n";
    fs::write(&yaml, fields).unwrap();
    format!("_localization/map:={}", yaml.display())
}

/// The recorded messages.
#[derive(Default)]
pub(crate) struct Received {
    pub(crate) poses: Vec<(Stamp, Pose2)>,
    odometry: Vec<Odometry>,
    scans: BTreeMap<Stamp, LaserScan>,
    fake_scans: Vec<LaserScan>,
    reports: Vec<FilterReport>,
    particles: Vec<usize>,
    transforms: Vec<TransformStamped>,
}

impl Received {
    pub(crate) fn read(path: &Path) -> Self {
        let mut received = Self::default();
        for message in Bag::open(path).unwrap().messages(None) {
            let message = message.unwrap();
            match message.connection.topic.as_str() {
                "/pf/pose/odom" => {
                    let pose: Odometry = message.decode().unwrap();
                    assert_eq!((pose.header.frame_id.as_str(), pose.child_frame_id.as_str()), ("map", "base_link"));
                    assert!([0, 1, 5].map(|i| pose.pose.covariance[i][i]).iter().all(|v| *v > 0.0 && v.is_finite()));
                    received.poses.push((pose.header.stamp.into(), planar_pose(&pose.pose.pose).unwrap()));
                }
                "/odom" => received.odometry.push(message.decode().unwrap()),
                "/scan" => {
                    let scan: LaserScan = message.decode().unwrap();
                    received.scans.insert(scan.header.stamp.into(), scan);
                }
                "/pf/viz/fake_scan" => received.fake_scans.push(message.decode().unwrap()),
                "/pf/report" => received.reports.push(message.decode().unwrap()),
                "/pf/viz/particles" => received.particles.push(PoseArray::decode(&message.data[..]).unwrap().poses.len()),
                "/tf" => {
                    let tf: TFMessage = message.decode().unwrap();
                    received.transforms.extend(tf.transforms.into_iter().filter(|t| t.child_frame_id == "odom"));
                }
                _ => {}
            }
        }
        received
    }

    /// Checks that every pose is right to within `tolerance`, m.
    pub(crate) fn check_poses(&self, drive: &Drive, tolerance: f64) {
        for (stamp, pose) in &self.poses {
            let error = drive.error(*stamp, pose);
            assert!(error.distance() < tolerance && error.theta.abs() < 0.1, "at {stamp}: {error:?}");
        }
    }

    /// Checks that no scan was used twice.
    fn check_evidence(&self) {
        let stamps: Vec<Stamp> = self.reports.iter().map(|report| report.header.stamp.into()).collect();
        assert!(stamps.windows(2).all(|pair| pair[0] < pair[1]), "{stamps:?}");
        assert!(self.reports.iter().all(|report| report.ok && report.reason.is_empty()));
    }
}

fn start(graph: &Graph, arguments: &[&str]) -> Process {
    let node = graph.spawn(PROGRAM, arguments);
    node.expect_log("localizing with ");
    node
}

#[test]
fn the_robot_is_localized_on_a_map_that_arrives_late() {
    let Some(graph) = Graph::start() else { return };
    let drive = Drive::write(graph.dir.path(), 12.0, |writer, start| {
        let mut bad = message(&corridor(), "map");
        bad.info.resolution = -1.0;
        writer.write("/map", start.offset_by(0.4), &bad).unwrap();
        bad.info.height = 5;
        writer.write("/map", start.offset_by(1.6), &bad).unwrap();
        // It is checked once there is a map.
        let contract = Contract { translation_error_bound: -1.0, ..Contract::default() };
        writer.write("/icp_contract", start.offset_by(1.6), &contract).unwrap();
        // The second time the map is unchanged.
        for seconds in [2.0, 6.0] {
            writer.write("/map", start.offset_by(seconds), &message(&corridor(), "map")).unwrap();
        }
    });
    let node = start(&graph, &["__name:=pf"]);
    let recorder = graph.record(&TOPICS);
    let mut player = graph.start_playing(&drive.bag, &[]);
    node.expect_log("there is no map yet");
    node.expect_log("resolution is -1");
    node.expect_log("cells do not make 400 x 5");
    node.expect_log("using a map of 400 x 300 cells of 0.05 m");
    node.expect_log("icp_contract: message from /play");
    assert!(graph.trigger("/pf/global_localization").contains("anywhere"));
    assert_eq!(player.exit_code(6 * TIMEOUT), Some(0));
    let received = Received::read(&graph.finish_recording(recorder));
    assert_eq!(node.log().matches("using a map").count(), 1, "{}", node.log());
    received.check_evidence();
    // Global localization in the corridor takes longer than this. The search runs before it has used the first scan.
    let searching: Vec<_> = received.reports.iter().skip_while(|report| report.beams == 0).collect();
    assert!(searching.len() > 50 && searching.iter().all(|report| report.particles >= 4000 && report.beams > 0));
    assert!(received.poses.iter().all(|(stamp, pose)| drive.error(*stamp, pose).distance() < 40.0));
}

#[test]
fn the_map_of_a_file_is_published_latched_and_served() {
    let Some(graph) = Graph::start() else { return };
    let map = map_file(graph.dir.path());
    let node = start(&graph, &[&map]);
    node.expect_log("publishing the map on /map and serving it by /static_map");
    let recorder = graph.record(&["/map", "/map_metadata"]); // which subscribes after it was published
    let expected = message(&corridor(), "map");
    let served = graph.request("/static_map", "nav_msgs/GetMap", &GetMap::md5sum(), &[]);
    assert!(decode::<MapMessage>(&served).unwrap() == expected);
    let recorded = Bag::open(graph.finish_recording(recorder)).unwrap();
    let [mut maps, mut metadata] = [0, 0];
    for message in recorded.messages(None) {
        let message = message.unwrap();
        if message.connection.topic == "/map" {
            assert!(message.decode::<MapMessage>().unwrap() == expected);
            maps += 1;
        } else {
            assert_eq!(message.decode::<MapMetaData>().unwrap(), expected.info);
            metadata += 1;
        }
    }
    assert_eq!((maps, metadata), (1, 1));
    let second = start(&graph, &[&map, "__name:=second", "_publish_tf:=false"]);
    second.expect_log("not publishing the map: /particle_filter already publishes /map");
    second.expect_log("using a map of 400 x 300");
}

#[test]
fn poses_transforms_and_visualizations_belong_to_the_scan() {
    let Some(graph) = Graph::alone() else { return };
    let drive = Drive::write(graph.dir.path(), 6.0, |_, _| ());
    let node = start(&graph, &[&drive.initial_pose(), &map_file(graph.dir.path())]);
    node.expect_log("using a map of 400 x 300");
    let recorder = graph.record(&TOPICS);
    graph.play(&drive.bag, &[]);
    let received = Received::read(&graph.finish_recording(recorder));
    received.check_evidence();
    received.check_poses(&drive, 0.15);
    assert!(received.reports.len() * 10 > drive.truth.len() * 8, "{} of {}", received.reports.len(), drive.truth.len());
    assert!(received.poses.iter().all(|(stamp, _)| drive.truth.contains_key(stamp)), "stamps must be those of the scans");
    assert_eq!(received.transforms.len(), received.poses.len());
    assert!(received.particles.iter().all(|&count| count == 1000) && !received.particles.is_empty());
    // map -> odom and odom -> base must combine to map -> base.
    let odometry: BTreeMap<Stamp, Pose2> =
        received.odometry.iter().map(|o| (o.header.stamp.into(), planar_pose(&o.pose.pose).unwrap())).collect();
    let mut compared = 0;
    for (transform, (stamp, pose)) in received.transforms.iter().zip(&received.poses) {
        assert_eq!((Stamp::from(transform.header.stamp), transform.header.frame_id.as_str()), (*stamp, "map"));
        if let Some(odom_from_base) = odometry.get(stamp) {
            let t = &transform.transform;
            let map_from_odom = Pose2::new(t.translation.x, t.translation.y, t.rotation.yaw());
            let off = (map_from_odom * *odom_from_base).between(pose);
            // On a busy machine a scan may arrive before its odometry, which is then extrapolated.
            assert!(off.distance() < 0.02 && off.theta.abs() < 0.02, "{off:?}");
            compared += usize::from(off.distance() < 1e-6 && off.theta.abs() < 1e-6);
        }
    }
    assert!(compared > 50, "{compared} transforms compared");
    for fake in &received.fake_scans {
        let Some(scan) = received.scans.get(&fake.header.stamp.into()) else { continue }; // not received by the recorder
        let near = scan.ranges.iter().zip(&fake.ranges).filter(|(a, b)| (**a - **b).abs() < 0.3).count();
        assert!(fake.ranges.len() == scan.ranges.len() && near * 10 > scan.ranges.len() * 8, "{near} of {}", scan.ranges.len());
    }
}

#[test]
fn a_timer_triggers_the_updates_and_no_scan_is_used_twice() {
    let Some(graph) = Graph::alone() else { return };
    let drive = Drive::write(graph.dir.path(), 6.0, |_, _| ());
    let map = map_file(graph.dir.path());
    for (period, least_poses, most_reports) in [("10ms", 200, 125), ("200ms", 20, 35)] {
        let period = format!("_localization/update_period:={period}");
        let mut node = start(&graph, &[&drive.initial_pose(), &map, &period]);
        node.expect_log("using a map of 400 x 300");
        let recorder = graph.record(&TOPICS);
        graph.play(&drive.bag, &[]);
        let received = Received::read(&graph.finish_recording(recorder));
        received.check_evidence();
        received.check_poses(&drive, 0.2);
        let (poses, reports) = (received.poses.len(), received.reports.len());
        assert!(poses >= least_poses && (15..=most_reports).contains(&reports), "{period}: {poses} poses, {reports} reports");
        let stamps: Vec<Stamp> = received.poses.iter().map(|(stamp, _)| *stamp).collect();
        assert!(period.contains("200") == (received.reports.last().unwrap().dropped > 20));
        assert!(stamps.iter().all(|stamp| stamp.seconds_since(drive.start) >= 0.0));
        node.signal("INT");
        assert_eq!(node.exit_code(TIMEOUT), Some(0));
        graph.output("rosparam", &["delete", "/particle_filter"]);
    }
}

#[test]
fn bad_maps_and_bad_poses_are_reported_and_the_node_continues() {
    let Some(graph) = Graph::start() else { return };
    let folder = graph.dir.path();
    let fields = "resolution: 0.05\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n";
    map_file(folder);
    for (name, text, reported) in [
        ("missing", format!("image: nowhere.png\n{fields}"), "nowhere.png"),
        ("coarse", format!("image: corridor.pgm\n{fields}").replace("0.05", "-0.05"), "resolution is -0.05"),
        ("thresholds", format!("image: corridor.pgm\n{fields}").replace("0.65", "0.1"), "less than occupied_thresh"),
        (
            "dark",
            format!("image: corridor.pgm\n{fields}").replace("free_thresh: 0.196", "free_thresh: 0.001"),
            "no cell of the map is free",
        ),
    ] {
        let yaml = folder.join(format!("{name}.yaml"));
        fs::write(&yaml, text).unwrap();
        let mut node = start(&graph, &[&format!("_localization/map:={}", yaml.display())]);
        node.expect_log(reported);
        assert!(node.is_running());
        graph.output("rosparam", &["delete", "/particle_filter"]);
    }
    let drive = Drive::write(folder, 5.0, |writer, start| {
        let pose = |seconds, frame: &str, x: f64| {
            let header = Header { seq: 0, stamp: start.offset_by(seconds).into(), frame_id: frame.into() };
            let mut message = PoseWithCovarianceStamped { header, ..PoseWithCovarianceStamped::default() };
            message.pose.pose = Pose2::new(x, 5.0, 0.0).into();
            message
        };
        for (seconds, frame, x) in [(0.2, "map", 1e6), (1.4, "odom", 0.0), (2.6, "map", f64::NAN)] {
            writer.write("/initialpose", start.offset_by(seconds), &pose(seconds, frame, x)).unwrap();
        }
        let header = Header { seq: 0, stamp: start.into(), frame_id: "map".into() };
        let point = PointStamped { header, point: Point { x: f64::INFINITY, y: 0.0, z: 0.0 } };
        writer.write("/clicked_point", start.offset_by(2.0), &point).unwrap();
        // Between two scans, and several at once, of which only the newest is used.
        for seconds in (0..10).map(|i| 3.025 + 0.1 * f64::from(i)) {
            writer.write("/scan", start.offset_by(seconds), &LaserScan::default()).unwrap();
        }
        // It keeps publishing.
        for seconds in (0..30).map(|i| 1.0 + 0.1 * f64::from(i)) {
            let mut rival = TransformStamped { child_frame_id: "odom".into(), ..Default::default() };
            rival.transform.rotation.w = 1.0;
            writer.write("/tf", start.offset_by(seconds), &TFMessage { transforms: vec![rival] }).unwrap();
        }
    });
    // Few particles, so that every scan is processed before the next one arrives.
    let arguments = [&*drive.initial_pose(), &*map_file(folder), "_contract/time_budget:=10us", "_localization/particles:=500"];
    let mut node = start(&graph, &arguments);
    node.expect_log("using a map of 400 x 300");
    let recorder = graph.record(&TOPICS);
    graph.play(&drive.bag, &[]);
    for reported in
        ["outside the map", "given in the frame 'odom', expected 'map'", "not finite", "malformed scan", "stops publishing"]
    {
        node.expect_log(reported);
    }
    assert!(node.is_running());
    let received = Received::read(&graph.finish_recording(recorder));
    received.check_poses(&drive, 0.3);
    let own = received.transforms.iter().filter(|t| t.header.frame_id == "map");
    assert!(own.clone().count() > 20, "the node first waits, because the conflicting publisher may stop by itself");
    assert!(own.clone().all(|t| Stamp::from(t.header.stamp).seconds_since(drive.start) < 3.8), "one parent must do");
    let late = received.reports.iter().filter(|report| !report.deadline_met).count();
    assert!(late * 10 > received.reports.len() * 9, "{late} of {}", received.reports.len());
    let mut failed = received.reports.iter().filter(|report| !report.ok).peekable();
    assert!(failed.peek().is_some() && failed.all(|report| report.failure == "malformed_scan"));
}

#[test]
fn a_clicked_point_sets_the_position_but_not_the_heading() {
    let Some(graph) = Graph::start() else { return };
    let drive = Drive::write(graph.dir.path(), 6.0, |writer, start| {
        let pose = Pose2::new(-2.0, 9.0, 0.0);
        let header = Header { seq: 0, stamp: start.into(), frame_id: "map".into() };
        let point = PointStamped { header, point: Point { x: pose.x, y: pose.y, z: 0.0 } };
        writer.write("/clicked_point", start.offset_by(3.0), &point).unwrap();
    });
    let at_click = drive.truth.range(drive.start.offset_by(3.0)..).next().unwrap().1;
    let node = start(&graph, &[&drive.initial_pose(), &map_file(graph.dir.path())]);
    node.expect_log("using a map of 400 x 300");
    let recorder = graph.record(&TOPICS);
    graph.play(&drive.bag, &[]);
    let received = Received::read(&graph.finish_recording(recorder));
    let clicked = Pose2::new(-2.0, 9.0, 0.0);
    let near = |(stamp, pose): &&(Stamp, Pose2)| {
        (3.0..3.3).contains(&stamp.seconds_since(drive.start)) && (pose.translation() - clicked.translation()).norm() < 2.0
    };
    assert!((at_click.translation() - clicked.translation()).norm() > 4.0, "choose another pose: {at_click:?}");
    assert!(received.poses.iter().any(|pose| near(&pose)), "the robot must be at the clicked point");
}

#[test]
fn the_robot_is_found_from_anywhere_at_40_scans_a_second() {
    let Some(graph) = Graph::start() else { return };
    let drive = Drive::write_at(graph.dir.path(), 20.0, 40.0, |_, _| {});
    let node = start(&graph, &[&map_file(graph.dir.path())]);
    node.expect_log("using a map of 400 x 300");
    let recorder = graph.record(&TOPICS);
    graph.play(&drive.bag, &[]);
    let received = Received::read(&graph.finish_recording(recorder));
    let is_right = |report: &&FilterReport| {
        let stamp = report.header.stamp.into();
        let pose = received.poses.iter().find(|(of, _)| *of == stamp);
        pose.is_some_and(|(_, pose)| drive.error(stamp, pose).distance() < 0.3)
    };
    let claims: Vec<&FilterReport> = received.reports.iter().filter(|report| report.localized).collect();
    let first = claims.first().map(|report| Stamp::from(report.header.stamp).seconds_since(drive.start));
    eprintln!(
        "found after {first:?} s; {} of {} claims are right",
        claims.iter().filter(|claim| is_right(claim)).count(),
        claims.len()
    );
    assert!(first.is_some_and(|seconds| seconds < 15.0), "{first:?}");
    assert!(claims.last().is_some_and(is_right), "{:?}", received.reports.last());
    assert!(claims.iter().filter(|claim| is_right(claim)).count() * 10 > claims.len() * 9);
}

#[test]
fn the_launch_file_passes_its_arguments() {
    let Some(graph) = Graph::start() else { return };
    let map = map_file(graph.dir.path()).replace("_localization/map", "map");
    let arguments = [
        "scan:=/front/scan",
        "odom:=icp/odom",
        &map,
        "initial_pose:=[1, 3, 0]",
        "particles:=500",
        "update_period:=10ms",
        "time_budget:=5ms",
        "base_frame:=car",
    ];
    let mut launch = graph.launch("particle_filter.launch", &arguments);
    launch.expect_log(
        "localizing with /front/scan and /icp/odom; poses on /pf/pose/odom (map -> car, also map -> odom on /tf); 500 particles, \
         updated every 0.01 s; contract: within 5ms",
    );
    launch.expect_log("using a map of 400 x 300");
    launch.signal("INT");
    assert!(launch.exit_code(TIMEOUT).is_some());
    let shown = graph.output("roslaunch", &["--nodes", "anytime_scan_matcher", "particle_filter.launch", "rviz:=true"]);
    assert!(shown.contains("/particle_filter") && shown.contains("/rviz"), "{shown}");
    assert!(eventually(|| !graph.master_state().contains("particle_filter")));
}
