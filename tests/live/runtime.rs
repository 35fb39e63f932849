//! Services and parameter changes while a node runs.

use std::fs;

use rosrust_msg::anytime_scan_matcher::MatchReport;

use crate::common::drive::{self, MOUNT, Recording, TOPICS};
use crate::common::graph::{Graph, eventually};

#[test]
fn matching_costs_are_saved_on_request_only_to_the_configured_file() {
    let Some(graph) = Graph::start() else { return };
    let node = graph.node(&[]);
    let (done, problem) = graph.call("/scan_matcher/save_profile");
    assert!(!done && problem.contains("contract/cost_file"), "{problem}");
    drop(node);
    let costs = graph.dir.path().join("costs.yaml");
    let _node = graph.node(&[&format!("_contract/cost_file:={}", costs.display())]);
    assert!(!costs.exists());
    let (done, reported) = graph.call("/scan_matcher/save_profile");
    assert!(done && reported.contains("costs.yaml"), "{reported}");
    assert!(fs::read_to_string(&costs).unwrap().contains("iteration"), "the warm-up must have learned costs");
}

#[test]
fn only_some_parameters_can_change_at_run_time() {
    let Some(graph) = Graph::start() else { return };
    let bag = graph.dir.path().join("drive.bag");
    drive::write(&bag, 320, |_| ());
    let to_the_end = ["_matching/epsilon_translation:=0", "_matching/epsilon_rotation:=0", "_publish_tf:=false"];
    let node = graph.node(&[&[MOUNT][..], &to_the_end].concat());
    let recorder = graph.record(&TOPICS);
    let mut player = graph.start_playing(&bag, &[]);
    node.expect_log("from odometry.laser_in_base"); // logged with the first answer
    for (name, value) in [
        ("contract/time_budget", "7ms"),
        ("matching/max_iterations", "1"),
        ("publish_tf", "true"),
        ("matching/solver", "linearized"),
        ("matching/max_iterations_", "3"),
    ] {
        graph.output("rosparam", &["set", &format!("/scan_matcher/{name}"), value]);
    }
    for reported in [
        "contract.time_budget = \"7ms\": now in effect",
        "matching.max_iterations = 1: now in effect",
        "publish_tf = true: now in effect",
        "matching.solver = \"linearized\": change ignored: it takes effect after a restart of the node",
        "did you mean 'matching.max_iterations'?",
    ] {
        node.expect_log(reported);
    }
    assert!(eventually(|| !player.is_running()));
    let recording = Recording::read(&graph.finish_recording(recorder), "");
    recording.check_consistency();
    let (first, last) = (&recording.reports[0], &recording.reports[recording.reports.len() - 1]);
    let budget = |report: &MatchReport| (report.time_budget.sec, report.time_budget.nsec);
    assert_eq!([budget(first), budget(last)], [(0, 0), (0, 7_000_000)]);
    assert!(recording.reports.iter().any(|report| report.iterations > 2) && last.iterations <= 2, "{last:?}");
    let transforms = recording.transforms.len();
    assert!(transforms > 0 && transforms < recording.reports.len(), "{transforms} of {}", recording.reports.len());
    assert_eq!(node.log().matches("change ignored").count(), 2, "each must be logged once: {}", node.log());
}
