//! The mapper on a live graph: its map by topic, by service and as files, and localization on it.

use std::fs;
use std::path::Path;
use std::process::Command;

use anytime_scan_matcher::app::{map_message, planar_pose};
use anytime_scan_matcher::geometry::Pose2;
use anytime_scan_matcher::io::bag::Bag;
use anytime_scan_matcher::io::map_file;
use anytime_scan_matcher::map::grid::{Cell, OccupancyGrid};
use anytime_scan_matcher::messages::decode;
use anytime_scan_matcher::messages::nav_msgs::{OccupancyGrid as MapMessage, Odometry};
use anytime_scan_matcher::time::Stamp;
use rosrust::Message as _;
use rosrust_msg::nav_msgs::GetMap;
use serde_json::Value;

use crate::common::graph::{Graph, Process, TIMEOUT, eventually};
use crate::common::program::json;
use crate::localization::{Drive, Received, TOPICS, map_file};

const PROGRAM: &str = env!("CARGO_BIN_EXE_mapper");
const FILTER: &str = env!("CARGO_BIN_EXE_particle_filter");
/// Playback rate that suits a busy machine.
const FAST: [&str; 2] = ["--rate", "2"];

/// A mapper that is ready for the bag of a drive, with its map in the frame of the truth.
fn start(graph: &Graph, drive: &Drive, arguments: &[&str]) -> Process {
    let start = drive.initial_pose().replace("localization", "odometry");
    let folder = format!("_mapping/directory:={}", graph.dir.path().display());
    let mapper = graph.spawn(PROGRAM, &[&[&*start, &*folder], arguments].concat());
    mapper.expect_log("; poses on ");
    mapper
}

fn known(map: &OccupancyGrid) -> usize {
    map.cells().iter().filter(|cell| **cell != Cell::Unknown).count()
}

/// The map returned by the service.
fn served(graph: &Graph) -> OccupancyGrid {
    let answer = graph.request("/dynamic_map", &GetMap::msg_type(), &GetMap::md5sum(), &[]);
    map_message::grid(&decode::<MapMessage>(&answer).unwrap()).unwrap()
}

/// Compares a saved map with the corridor.
fn compare(folder: &Path, name: &str) -> Value {
    let path = |name: &str| folder.join(name).to_str().unwrap().to_owned();
    json(&["evaluate", "--map", &path(name), "--truth-map", &path("corridor.yaml"), "--json"])
}

#[test]
fn the_particle_filter_localizes_on_the_map_of_a_drive() {
    let Some(graph) = Graph::start() else { return };
    let drive = Drive::write(graph.dir.path(), 24.0, |_, _| ());
    map_file(graph.dir.path());
    let mapper = start(&graph, &drive, &["_mapping/name:=hall"]);
    let recorder = graph.record(&["/map", "/icp/odom"]);
    graph.play(&drive.bag, &FAST);
    graph.spawn(FILTER, &[]).expect_log("using a map of"); // the map is latched
    let message = graph.trigger("/mapper/save_map");
    assert!(message.contains("hall.yaml"), "{message}");
    mapper.expect_log("the map is saved");
    let saved = map_file::read(&graph.dir.path().join("hall.yaml")).unwrap();
    assert!(
        eventually(|| known(&served(&graph)).abs_diff(known(&saved)) < known(&saved) / 50),
        "the service must return the whole map"
    );
    let folder = graph.dir.path().to_owned();
    let recorded = graph.finish_recording(recorder);
    let (maps, is_smooth) = (recorded_maps(&recorded), is_odometry_smooth(&recorded));
    let seconds = maps[maps.len() - 1].0 - maps[0].0;
    assert!(maps.len() as f64 <= seconds + 2.0, "once a second at most, late ones beside others: {maps:?}");
    assert!(is_smooth, "the odometry must never jump");
    assert!(maps.len() > 4 && maps[maps.len() - 1].1 > maps[0].1, "the map must grow: {maps:?}");
    assert!(fs::metadata(folder.join("hall.graph")).unwrap().len() > 10_000);
    let found = compare(&folder, "hall.yaml");
    assert!(found["occupied_to_truth"]["over_10_cm"].as_f64().unwrap() < 0.02, "{found}");
    drop(mapper);

    let map = format!("_localization/map:={}", folder.join("hall.yaml").display());
    let filter = graph.spawn(FILTER, &[&map, &drive.initial_pose()]);
    filter.expect_log("using a map");
    let recorder = graph.record(&TOPICS);
    graph.play(&drive.bag, &FAST);
    let received = Received::read(&graph.finish_recording(recorder));
    assert!(received.poses.len() > 200, "{}", received.poses.len());
    received.check_poses(&drive, 0.15);
}

/// Whether the robot can have driven between all successive recorded poses of the odometry.
fn is_odometry_smooth(bag: &Path) -> bool {
    let bag = Bag::open(bag).unwrap();
    let pose = |odometry: Odometry| (Stamp::from(odometry.header.stamp), planar_pose(&odometry.pose.pose).unwrap());
    let poses: Vec<(Stamp, Pose2)> =
        bag.messages(Some(&["/icp/odom"])).map(|message| pose(message.unwrap().decode().unwrap())).collect();
    let is_possible = |a: &(Stamp, Pose2), b: &(Stamp, Pose2)| a.1.between(&b.1).distance() < 5.0 * b.0.seconds_since(a.0) + 0.1;
    poses.len() > 50 && poses.windows(2).all(|pair| is_possible(&pair[0], &pair[1]))
}

/// The time of each recorded map, s, and its number of known cells.
fn recorded_maps(bag: &Path) -> Vec<(f64, usize)> {
    let bag = Bag::open(bag).unwrap();
    let messages = bag.messages(Some(&["/map"])).map(Result::unwrap);
    messages
        .map(|message| {
            let map = map_message::grid(&message.decode::<MapMessage>().unwrap()).unwrap();
            (message.time.seconds_since(Stamp::default()), known(&map))
        })
        .collect()
}

#[test]
fn the_map_is_saved_when_the_node_ends() {
    let Some(graph) = Graph::start() else { return };
    let drive = Drive::write(graph.dir.path(), 8.0, |_, _| ());
    map_file(graph.dir.path());
    let mut mapper = start(&graph, &drive, &["_mapping/save_on_exit:=true"]);
    graph.play(&drive.bag, &FAST);
    // A slow file: the node must end when it is written, and not before.
    let slow = graph.dir.path().join("map.graph");
    assert!(Command::new("mkfifo").arg(&slow).status().unwrap().success());
    mapper.signal("INT");
    std::thread::sleep(std::time::Duration::from_millis(1500));
    assert!(mapper.is_running(), "{}", mapper.log());
    assert!(fs::read(&slow).unwrap().starts_with(b"ATSMGRAF"));
    assert_eq!(mapper.exit_code(TIMEOUT), Some(0), "{}", mapper.log());
    mapper.expect_log("the map is saved");
    let found = compare(graph.dir.path(), "map.yaml");
    assert!(found["occupied_to_truth"]["over_10_cm"].as_f64().unwrap() < 0.02, "{found}");
}

#[test]
fn the_map_can_be_saved_after_a_failed_attempt() {
    let Some(graph) = Graph::start() else { return };
    let drive = Drive::write(graph.dir.path(), 5.0, |_, _| ());
    let folder = graph.dir.path().join("maps");
    let mapper = start(&graph, &drive, &[&format!("_mapping/directory:={}", folder.display())]);
    let (success, problem) = graph.call("/mapper/save_map");
    assert!(!success && problem.contains("maps/map.yaml"), "no folder: {problem}");
    fs::create_dir(&folder).unwrap();
    let (success, problem) = graph.call("/mapper/save_map");
    assert!(!success && problem.contains("no scan has been added"), "{problem}");
    graph.play(&drive.bag, &FAST);
    // A folder that nobody can write to, not even root, as which the tests may run.
    fs::remove_dir(&folder).unwrap();
    std::os::unix::fs::symlink("/proc", &folder).unwrap();
    let (success, problem) = graph.call("/mapper/save_map");
    assert!(!success && problem.contains("map.yaml") && problem.contains("mapping/directory"), "{problem}");
    mapper.expect_log("the map is not saved");
    fs::remove_file(&folder).unwrap();
    fs::create_dir(&folder).unwrap();
    graph.trigger("/mapper/save_map");
    assert!(folder.join("map.pgm").is_file());
    assert!(graph.spawn(PROGRAM, &["_mapping/name:=../map"]).exit_code(TIMEOUT) == Some(1), "a name must not be a path");
}

#[test]
fn the_launch_file_passes_its_arguments() {
    let Some(graph) = Graph::start() else { return };
    let drive = Drive::write(graph.dir.path(), 6.0, |_, _| ());
    let (bag, directory) = (format!("bag:={}", drive.bag.display()), format!("directory:={}", graph.dir.path().display()));
    let arguments = [
        &*bag,
        &*directory,
        "map_name:=by_launch",
        "save_on_exit:=true",
        "resolution:=0.1",
        "time_budget:=20ms",
        "stop_at_end:=true",
        "rate:=2",
    ];
    let mut launch = graph.launch("mapper.launch", &arguments);
    launch.expect_log("matching /scan with /odom; poses on /scan_match_location");
    assert!(launch.exit_code(3 * TIMEOUT).is_some(), "{}", launch.log());
    let map = map_file::read(&graph.dir.path().join("by_launch.yaml")).unwrap();
    assert!((map.resolution() - 0.1).abs() < 1e-9 && known(&map) > 1000);
    let shown = graph.output("roslaunch", &["--nodes", "anytime_scan_matcher", "mapper.launch", "rviz:=true"]);
    assert!(shown.contains("/mapper") && shown.contains("/rviz") && !shown.contains("/bag"), "{shown}");
}
