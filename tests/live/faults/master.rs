//! roscore dies, and comes back without its parameters.

use std::time::Instant;

use super::bench::Bench;
use crate::common::graph::eventually;

#[test]
fn the_node_registers_with_a_new_master_and_keeps_its_state() {
    let Some(mut bench) = Bench::start(541) else { return };
    for _ in 0..40 {
        bench.step();
    }
    let (_, before) = bench.step();
    let resources = bench.resources();
    bench.graph.stop_master();
    bench.node.expect_log("the ROS master does not answer");
    bench.check_step(); // existing connections need no master
    bench.graph.start_master();
    let back = Instant::now();
    bench.node.expect_log("registered again");
    eprintln!("registered again after {:.1} s", back.elapsed().as_secs_f64());
    let state = bench.graph.master_state();
    for topic in ["/scan", "/odom", "/tf", "/scan_match_location", "/icp_report", "/diagnostics", "/scan_matcher/reset"] {
        assert!(state.contains(topic), "{topic} is not in {state}");
    }
    bench.check_step(); // only the old connection exists

    bench.lidar.register(&bench.graph);
    bench.scans.shutdown(std::net::Shutdown::Both).unwrap();
    bench.scans = bench.lidar.link(); // the new master reports it, and it is connected again
    bench.check_step();
    let (_, after) = bench.step();
    assert!(after.keyframes >= before.keyframes && after.header.seq > before.header.seq, "{before:?} {after:?}");
    assert!(bench.graph.trigger("/scan_matcher/reset").contains("initial pose"));
    let as_before = || bench.resources().threads <= resources.threads && bench.resources().files <= resources.files;
    assert!(eventually(as_before), "{resources:?} before, {:?}", bench.resources());
}
