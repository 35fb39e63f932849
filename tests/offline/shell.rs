//! Command line behaviour: files that must not be destroyed, losses that must be reported, invalid arguments.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use anytime_scan_matcher::geometry::Pose2;
use anytime_scan_matcher::io::bag::{BagWriter, Compression};
use anytime_scan_matcher::messages::sensor_msgs::LaserScan;
use anytime_scan_matcher::time::Stamp;
use serde_json::Value;

use crate::common::Laser;

/// A working folder with the demo bag and its truth.
struct Desk(tempfile::TempDir);

impl Desk {
    fn new() -> Self {
        let desk = Self(tempfile::tempdir().unwrap());
        for name in ["demo.bag", "demo.tum"] {
            fs::copy(Path::new(env!("CARGO_MANIFEST_DIR")).join("bags").join(name), desk.path(name)).unwrap();
        }
        desk
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn write(&self, name: &str, text: &str) {
        fs::write(self.path(name), text).unwrap();
    }

    fn read(&self, name: &str) -> Vec<u8> {
        fs::read(self.path(name)).unwrap()
    }

    fn names(&self) -> usize {
        fs::read_dir(self.0.path()).unwrap().count()
    }

    /// Runs a command line, split at spaces.
    fn run(&self, line: &str) -> Output {
        Command::new(env!("CARGO_BIN_EXE_anytime")).args(line.split(' ')).current_dir(self.0.path()).output().unwrap()
    }

    /// The error text of a run that must fail with this exit code.
    fn failure(&self, line: &str, code: i32) -> String {
        let output = self.run(line);
        let error = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(code), "{line}: {error}");
        error
    }
}

/// Writes scans of a room at 20 Hz, each modified by `change`.
fn write_scans(path: &Path, change: impl Fn(&mut LaserScan)) {
    let mut writer = BagWriter::create(path, Compression::None).unwrap();
    for i in 0..12 {
        let stamp = Stamp::from_ros(1000, i * 50_000_000);
        let mut scan = Laser::with_field_of_view(270.0, 361).message(stamp, Pose2::IDENTITY);
        change(&mut scan);
        writer.write("/scan", stamp, &scan).unwrap();
    }
    writer.finish().unwrap();
}

#[test]
fn no_output_destroys_an_input_or_another_output() {
    let desk = Desk::new();
    let (bag, truth) = (desk.read("demo.bag"), desk.read("demo.tum"));
    desk.write("costs.yaml", "[]\n");
    desk.write("in.clf", "FLASER 1 1 0 0 0 0 0 0 1 host 1\n");
    desk.write("map.yaml", "image: map.png\n");
    fs::create_dir(desk.path("sub")).unwrap();
    #[cfg(unix)]
    {
        std::os::unix::fs::symlink("demo.bag", desk.path("link.bag")).unwrap();
        fs::hard_link(desk.path("demo.tum"), desk.path("hard.tum")).unwrap();
        desk.failure("replay demo.bag --csv link.bag", 2);
        desk.failure("replay demo.bag --truth demo.tum --tum hard.tum", 2);
    }
    let count = desk.names();
    let reported = desk.failure("replay demo.bag --tum ./demo.bag", 2);
    assert!(reported.contains("--tum and the bag are the same file") && reported.contains("./demo.bag"), "{reported}");
    for line in [
        "replay demo.bag --tum out --csv sub/../out",
        "replay demo.bag --tum out.svg --plot out.svg",
        "replay demo.bag --truth demo.tum --csv demo.tum",
        "replay demo.bag --tum costs.yaml --set contract.cost_file=costs.yaml",
        "replay demo.bag --contract-schedule costs.yaml --csv costs.yaml",
        "localize demo.bag --map map.yaml --tum map.yaml",
        "localize demo.bag --map map.yaml --tum map.png",
        "localize demo.bag --map map.yaml --tum out --csv ./out",
        "simulate --world map.yaml --out ./map.png",
        "evaluate demo.tum --truth demo.tum --plot ./demo.tum",
        "convert in.clf ./in.clf",
        "simulate --world map.yaml --out map.yaml",
        "simulate --world room --out x.bag --truth x.bag",
        "profile demo.bag --truth ./profile.yaml --out .",
    ] {
        // The extension of a plot is checked first.
        let reported = desk.failure(line, 2);
        assert!(reported.contains("are the same file") || reported.contains("only SVG"), "{line}: {reported}");
    }
    assert!(desk.read("demo.bag") == bag && desk.read("demo.tum") == truth && desk.names() == count);
}

#[test]
fn a_failed_run_leaves_older_files_unchanged() {
    let desk = Desk::new();
    for name in ["old.tum", "old.csv", "old.bag", "old.svg"] {
        desk.write(name, "precious");
    }
    desk.write("broken.bag", "this is no bag\n");
    desk.write("empty.clf", "# nothing\n");
    write_scans(&desk.path("sane.bag"), |_| ());
    let count = desk.names();
    desk.failure("replay broken.bag --tum old.tum --csv old.csv", 1);
    desk.failure("replay demo.bag --tum old.tum --csv no/such.csv", 1);
    desk.failure("replay demo.bag --tum old.tum --csv old.csv --set contract.profile=no/such.yaml", 1);
    desk.failure("convert empty.clf old.bag", 1);
    desk.failure("simulate --world room --out old.bag --truth no/such.tum --duration 1s", 1);
    desk.failure("evaluate demo.tum --truth no.tum --plot old.svg", 1);
    for name in ["old.tum", "old.csv", "old.svg", "old.bag"] {
        assert_eq!(desk.read(name), b"precious", "{name}");
    }
    assert_eq!(desk.names(), count, "no files must be left behind");
    assert!(desk.run("replay sane.bag --tum old.tum --csv old.csv --plot old.svg").status.success());
    assert!(desk.read("old.tum") != b"precious" && desk.read("old.csv") != b"precious" && desk.names() == count);
}

#[test]
fn a_killed_run_leaves_older_files_unchanged() {
    let desk = Desk::new();
    desk.write("old.bag", "precious");
    let count = desk.names();
    let mut run = Command::new(env!("CARGO_BIN_EXE_anytime"))
        .args(["simulate", "--world", "room", "--out", "old.bag", "--duration", "300s"])
        .current_dir(desk.0.path())
        .spawn()
        .unwrap();
    while desk.names() == count && run.try_wait().unwrap().is_none() {
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    run.kill().unwrap();
    assert!(!run.wait().unwrap().success(), "it must have been killed before its end");
    assert_eq!(desk.read("old.bag"), b"precious");
}

/// `/dev/full` acts as a full disk. Files that are not regular are written to directly.
#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_is_reported() {
    let desk = Desk::new();
    assert!(desk.failure("replay demo.bag --tum /dev/full", 1).contains("cannot write /dev/full"));
    assert!(desk.run("replay demo.bag --tum /dev/null --csv /dev/null").status.success());
    let to_stdout = desk.run("replay demo.bag --tum /dev/stdout").stdout;
    assert!(String::from_utf8(to_stdout).unwrap().lines().count() > 400);
}

#[test]
fn only_svg_plots_are_supported() {
    let desk = Desk::new();
    for line in ["replay demo.bag --plot x.png", "evaluate demo.tum --truth demo.tum --plot x.PDF"] {
        let reported = desk.failure(line, 2);
        assert!(reported.contains("only SVG plots are supported"), "{reported}");
    }
}

#[test]
fn every_command_reports_a_damaged_bag() {
    let desk = Desk::new();
    let bag = desk.read("demo.bag");
    fs::write(desk.path("cut.bag"), &bag[..bag.len() * 2 / 3]).unwrap();
    fs::write(desk.path("short.bag"), &bag[..5000]).unwrap();
    let text = String::from_utf8(desk.run("replay cut.bag").stdout).unwrap();
    assert!(text.contains("warning: the bag is damaged") && text.contains("rosbag reindex"), "{text}");
    let json: Value = serde_json::from_slice(&desk.run("replay cut.bag --json").stdout).unwrap();
    assert!(!json["bag_problems"].as_array().unwrap().is_empty(), "{json}");
    let json: Value = serde_json::from_slice(&desk.run("replay demo.bag --json").stdout).unwrap();
    assert!(json["bag_problems"].as_array().unwrap().is_empty(), "{json}");
    let reported = desk.failure("replay short.bag", 1);
    assert!(reported.contains("there is no topic /scan") && reported.contains("the bag is damaged"), "{reported}");
}

#[test]
fn only_malformed_scans_are_a_failure_with_its_reason() {
    let desk = Desk::new();
    write_scans(&desk.path("bad.bag"), |scan| scan.angle_increment = 0.0);
    let output = desk.run("replay bad.bag --json");
    assert_eq!(output.status.code(), Some(1));
    let json: Value = serde_json::from_slice(&output.stdout).unwrap();
    let reported = json["problems"].to_string();
    assert!(json["scans"] == 12 && reported.contains("12 of 12 scans are malformed") && reported.contains("increment"), "{json}");
    let reported = desk.failure("replay bad.bag", 1);
    assert!(reported.contains("bad.bag: 12 of 12 scans are malformed; the first: "), "{reported}");
    let text = String::from_utf8(desk.run("replay bad.bag").stdout).unwrap();
    assert!(text.contains("12 of 12 scans are malformed; the first: "), "{text}");
    let reported = desk.failure("map bad.bag --out m", 1);
    assert!(reported.contains("no scan on /scan could be used: 12 of 12 scans are malformed; the first: "), "{reported}");
    assert!(!desk.path("m.pgm").exists());
}

#[test]
fn files_that_are_not_logs_are_identified() {
    let desk = Desk::new();
    fs::write(desk.path("x.mcap"), b"\x89MCAP0\r\n and so on").unwrap();
    let reported = desk.failure("convert x.mcap y.bag", 1);
    assert!(reported.contains("x.mcap is a ROS 2 bag, MCAP") && reported.contains("rosbags-convert"), "{reported}");
    let reported = desk.failure("convert demo.bag y.bag", 1);
    assert!(reported.contains("demo.bag is a bag already"), "{reported}");
}

#[test]
fn relations_of_another_log_are_a_failure() {
    let desk = Desk::new();
    desk.write("x.relations", "1 2 1 0 0 0 0 0\n");
    let reported = desk.failure("evaluate demo.tum --relations x.relations", 1);
    assert!(reported.contains("no relation of x.relations"), "{reported}");
}

#[test]
fn wrong_usage_is_explained_and_exits_with_two() {
    let desk = Desk::new();
    for (line, reported) in [
        ("replay demo.bag --set foo", "NAME=VALUE"),
        ("replay demo.bag --set max_iteration=3", "did you mean 'matching.max_iterations'?"),
        ("replay demo.bag --set matching.max_iterations=0", "1 to 1000, got 0"),
        ("replay demo.bag --set contract.time_budget=.nan", "finite number"),
        ("replay demo.bag --time-budget -5ms", "got -0.005, which is negative"),
        ("replay demo.bag --time-budget -1", "got -1, which is negative"),
        ("replay demo.bag --time-budget 61", "0 to 60, got 61"),
        ("localize demo.bag --map m.yaml --time-budget=-5ms", "which is negative"),
        ("localize demo.bag", "--map M.yaml"),
        ("localize demo.bag --map m.yaml --particles 1", "localization.particles"),
        ("simulate --world room --out x.bag --beams 0", "beams: expected"),
        ("simulate --world room --out x.bag --duration -5", "-5"),
        ("map demo.bag --out m --resolution -1", "expected 0.005 to 1 (metres)"),
        ("profile demo.bag --truth demo.tum --out p --rounds -1", "-1"),
        ("simulate --world rom --out x.bag", "--world: expected corridor | room, got \"rom\""),
    ] {
        let error = desk.failure(line, 2);
        assert!(error.contains(reported) && !error.contains("unexpected argument"), "{line}: {error}");
    }
    let map = Path::new(env!("CARGO_MANIFEST_DIR")).join("maps/corridor.yaml");
    let off_the_map = desk.failure(&format!("localize demo.bag --map {} --initial-pose 1000,0,0", map.display()), 2);
    assert!(off_the_map.contains("--initial-pose: (1000.00, 0.00) is outside the map"), "{off_the_map}");
    let unknown = desk.failure("replay demo.bag --set matching.foo=1", 2);
    assert!(unknown.contains("the nearest names are:") && unknown.len() < 300, "{unknown}");
    let json = |line: &str| serde_json::from_slice::<Value>(&desk.run(line).stdout).unwrap();
    let budget = |text: &str| json(&format!("replay demo.bag --json --time-budget {text}"))["deadline"]["budget_us"].clone();
    assert_eq!((budget("0.005"), budget("5ms")), (5000.0.into(), 5000.0.into()));
}

#[test]
fn yaml_errors_name_line_and_column() {
    let desk = Desk::new();
    for (text, reported) in [
        ("matching:\n  max_iterations: 8\n  max_iterations: 9\n", "x.yaml: line 3, column 3: duplicate key 'max_iterations'"),
        ("contract:\n  time_budget: .nan\n", "x.yaml: line 2, column 16: found .nan"),
        ("contract: [\n", "x.yaml: this is not YAML: line 1, column 11"),
    ] {
        desk.write("x.yaml", text);
        let error = desk.failure("replay demo.bag --config x.yaml", 2);
        assert!(error.contains(reported) && !error.contains("Policy"), "{error}");
    }
    assert!(desk.failure("replay demo.bag --config no.yaml", 1).contains("no.yaml"));
}
