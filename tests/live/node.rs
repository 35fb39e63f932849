//! The node on a live ROS graph: a real master, rosbag, rostopic, rosnode, roslaunch and catkin.

use std::fs;
use std::path::Path;
use std::time::{Duration, Instant};

use crate::common::drive::{self, EndlessScan, MOUNT, Recording, TOPICS, Text, at, header, pose_message};
use crate::common::graph::{Graph, NODE, PACKAGE, Process, TIMEOUT, call, eventually, installed, within};
use crate::common::skipped::skip;
use crate::common::wire::{Listener, Publisher};
use anytime_scan_matcher::geometry::Pose2;
use anytime_scan_matcher::io::bag::{Bag, BagWriter, Compression};
use anytime_scan_matcher::messages::ackermann_msgs::AckermannDriveStamped;
use anytime_scan_matcher::messages::diagnostic_msgs::DiagnosticArray;
use anytime_scan_matcher::messages::geometry_msgs::{
    PointStamped, PoseArray, PoseStamped, PoseWithCovarianceStamped, TransformStamped, Twist, TwistStamped,
};
use anytime_scan_matcher::messages::nav_msgs::{MapMetaData, OccupancyGrid, Odometry};
use anytime_scan_matcher::messages::own::{self, Contract};
use anytime_scan_matcher::messages::sensor_msgs::{Imu, LaserScan, PointCloud2};
use anytime_scan_matcher::messages::std_msgs::{Empty, Header, Int32};
use anytime_scan_matcher::messages::tf2_msgs::TFMessage;
use anytime_scan_matcher::messages::visualization_msgs::Marker;
use anytime_scan_matcher::messages::{self, Message};
use rosrust::Message as _;
use rosrust_msg::anytime_scan_matcher::MatchReport;

const SECOND: Duration = Duration::from_secs(1);

#[test]
fn live_poses_are_those_of_the_offline_application() {
    let Some(graph) = Graph::start() else { return };
    let bag = graph.dir.path().join("drive.bag");
    drive::write(&bag, 160, |_| ());
    let _node = graph.node(&[MOUNT]);
    let recorder = graph.record(&TOPICS);
    graph.play(&bag, &[]);
    let recorded = graph.finish_recording(recorder);
    let recording = Recording::read(&recorded, "");
    recording.check_consistency();
    recording.check_accounts(160);
    assert_eq!(recording.transforms.len(), recording.reports.len());
    assert_eq!(recording.map_transforms, recording.transforms, "from the map through the odometry frame to the base");
    assert!(recording.reports.iter().all(|report| report.ok), "every scan must be matched");
    // A dropped scan is allowed, but then the matches differ a little.
    let tolerance = if recording.reports.len() == 160 { 1e-12 } else { 0.01 };
    let expected = drive::offline(&bag);
    for (stamp, pose) in &recording.poses {
        let error = pose.between(&expected[stamp]);
        assert!(error.distance() < tolerance && error.theta.abs() < tolerance, "at {stamp}: {error:?}");
    }
    check_definitions(&graph, &recorded);
}

/// Checks that the recorded definitions are complete: Python's ROS generates types from them with the same checksum.
fn check_definitions(graph: &Graph, recorded: &Path) {
    let script = "import sys, genpy.dynamic as d; n = sys.argv[1]; print(d.generate_dynamic(n, sys.argv[2])[n]._md5sum)";
    let bag = Bag::open(recorded).unwrap();
    let report = bag.connections().iter().find(|connection| connection.topic == "/icp_report").unwrap();
    assert_eq!(report.message_type, MatchReport::msg_type());
    let definitions = [
        (report.message_type.as_str(), report.definition.clone(), &report.md5[..]),
        (Contract::TYPE, Contract::definition().text.clone(), &Contract::definition().md5),
    ];
    for (name, definition, md5) in definitions {
        assert_eq!(graph.output("/usr/bin/python3", &["-c", script, name, &definition]).trim(), md5, "{name}");
    }
}

/// The name of the project's folder must not matter.
#[test]
fn message_types_have_the_package_names_of_the_definitions() {
    let definitions = Path::new(env!("CARGO_MANIFEST_DIR")).join("definitions");
    for (package, name) in rosrust_msg::MESSAGES {
        assert!(definitions.join(package).is_dir(), "{package}/{name}");
    }
}

#[test]
fn message_types_equal_those_of_the_installed_ros() {
    /// Checks that name, checksum and wire format equal those of rosrust's type.
    fn pair<T: Message + Default, U: rosrust::Message>() -> (&'static str, &'static str) {
        let md5 = T::definition().md5.as_str();
        assert_eq!((T::TYPE, md5), (U::msg_type().as_str(), U::md5sum().as_str()));
        let mut bytes = Vec::new();
        U::default().encode(&mut bytes).unwrap();
        assert_eq!(messages::encode(&T::default()).unwrap(), bytes, "{}", T::TYPE);
        (T::TYPE, md5)
    }
    use rosrust_msg::{
        ackermann_msgs, anytime_scan_matcher, diagnostic_msgs, geometry_msgs, nav_msgs, sensor_msgs, std_msgs, tf2_msgs,
        visualization_msgs,
    };
    pair::<PointCloud2, sensor_msgs::PointCloud2>();
    pair::<Imu, sensor_msgs::Imu>();
    pair::<AckermannDriveStamped, ackermann_msgs::AckermannDriveStamped>();
    pair::<Twist, geometry_msgs::Twist>();
    pair::<TwistStamped, geometry_msgs::TwistStamped>();
    pair::<Contract, anytime_scan_matcher::Contract>();
    pair::<own::MatchReport, MatchReport>();
    pair::<own::FilterReport, anytime_scan_matcher::FilterReport>();
    pair::<own::FollowerReport, anytime_scan_matcher::FollowerReport>();
    pair::<Empty, std_msgs::Empty>();
    let types = [
        pair::<LaserScan, sensor_msgs::LaserScan>(),
        pair::<Odometry, nav_msgs::Odometry>(),
        pair::<TFMessage, tf2_msgs::TFMessage>(),
        pair::<PoseStamped, geometry_msgs::PoseStamped>(),
        pair::<PoseWithCovarianceStamped, geometry_msgs::PoseWithCovarianceStamped>(),
        pair::<TransformStamped, geometry_msgs::TransformStamped>(),
        pair::<PointStamped, geometry_msgs::PointStamped>(),
        pair::<OccupancyGrid, nav_msgs::OccupancyGrid>(),
        pair::<MapMetaData, nav_msgs::MapMetaData>(),
        pair::<Int32, std_msgs::Int32>(),
        pair::<messages::nav_msgs::Path, nav_msgs::Path>(),
        pair::<PoseArray, geometry_msgs::PoseArray>(),
        pair::<Marker, visualization_msgs::Marker>(),
        pair::<DiagnosticArray, diagnostic_msgs::DiagnosticArray>(),
    ];
    let log = rosrust_msg::rosgraph_msgs::Log::md5sum();
    let (names, expected): (Vec<&str>, Vec<&str>) = types.into_iter().chain([("rosgraph_msgs/Log", log.as_str())]).unzip();
    let Some(graph) = Graph::without_master() else { return };
    let found = graph.output("/usr/bin/python3", &[&["-c", MD5_OF_INSTALLED][..], &names].concat());
    assert_eq!(found.lines().count(), names.len(), "{found}");
    for ((name, expected), found) in names.into_iter().zip(expected).zip(found.lines()) {
        if found == "none" {
            skip(&format!("the package of {name} is not installed"));
        } else {
            assert_eq!(found, expected, "{name}");
        }
    }
}

/// Prints the checksums that ROS's own tools compute for installed message definitions; `none` for those that are not.
const MD5_OF_INSTALLED: &str = "
import os, sys, genmsg
from genmsg import gentools, msg_loader
share = '/usr/share'
search = {package: [os.path.join(share, package, 'msg')] for package in os.listdir(share)}
for name in sys.argv[1:]:
    if not os.path.isdir(search.get(name.split('/')[0], [''])[0]):
        print('none')
        continue
    context = genmsg.MsgContext.create_default()
    spec = msg_loader.load_msg_by_type(context, name, search)
    msg_loader.load_depends(context, spec, search)
    print(gentools.compute_md5(context, spec))
";

#[test]
fn every_scan_is_accounted_for_at_ten_times_the_speed_and_on_simulated_time() {
    let Some(graph) = Graph::start() else { return };
    let bag = graph.dir.path().join("drive.bag");
    drive::write(&bag, 800, |_| ());
    let recorder = graph.record(&TOPICS); // before simulated time is set, for which it would wait
    graph.output("rosparam", &["set", "use_sim_time", "true"]);
    let mut node = graph.node(&[MOUNT]);
    graph.play(&bag, &["--clock", "--rate", "10"]);
    let recording = Recording::read(&graph.finish_recording(recorder), "");
    recording.check_consistency();
    recording.check_accounts(800);
    // The clock has stopped: nothing may wait for it.
    node.signal("INT");
    assert_eq!(node.exit_code(SECOND), Some(0));
}

#[test]
fn two_nodes_stay_in_their_namespaces() {
    let Some(graph) = Graph::start() else { return };
    let bag = graph.dir.path().join("drive.bag");
    drive::write(&bag, 60, |_| ());
    let topics = ["scan:=/scan", "odom:=/odom", MOUNT];
    let mut left = graph.node(&[&["__ns:=left"][..], &topics].concat());
    let right =
        graph.node(&[&["__ns:=/right", "__name:=matcher", "icp_report:=report", "_publish_tf:=false"][..], &topics].concat());
    right.expect_log("matching /scan with /odom; poses on /right/scan_match_location");
    let nodes = graph.output("rosnode", &["list"]);
    assert!(nodes.contains("/left/scan_matcher") && nodes.contains("/right/matcher"), "{nodes}");
    assert!(graph.output("rostopic", &["list"]).contains("/right/report"));
    for (topic, message_type) in [("icp_contract", Contract::TYPE), ("imu/data", Imu::TYPE), ("vel", Twist::TYPE)] {
        let found = graph.output("rostopic", &["type", &format!("/left/{topic}")]);
        assert_eq!(found.trim(), message_type, "{topic}, without a publisher");
    }
    let recorder = graph.record(&["/left/icp_report", "/left/icp_state", "/right/scan_match_location", "/right/report"]);
    graph.play(&bag, &[]);
    let recorded = graph.finish_recording(recorder);
    Recording::read(&recorded, "/left").check_accounts(60);
    assert!(!Recording::read(&recorded, "/right").poses.is_empty());
    assert_eq!(graph.output("rosnode", &["kill", "/left/scan_matcher"]).lines().last(), Some("killed"));
    assert_eq!(left.exit_code(SECOND), Some(0));
}

#[test]
fn bad_input_is_rejected_with_its_name_and_valid_input_is_processed() {
    let Some(graph) = Graph::start() else { return };
    let (text, bag) = (graph.dir.path().join("text.bag"), graph.dir.path().join("drive.bag"));
    let mut writer = BagWriter::create(&text, Compression::None).unwrap();
    writer.write("/scan", at(0.0), &Text { data: "no scan".into() }).unwrap();
    writer.finish().unwrap();
    let contract = |seconds, time_budget, translation_error_bound| Contract {
        header: header(seconds, ""),
        time_budget: messages::Duration { sec: time_budget, nsec: 0 },
        translation_error_bound,
        rotation_error_bound: 0.0,
    };
    drive::write(&bag, 160, |writer| {
        let mut lost = Odometry::default();
        lost.pose.pose.orientation.w = 1.0;
        lost.pose.pose.position.x = f64::NAN;
        writer.write("/scan", at(0.5), &EndlessScan::new(19, 0.5)).unwrap();
        writer.write("/odom", at(0.8), &lost).unwrap();
        writer.write("/icp_contract", at(1.0), &contract(1.0, 3, 0.0)).unwrap();
        writer.write("/icp_contract", at(2.0), &contract(2.0, 7, -1.0)).unwrap();
        writer.write("/odom", at(2.2), &Odometry::default()).unwrap(); // its quaternion is zero
        let empty = LaserScan { header: Header { seq: 119, ..header(2.99, "laser") }, ..LaserScan::default() };
        writer.write("/scan", at(3.0), &empty).unwrap();
    });
    let node = graph.node(&[MOUNT]);
    graph.play(&text, &[]);
    node.expect_log("publishes std_msgs/String, expected sensor_msgs/LaserScan");
    let recorder = graph.record(&TOPICS);
    graph.play(&bag, &[]);
    let recording = Recording::read(&graph.finish_recording(recorder), "");
    for reported in [
        "scan: message from /play",
        "the pose has numbers that are not finite",
        "contract refused: translation_error_bound is -1",
        "malformed scan",
    ] {
        node.expect_log(reported);
    }
    recording.check_consistency();
    for (seconds, report) in recording.timed_reports() {
        let expected = if seconds < 0.9 { 0 } else { 3 };
        assert!((0.9..1.1).contains(&seconds) || report.time_budget.sec == expected, "at {seconds}: {:?}", report.time_budget);
    }
    assert!(
        recording.timed_reports().any(|(seconds, report)| seconds > 3.5 && report.ok),
        "the end of the drive must be matched"
    );
    // The unreadable message is neither an answered nor a dropped scan; the empty scan was answered.
    assert!((160..=162).contains(&recording.accounted_for()), "{}", recording.accounted_for());
}

#[test]
fn a_silent_topic_is_reported_with_its_publishers_and_alternatives() {
    let Some(graph) = Graph::start() else { return };
    let elsewhere = Publisher::new::<LaserScan>(&graph, "/front_laser", "/front/scan");
    let node = graph.node(&[MOUNT]);
    let no_publisher = "topic /scan: no message for 5 s: it has no publisher; other topics of sensor_msgs/LaserScan: /front/scan";
    node.expect_log(no_publisher);
    node.expect_log("scan:=/front/scan");
    let mute = Publisher::new::<LaserScan>(&graph, "/mute_laser", "/scan");
    let _link = mute.link();
    node.expect_log("topic /scan: no message for 5 s: /mute_laser sends nothing");
    assert_eq!(node.log().matches("no message for").count(), 2, "{}", node.log());
    mute.unregister(&graph);
    elsewhere.unregister(&graph);
}

#[test]
fn a_normal_start_and_a_peer_that_ends_cause_no_silence_warning() {
    let Some(graph) = Graph::start() else { return };
    let bag = graph.dir.path().join("drive.bag");
    drive::write(&bag, 20, |_| ());
    let node = graph.node(&[MOUNT]);
    for _ in 0..2 {
        graph.play(&bag, &[]);
        std::thread::sleep(6 * SECOND);
    }
    assert!(!node.log().contains("no message for"), "{}", node.log());
}

#[test]
fn initial_pose_reset_and_a_second_parent_of_the_base() {
    let Some(graph) = Graph::start() else { return };
    let bag = graph.dir.path().join("drive.bag");
    drive::write(&bag, 200, |writer| {
        let mut initial = PoseWithCovarianceStamped { header: header(1.0, "odom"), ..PoseWithCovarianceStamped::default() };
        initial.pose.pose = pose_message(Pose2::new(5.0, 6.0, 0.0));
        writer.write("/initialpose", at(1.0), &initial).unwrap();
        let mut rival =
            TransformStamped { header: header(2.0, "map"), child_frame_id: "/base_link".into(), ..Default::default() };
        rival.transform.rotation.w = 1.0;
        writer.write("/tf", at(2.0), &TFMessage { transforms: vec![rival] }).unwrap();
    });
    let node = graph.node(&[MOUNT]);
    let recorder = graph.record(&TOPICS);
    let mut player = graph.start_playing(&bag, &[]);
    node.expect_log("stops publishing");
    std::thread::sleep(SECOND);
    assert!(graph.trigger("/scan_matcher/reset").contains("initial pose"));
    assert_eq!(player.exit_code(TIMEOUT), Some(0));
    let recording = Recording::read(&graph.finish_recording(recorder), "");
    let firsts: Vec<f64> = recording
        .timed_reports()
        .filter(|(_, report)| report.outcome == MatchReport::FIRST)
        .map(|(seconds, _)| seconds)
        .collect();
    let [start, moved, reset] = firsts[..] else { panic!("{firsts:?}") };
    assert!(start < 0.5 && (0.9..1.2).contains(&moved) && reset > 2.0, "{firsts:?}");
    let near = |seconds: f64, x: f64, y: f64| {
        let nearest = recording.poses.iter().min_by_key(|(stamp, _)| stamp.seconds_since(at(seconds)).abs().to_bits()).unwrap();
        assert!((nearest.1.x - x).hypot(nearest.1.y - y) < 0.3, "at {seconds}: {:?}", nearest.1);
    };
    near(moved, 5.0, 6.0);
    near(reset, 0.0, 0.0);
    assert!(recording.transforms.iter().all(|stamp| stamp.seconds_since(at(0.0)) < 2.2), "one parent must do");
    assert!(recording.transforms.len() > 20);
    assert!(
        recording.map_transforms.last().unwrap().seconds_since(at(0.0)) > 3.0,
        "no other node gives the odometry frame a parent"
    );
    assert_eq!(node.log().matches("stops publishing").count(), 1);
}

/// As on a `TurtleBot3`.
#[test]
fn the_node_stops_publishing_tf_if_odometry_reaches_the_base_over_several_transforms() {
    let Some(graph) = Graph::start() else { return };
    let bag = graph.dir.path().join("drive.bag");
    let transform = |seconds: f64, parent: &str, child: &str| {
        let mut stamped =
            TransformStamped { header: header(seconds, parent), child_frame_id: child.into(), ..Default::default() };
        stamped.transform.rotation.w = 1.0;
        TFMessage { transforms: vec![stamped] }
    };
    drive::write(&bag, 160, |writer| {
        for i in 0..30 {
            let seconds = 1.0 + 0.1 * f64::from(i);
            writer.write("/tf", at(seconds), &transform(seconds, "odom", "base_footprint")).unwrap();
        }
        writer.write("/tf_static", at(2.0), &transform(2.0, "base_footprint", "base_link")).unwrap();
    });
    let node = graph.node(&[MOUNT]);
    let recorder = graph.record(&TOPICS);
    graph.play(&bag, &[]);
    let recording = Recording::read(&graph.finish_recording(recorder), "");
    for transforms in [&recording.transforms, &recording.map_transforms] {
        let last = transforms.last().unwrap().seconds_since(at(0.0));
        assert!((1.5..2.5).contains(&last), "the transform must end when the odometry is known to reach the base: {last}");
    }
    assert_eq!(node.log().matches("stops publishing").count(), 2, "{}", node.log());
    assert!(node.log().contains("odom -> base_link: this node stops publishing its own transform to odom"), "{}", node.log());
}

#[test]
fn rosnode_info_lists_the_connections_of_the_node() {
    let Some(graph) = Graph::start() else { return };
    let _node = graph.node(&[MOUNT]);
    let laser = Publisher::new::<LaserScan>(&graph, "/front_laser", "/scan");
    let _link = laser.link();
    let _listener = Listener::new(&graph, "/scan_match_location");
    let info = || graph.output("rosnode", &["info", "/scan_matcher"]);
    for reported in ["* topic: /scan\n    * to: /front_laser", "* topic: /scan_match_location\n    * to: /listener"] {
        assert!(eventually(|| info().contains(reported)), "{}", info());
    }
    let info = info();
    for reported in [
        "contacting node",
        "Pid:",
        "/scan [sensor_msgs/LaserScan]",
        "direction: inbound",
        "direction: outbound",
        "/scan_matcher/reset",
    ] {
        assert!(info.contains(reported), "{reported}: {info}");
    }
    assert!(!info.contains("ERROR"), "{info}");
    for (method, reported) in [("getSubscriptions", "sensor_msgs/LaserScan"), ("getBusStats", "/scan_match_location")] {
        let answer = call(&graph.node_address("/scan_matcher"), method, &["<string>/test</string>".into()]);
        assert!(answer.contains(reported), "{method}: {answer}");
    }
    laser.unregister(&graph);
}

/// The master reports new publishers, so that a briefly latched message is neither missed nor received a second late.
#[test]
fn new_publishers_are_received_at_once() {
    let Some(graph) = Graph::alone() else { return };
    let node = graph.node(&[MOUNT]);
    let laser = Publisher::new::<LaserScan>(&graph, "/front_laser", "/scan");
    let _link = laser.link();
    std::thread::sleep(4 * SECOND); // by now the node polls the master only once a second
    let mut waits: Vec<Duration> = (0..5)
        .map(|number| {
            let start = Instant::now();
            let speaker = Publisher::new::<PoseWithCovarianceStamped>(&graph, &format!("/speaker_{number}"), "/initialpose");
            let _link = speaker.link();
            let wait = start.elapsed();
            speaker.unregister(&graph);
            std::thread::sleep(SECOND);
            wait
        })
        .collect();
    waits.sort_unstable();
    assert!(waits[2] < Duration::from_millis(300), "{waits:?}: {}", node.log());
    laser.unregister(&graph);
}

#[test]
fn ros_tools_know_our_messages_from_a_checkout() {
    let Some(graph) = Graph::start() else { return };
    let shown = graph.output("rosmsg", &["show", "anytime_scan_matcher/MatchReport"]);
    assert!(shown.contains("std_msgs/Header header") && shown.contains("string disbelieved"), "{shown}");
    // The README's line for Python.
    let script = format!(". {PACKAGE}/launch/python_messages.sh && exec rostopic echo -n 1 /icp_report");
    let mut shell = graph.command("bash");
    shell.args(["-c", &script]).env("XDG_CACHE_HOME", graph.dir.path().join("cache"));
    let mut echo = Process::spawn(shell, graph.dir.path());
    let _node = graph.node(&[MOUNT]);
    let bag = graph.dir.path().join("drive.bag");
    drive::write(&bag, 40, |_| ());
    assert!(
        eventually(|| {
            graph.play(&bag, &[]);
            echo.log().contains("mean_residual:")
        }),
        "{}",
        echo.log()
    );
    assert_eq!(echo.exit_code(TIMEOUT), Some(0));
}

#[test]
fn parameters_are_read_from_a_file_and_mistakes_end_the_node() {
    let Some(graph) = Graph::start() else { return };
    let yaml = graph.dir.path().join("car.yaml");
    fs::write(&yaml, "base_frame: car\ncontract: {time_budget: 1}\nodometry: {laser_in_base: [1, 0, 0]}\n").unwrap();
    let config = format!("_config:={}", yaml.display());
    graph
        .node(&[&config, "_odom_frame:=world", "_matching/max_correspondence_distance:=1"])
        .expect_log("(map -> car; map -> world -> car on /tf); contract: within 1s");
    graph.output("rosparam", &["delete", "/scan_matcher"]);
    for (argument, remedy) in [
        ("_matching/max_iteration:=9", "did you mean 'matching.max_iterations'?"),
        ("_matching/max_iterations:=many", "expected whole number"),
        ("_config:=nowhere.yaml", "nowhere.yaml"),
        ("_base_frame:=''", "base_frame: it is empty"),
        ("_odom_frame:=map", "odom_frame: it is 'map', as map_frame is"),
        ("_base_frame:=odom", "odom_frame: it is 'odom', as base_frame is"),
    ] {
        let mut node = graph.spawn_node(&[argument]);
        assert_eq!(node.exit_code(TIMEOUT), Some(1), "{argument}");
        assert!(node.log().contains(remedy) && node.log().contains("rosparam delete /scan_matcher"), "{}", node.log());
        graph.output("rosparam", &["delete", "/scan_matcher"]);
    }
    assert!(!graph.master_state().contains("scan_matcher"), "a node that ends must unregister from the master");
    let mut stray = graph.spawn_node(&["--rate", "10"]);
    assert_eq!((stray.exit_code(TIMEOUT), stray.log().contains("--help")), (Some(2), true));
    let mut help = graph.spawn_node(&["--help"]);
    assert_eq!((help.exit_code(TIMEOUT), help.log().contains("matching.max_iterations")), (Some(0), true));
}

#[test]
fn the_launch_file_starts_the_release_build_with_its_arguments() {
    let Some(graph) = Graph::start() else { return };
    let arguments = ["scan:=/front/scan", "time_budget:=5ms", "base_frame:=car", "laser_in_base:=[1, 0, 0]"];
    let mut launch = graph.launch("scan_matcher.launch", &arguments);
    launch
        .expect_log("matching /front/scan with /odom; poses on /scan_match_location (map -> car; map -> odom -> car on /tf); contract: within 5ms");
    launch.signal("INT");
    assert!(launch.exit_code(TIMEOUT).is_some());
    for (arguments, reported) in [
        (&["correspondence:=kd_tree", "solver:=linearized"][..], "method: kd_tree + linearized"),
        (&["solver:=point_to_point"], "point_to_point has no effect with matching.correspondence projective"),
        (&["matcher:=plicp"], "method: jump_table + point_to_line"),
        (&["matcher:=plicp", "solver:=point_to_point"], "method: jump_table + point_to_point"),
        (&["matcher:=nonesuch"], "matcher_nonesuch.yaml"),
    ] {
        let launch = graph.launch("scan_matcher.launch", arguments);
        launch.expect_log(reported);
        assert_eq!(launch.log().contains("WARN"), reported.contains("has no effect"), "{}", launch.log());
    }
    for arguments in [
        &["scan_matcher.launch"][..],
        &["laser_scan_matcher_compat.launch"],
        &["racecar_simulator.launch", "simulator:=built_in"],
        &["replay.launch", "bag:=any.bag", "rviz:=true"],
        &["contract_demo.launch"],
    ] {
        let nodes = graph.output("roslaunch", &[&["--nodes", "anytime_scan_matcher"], arguments].concat());
        assert!(nodes.contains("scan_matcher"), "{nodes}");
    }
}

/// Checks that the installed tree has the layout of a package, and that `roslaunch` finds the node in it.
fn check_installed(graph: &Graph) {
    let install = graph.dir.path().join("install");
    let programs = ["scan_matcher", "scan_matcher_node", "contract_demo_node", "racecar_sim_node", "anytime"];
    let files = programs.map(|name| format!("lib/anytime_scan_matcher/{name}"));
    let share = [
        "package.xml",
        "msg/Contract.msg",
        "msg/MatchReport.msg",
        "launch/scan_matcher.launch",
        "launch/laser_scan_matcher_compat.launch",
        "launch/scan_matcher.rviz",
        "launch/plotjuggler.xml",
        "launch/matcher_plicp.yaml",
        "maps/corridor.yaml",
        "maps/corridor.png",
    ];
    let share = share.map(|name| format!("share/anytime_scan_matcher/{name}"));
    let header = "include/anytime_scan_matcher/shared_memory.h".to_owned();
    for file in files.iter().chain(&share).chain([&header]) {
        assert!(install.join(file).is_file(), "{file} is not installed");
    }
    let mut command = graph.command(install.join("env.sh"));
    command.env_remove("ROS_PACKAGE_PATH").args(["roslaunch", "anytime_scan_matcher", "scan_matcher.launch", "name:=installed"]);
    let launch = Process::spawn(command, graph.dir.path());
    launch.expect_log("/installed: matching /scan");
}

#[test]
fn catkin_builds_what_rostopic_needs_to_show_our_messages() {
    let Some(graph) = Graph::start() else { return };
    if !installed("catkin_make") {
        return;
    }
    let source = graph.dir.path().join("src");
    fs::create_dir(&source).unwrap();
    std::os::unix::fs::symlink(PACKAGE, source.join("anytime_scan_matcher")).unwrap();
    let mut make = graph.command("catkin_make");
    // The tests of rostest run in the first python3 on the path, which must be ROS's.
    let path = format!("/usr/bin:{}", std::env::var("PATH").unwrap());
    let programs = format!("-DBUILT_PROGRAMS={}", Path::new(NODE).parent().unwrap().display());
    make.env_remove("ROS_PACKAGE_PATH").env("PATH", path).env("ROS_LANG_DISABLE", "gencpp:geneus:genlisp:gennodejs").args([
        "install",
        "run_tests",
        "-DPYTHON_EXECUTABLE=/usr/bin/python3",
        &programs,
    ]);
    let mut make = Process::spawn(make, graph.dir.path());
    assert_eq!(make.exit_code(Duration::from_secs(900)), Some(0), "{}", make.log());
    let results = graph.output("catkin_test_results", &["build/test_results"]);
    assert!(results.contains("Summary: 2 tests, 0 errors, 0 failures"), "{results}: {}", make.log());
    let program = graph.dir.path().join("devel/lib/anytime_scan_matcher/scan_matcher");
    assert!(program.is_file(), "{}", make.log());
    check_installed(&graph);

    for space in ["devel", "install"] {
        let env = graph.dir.path().join(space).join("env.sh");
        let mut rosmsg = graph.command(env);
        let shown =
            rosmsg.env_remove("ROS_PACKAGE_PATH").args(["rosmsg", "show", "anytime_scan_matcher/MatchReport"]).output().unwrap();
        assert!(String::from_utf8_lossy(&shown.stdout).contains("std_msgs/Header header"), "{space}: {shown:?}");
    }
    let _node = graph.spawn(program.to_str().unwrap(), &[MOUNT]);
    let bag = graph.dir.path().join("drive.bag");
    drive::write(&bag, 40, |_| ());
    let env = graph.dir.path().join("devel/env.sh");
    let mut echo = graph.spawn(env.to_str().unwrap(), &["rostopic", "echo", "-n", "1", "/icp_report"]);
    assert!(eventually(|| {
        graph.play(&bag, &[]);
        echo.log().contains("mean_residual:")
    }));
    assert_eq!(echo.exit_code(TIMEOUT), Some(0));
}

#[test]
fn the_node_waits_for_a_master_and_survives_its_restart() {
    let Some(mut graph) = Graph::without_master() else { return };
    let mut node = graph.spawn_node(&[]);
    node.expect_log("waiting for it");
    graph.start_master();
    node.expect_log("matching /scan");
    graph.stop_master();
    node.expect_log("the ROS master does not answer");
    assert!(node.is_running());
    graph.start_master();
    node.expect_log("registered again");
    let bag = graph.dir.path().join("drive.bag");
    drive::write(&bag, 40, |_| ());
    let recorder = graph.record(&TOPICS);
    graph.play(&bag, &[]);
    let recording = Recording::read(&graph.finish_recording(recorder), "");
    recording.check_consistency();
    recording.check_accounts(40);
    assert!(graph.trigger("/scan_matcher/reset").contains("initial pose"));
    graph.stop_master();
    node.signal("INT");
    assert_eq!(node.exit_code(SECOND), Some(0), "{}", node.log());
}

#[test]
fn signals_end_the_node_within_a_second() {
    let Some(mut graph) = Graph::alone_without_master() else { return };
    let ends = |mut node: Process, signal: &str| {
        node.signal(signal);
        let start = Instant::now();
        assert_eq!(node.exit_code(TIMEOUT), Some(0), "{signal}: {}", node.log());
        assert!(start.elapsed() < SECOND, "{signal}: {:?}", start.elapsed());
    };
    for signal in ["INT", "TERM"] {
        let node = graph.spawn_node(&[]);
        node.expect_log("waiting for it");
        ends(node, signal);
    }
    graph.start_master();
    for (signal, milliseconds) in [("INT", 30), ("TERM", 60), ("INT", 120), ("TERM", 250)] {
        let node = graph.spawn_node(&[]);
        std::thread::sleep(Duration::from_millis(milliseconds));
        ends(node, signal);
    }
    for signal in ["INT", "TERM"] {
        ends(graph.node(&[]), signal);
    }
    let bag = graph.dir.path().join("drive.bag");
    drive::write(&bag, 200, |_| ());
    let node = graph.node(&[MOUNT]);
    let _player = graph.start_playing(&bag, &["--loop"]);
    node.expect_log("from odometry.laser_in_base"); // logged with the first answer
    ends(node, "INT");
    assert!(within(TIMEOUT, || !graph.master_state().contains("scan_matcher")), "its name must be gone");
}
