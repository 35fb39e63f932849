//! The time contract on a live graph: changed, interrupted by topic and by shared memory, missed, and monitored by a controller.

use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use anytime_scan_matcher::io::bag::Bag;
use anytime_scan_matcher::messages;
use anytime_scan_matcher::messages::own::Contract;
use anytime_scan_matcher::shared_memory::{Client, CompletedEstimate};
use anytime_scan_matcher::time::Stamp;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use rosrust::RosMsg as _;
use rosrust_msg::anytime_scan_matcher::MatchReport;
use rosrust_msg::diagnostic_msgs::{DiagnosticArray, DiagnosticStatus};

use crate::common::drive::{self, MOUNT, Recording, TOPICS, at, header};
use crate::common::graph::{Graph, PACKAGE, Process, TIMEOUT, eventually};
use crate::peer;

/// Parameters that make matching slow, so that there is always work left to interrupt.
const SLOW: [&str; 4] = [
    "_matching/solver:=point_to_point",
    "_matching/epsilon_translation:=0",
    "_matching/epsilon_rotation:=0",
    "_matching/max_iterations:=1000",
];

/// Starts a node and plays a drive of `scans` scans with `beams` beams to it; returns the node and the recording.
fn play_to_node(graph: &Graph, parameters: &[&str], scans: u32, beams: usize) -> (Process, Recording) {
    let bag = graph.dir.path().join("drive.bag");
    drive::write_with_beams(&bag, scans, beams, |_| ());
    let node = graph.node(&[&[MOUNT][..], parameters].concat());
    let recorder = graph.record(&TOPICS);
    graph.play(&bag, &[]);
    (node, Recording::read(&graph.finish_recording(recorder), ""))
}

/// Checks that the fields of a report about the contract agree with its other fields.
fn check_report(report: &MatchReport) {
    let [budget, elapsed, overrun] = [report.time_budget, report.elapsed, report.overrun].map(span);
    let expected = if budget.is_zero() { Duration::ZERO } else { elapsed.saturating_sub(budget) };
    assert_eq!((report.deadline_met, overrun), (expected.is_zero(), expected), "{report:?}");
    let excess = |error: f64, bound: f64| if bound > 0.0 { (error - bound).max(0.0) } else { 0.0 };
    let excesses = [
        (report.translation_error_excess, excess(report.translation_error, report.translation_error_bound)),
        (report.rotation_error_excess, excess(report.rotation_error, report.rotation_error_bound)),
    ];
    assert!(excesses.iter().all(|(found, expected)| found.to_bits() == expected.to_bits()), "{report:?}");
}

fn span(duration: rosrust::Duration) -> Duration {
    messages::Duration { sec: duration.sec, nsec: duration.nsec }.span()
}

#[test]
fn a_valid_contract_applies_from_the_next_scan_on_and_an_invalid_one_is_rejected() {
    let Some(graph) = Graph::start() else { return };
    let bag = graph.dir.path().join("drive.bag");
    let contract = |seconds, nsec, translation_error_bound, rotation_error_bound| Contract {
        header: header(seconds, ""),
        time_budget: messages::Duration { sec: 0, nsec },
        translation_error_bound,
        rotation_error_bound,
    };
    drive::write(&bag, 160, |writer| {
        writer.write("/icp_contract", at(1.0), &contract(1.0, 7_000_000, 0.2, 0.1)).unwrap();
        writer.write("/icp_contract", at(2.0), &contract(2.0, 1, f64::NAN, 0.0)).unwrap();
        writer.write("/icp_contract", at(2.5), &contract(2.5, -1, 0.0, 0.0)).unwrap();
        writer.write("/icp_contract", at(3.0), &contract(3.0, 0, 0.0, 0.0)).unwrap();
    });
    let to_the_end = ["_matching/epsilon_translation:=0", "_matching/epsilon_rotation:=0"];
    let node = graph.node(&[&[MOUNT, "_contract/time_budget:=20ms"][..], &to_the_end].concat());
    let recorder = graph.record(&TOPICS);
    graph.play(&bag, &[]);
    let recording = Recording::read(&graph.finish_recording(recorder), "");
    recording.check_consistency();
    recording.check_accounts(160);
    recording.reports.iter().for_each(check_report);
    // A scan is sent 12 ms after its stamp, and the timing of rosbag is not exact.
    for (seconds, report) in recording.timed_reports() {
        let in_force = (span(report.time_budget).as_millis(), report.translation_error_bound, report.rotation_error_bound);
        let expected = match seconds {
            0.95..1.05 | 2.95..3.05 => continue,
            ..0.95 => (20, 0.0, 0.0),
            ..2.95 => (7, 0.2, 0.1),
            _ => (0, 0.0, 0.0),
        };
        assert_eq!(format!("{in_force:?}"), format!("{expected:?}"), "at {seconds}");
    }
    assert!(recording.reports.iter().any(|report| report.stop_reason == "error_bound"));
    assert_eq!(node.log().matches("contract refused").count(), 1, "two within a second are logged once: {}", node.log());
    assert!(node.log().contains("translation_error_bound is NaN"), "{}", node.log());
}

#[test]
fn interrupts_by_topic_end_answers_early() {
    let Some(graph) = Graph::alone() else { return };
    let bag = graph.dir.path().join("drive.bag");
    drive::write_with_beams(&bag, 100, 1081, |_| ());
    let _node = graph.node(&[&[MOUNT, "_matching/correspondence:=naive"][..], &SLOW].concat());
    let recorder = graph.record(&TOPICS);
    let interrupter = peer::interrupter(&graph, Duration::from_millis(4));
    graph.play(&bag, &["--rate", "0.4"]);
    let recording = Recording::read(&graph.finish_recording(recorder), "");
    recording.check_consistency();
    recording.reports.iter().for_each(check_report);
    let interrupted: Vec<_> = recording.reports.iter().filter(|report| report.stop_reason == "interrupted").collect();
    assert!(interrupted.len() >= 50, "{} of {}", interrupted.len(), recording.reports.len());
    assert!(interrupted.iter().all(|report| report.deadline_met && report.ok == (report.outcome != MatchReport::PREDICTED)));
    // No interrupt waits for the match to complete, however long that takes.
    let latencies = peer::latencies(&interrupter);
    assert!(latencies.len() >= 50 && latencies[latencies.len() / 2] < Duration::from_millis(50), "{latencies:?}");
}

/// Run it alone on a quiet machine: `cargo test --release --test live latency_of_the_topic_interrupt -- --nocapture`.
#[test]
fn latency_of_the_topic_interrupt() {
    let Some(graph) = Graph::alone() else { return };
    let bag = graph.dir.path().join("drive.bag");
    drive::write_with_beams(&bag, 200, 1081, |_| ());
    let _node = graph.node(&[&[MOUNT][..], &SLOW].concat());
    let recorder = graph.record(&TOPICS);
    let interrupter = peer::interrupter(&graph, Duration::from_millis(1));
    graph.play(&bag, &[]);
    let recording = Recording::read(&graph.finish_recording(recorder), "");
    recording.check_consistency();
    let (latencies, reports) = (peer::latencies(&interrupter), &recording.reports);
    let iterations: Vec<u32> = reports.iter().map(|report| report.iterations).collect();
    assert!(!latencies.is_empty(), "{iterations:?}");
    let [median, p90, max] = [50, 90, 100].map(|percent| at_percent(&latencies, percent));
    eprintln!(
        "interrupt to pose: median {median:?}, p90 {p90:?}, max {max:?}, of {} of {} answers",
        latencies.len(),
        reports.len()
    );
    assert!(median < Duration::from_millis(20), "far longer than any machine should take");
}

/// A percentile of sorted values.
fn at_percent(sorted: &[Duration], percent: usize) -> Duration {
    sorted[(sorted.len() * percent).div_ceil(100).max(1) - 1]
}

#[test]
fn a_controller_requests_and_counts_answers_by_shared_memory() {
    let Some(graph) = Graph::start() else { return };
    let name = format!("/scan_matcher_test_{}", std::process::id());
    let bag = graph.dir.path().join("drive.bag");
    drive::write_with_beams(&bag, 160, 1081, |_| ());
    let parameter = format!("_contract/shared_memory:={name}");
    let node = graph.node(&[&[MOUNT, &parameter][..], &SLOW].concat());
    let mut second = graph.spawn_node(&["__name:=second", &parameter]);
    assert_eq!(second.exit_code(TIMEOUT), Some(1));
    let problem = second.log();
    assert!(problem.contains(&format!("shared memory {name}")) && problem.contains("serves it"), "{problem}");

    let recorder = graph.record(&TOPICS);
    let client = Client::open(&name).unwrap();
    let over = AtomicBool::new(false);
    let (answers, completed) = std::thread::scope(|scope| {
        let caller = scope.spawn(|| call_at_random(&client, &over));
        let counter = scope.spawn(|| count_completions(&client, &over));
        graph.play(&bag, &[]);
        assert!(eventually(|| client.counts().acknowledged == client.counts().requested));
        over.store(true, Ordering::Relaxed);
        (caller.join().unwrap(), counter.join().unwrap())
    });
    let recording = Recording::read(&graph.finish_recording(recorder), "");
    recording.check_consistency();
    recording.check_accounts(160);
    assert_eq!(
        (client.counts().completed, completed),
        (u32::try_from(recording.reports.len()).unwrap(), client.counts().completed)
    );
    assert_eq!(recording.states.last().copied(), Some(i32::from(completed % 2 == 1)));
    assert!(answers.len() > 100, "{} answers", answers.len());
    for CompletedEstimate { number, estimate } in &answers {
        let report = &recording.reports[*number as usize - 1];
        assert_eq!(Stamp::from_ros(report.header.stamp.sec, report.header.stamp.nsec), estimate.stamp);
        assert_eq!((report.ok, report.stop_reason == "interrupted"), (estimate.ok, estimate.interrupted));
        assert_eq!(recording.states[*number as usize - 1], i32::from(number % 2 == 1), "the parity is icp_state");
        assert_eq!(recording.poses[&estimate.stamp].x.to_bits(), estimate.odom_from_base.x.to_bits());
    }
    assert!(answers.iter().any(|answer| answer.estimate.interrupted));
    drop(node);
    assert!(client.wait_for_completion(completed, TIMEOUT).is_err(), "the node is gone");
}

/// The answers to requests at random times.
fn call_at_random(client: &Client, over: &AtomicBool) -> Vec<CompletedEstimate> {
    let (mut rng, mut answers) = (Pcg64::seed_from_u64(1), Vec::new());
    while !over.load(Ordering::Relaxed) {
        std::thread::sleep(Duration::from_micros(rng.random_range(0..30_000)));
        let number = client.request();
        answers.extend(client.wait_for_answer(number, TIMEOUT).unwrap());
    }
    answers
}

/// The number of completions seen, singly or several at once.
fn count_completions(client: &Client, over: &AtomicBool) -> u32 {
    let mut seen = 0;
    while !over.load(Ordering::Relaxed) {
        if let Ok(completed) = client.wait_for_completion(seen, Duration::from_millis(100)) {
            assert!(completed > seen);
            seen = completed;
        }
    }
    client.counts().completed.max(seen)
}

#[test]
fn an_impossible_budget_is_reported_and_shown_in_diagnostics() {
    let Some(graph) = Graph::start() else { return };
    let diagnostics = graph.dir.path().join("diagnostics.bag");
    let recorder = graph.spawn("rosbag", &["record", "-O", diagnostics.to_str().unwrap(), "/diagnostics"]);
    let (_node, recording) = play_to_node(&graph, &["_contract/time_budget:=20us"], 120, 541);
    std::thread::sleep(Duration::from_millis(1500)); // until the last scans have been processed
    recorder.signal_group("INT");
    assert!(eventually(|| diagnostics.exists()), "{}", recorder.log());
    recording.check_consistency();
    recording.check_accounts(120);
    recording.reports.iter().for_each(check_report);
    let late = recording.reports.iter().filter(|report| !report.deadline_met).count();
    let worst = recording.reports.iter().map(|report| span(report.overrun)).max().unwrap();
    assert!(late * 10 >= recording.reports.len() * 9, "{late} of {}", recording.reports.len());
    for report in &recording.reports {
        assert_eq!(report.ok, report.outcome != MatchReport::PREDICTED, "{report:?}");
        assert_eq!(report.reason.is_empty(), report.ok, "a prediction must have a reason: {report:?}");
        assert!(report.outcome != MatchReport::MATCHED || report.iterations > 0, "{report:?}");
    }
    assert!(recording.reports.iter().any(|report| report.outcome == MatchReport::PREDICTED && report.stop_reason == "budget"));
    let last = last_status(&diagnostics);
    let value = |key: &str| last.values.iter().find(|value| value.key == key).unwrap().value.clone();
    assert_eq!(value("deadline misses"), late.to_string());
    assert_eq!(value("scans answered"), recording.reports.len().to_string());
    assert_eq!(value("worst overrun [ms]"), format!("{:.3}", worst.as_secs_f64() * 1e3));
    let is_reported = statuses(&diagnostics).iter().any(|status| status.message.contains("answers later than the time budget"));
    assert!(is_reported, "{:?}", statuses(&diagnostics));
}

fn statuses(bag: &Path) -> Vec<DiagnosticStatus> {
    let messages = Bag::open(bag).unwrap();
    let arrays = messages.messages(None).map(|message| DiagnosticArray::decode(&message.unwrap().data[..]).unwrap());
    arrays.flat_map(|array| array.status).collect()
}

fn last_status(bag: &Path) -> DiagnosticStatus {
    statuses(bag).pop().unwrap()
}

/// A row of the controller's CSV file.
struct Row {
    speed: f64,
    budget_ms: f64,
}

#[test]
fn the_demo_controller_sets_budgets_by_speed_and_logs_how_they_are_kept() {
    let Some(graph) = Graph::start() else { return };
    let csv = graph.dir.path().join("adherence.csv");
    let mut launch = graph.launch(
        "contract_demo.launch",
        &[
            &format!("bag:={PACKAGE}/bags/demo.bag"),
            &format!("csv:={}", csv.display()),
            "log_period:=2s",
            "speed_fast:=3",
            "stop_at_end:=true",
        ],
    );
    launch.expect_log("time budget 10ms at rest, falling to 2ms at 3 m/s and above");
    assert!(launch.exit_code(6 * TIMEOUT).is_some(), "{}", launch.log());
    let log = launch.log();
    eprintln!("{}", log.lines().filter(|line| line.contains("contract_demo:")).collect::<Vec<_>>().join("\n"));
    assert!(log.contains("mean budget") && log.contains("total: ") && !log.contains("messages were lost"), "{log}");
    let rows = read_rows(&csv);
    assert!(rows.len() > 350, "{} rows", rows.len());
    let wanted = |row: &Row| 10.0 - 8.0 * (row.speed / 3.0).min(1.0);
    // Before the first contract there is no budget. A change of less than 5 %, or within 0.1 s of the last one, is not sent, and
    // velocities from scans 25 ms apart are noisy.
    let following = rows.iter().filter(|row| (row.budget_ms - wanted(row)).abs() < 0.25 * wanted(row)).count();
    assert!(following * 10 > rows.len() * 7, "{following} of {}", rows.len());
    let shortest = rows.iter().map(|row| row.budget_ms).filter(|budget| *budget > 0.0).fold(f64::INFINITY, f64::min);
    assert!(shortest < 5.0 && rows.iter().any(|row| row.budget_ms > 9.9), "shortest {shortest} ms");
}

fn read_rows(csv: &Path) -> Vec<Row> {
    let mut reader = csv::Reader::from_path(csv).unwrap();
    let mut column = |name: &str| reader.headers().unwrap().iter().position(|header| header == name).unwrap();
    let (speed, budget) = (column("speed_m_per_s"), column("time_budget_us"));
    let number = |row: &csv::StringRecord, column: usize| row[column].parse::<f64>().unwrap();
    let row = |row: csv::StringRecord| Row { speed: number(&row, speed), budget_ms: number(&row, budget) / 1e3 };
    reader.records().map(|record| row(record.unwrap())).collect()
}

#[test]
fn the_demo_controller_rejects_inconsistent_budgets() {
    let Some(graph) = Graph::start() else { return };
    for (argument, remedy) in
        [("_budget_fast:=20ms", "at most budget_slow"), ("_budget_fats:=1ms", "did you mean 'budget_fast'?")]
    {
        let mut demo = graph.spawn(env!("CARGO_BIN_EXE_contract_demo"), &[argument]);
        assert_eq!(demo.exit_code(TIMEOUT), Some(1), "{argument}");
        assert!(demo.log().contains(remedy) && demo.log().contains("rosparam delete /contract_demo"), "{}", demo.log());
        graph.output("rosparam", &["delete", "/contract_demo"]);
    }
    let mut help = graph.spawn(env!("CARGO_BIN_EXE_contract_demo"), &["--help"]);
    assert_eq!((help.exit_code(TIMEOUT), help.log().contains("speed_fast")), (Some(0), true));
}

#[test]
fn budgets_are_kept_despite_a_busy_loop() {
    adherence_despite_a_busy_loop(5.0);
}

/// For documented figures: `cargo test --release --test live -- --ignored adherence --nocapture`, on a quiet machine.
#[test]
#[ignore = "the same for longer"]
fn adherence_over_many_scans() {
    adherence_despite_a_busy_loop(20.0);
}

fn adherence_despite_a_busy_loop(seconds: f64) {
    const BUDGET: Duration = Duration::from_millis(2);
    let Some(graph) = Graph::alone() else { return };
    let bag = graph.dir.path().join("drive.bag");
    let scans = drive::simulate(&bag, seconds);
    let node = graph.node(&["_contract/time_budget:=2ms"]);
    let recorder = graph.record(&TOPICS);
    let _busy = graph.spawn("sh", &["-c", "while :; do :; done"]);
    graph.play(&bag, &[]);
    let recording = Recording::read(&graph.finish_recording(recorder), "");
    recording.check_consistency();
    recording.check_accounts(scans);
    recording.reports.iter().for_each(check_report);
    assert!(recording.reports.iter().all(|report| span(report.time_budget) == BUDGET));
    let mut elapsed: Vec<Duration> = recording.reports.iter().map(|report| span(report.elapsed)).collect();
    elapsed.sort_unstable();
    let late = recording.reports.iter().filter(|report| !report.deadline_met).count();
    let [p50, p99, max] = [50, 99, 100].map(|percent| at_percent(&elapsed, percent));

    eprintln!(
        "budget {BUDGET:?}: {late} of {} late ({:.2} %), elapsed p50 {p50:?}, p99 {p99:?}, max {max:?}",
        elapsed.len(),
        100.0 * late as f64 / elapsed.len() as f64
    );
    assert!(recording.reports.iter().filter(|report| report.ok).count() * 2 > elapsed.len(), "{}", node.log());
}
