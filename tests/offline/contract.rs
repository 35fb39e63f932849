//! Contracts, on a virtual clock on which an iteration costs exactly 10 us.

use std::sync::Arc;
use std::time::Duration;

use crate::common::Laser;
use anytime_scan_matcher::anytime::clock::{Clock, VirtualClock};
use anytime_scan_matcher::anytime::interrupt::{InterruptRequest, NeverInterrupt};
use anytime_scan_matcher::app::{App, Estimate, ScanProcessor as _};
use anytime_scan_matcher::config::Config;
use anytime_scan_matcher::geometry::Pose2;
use anytime_scan_matcher::matching::StopReason;
use anytime_scan_matcher::odometry::Outcome;
use anytime_scan_matcher::time::Stamp;

struct Bench {
    app: App,
    clock: Arc<dyn Clock>,
    scans: u32,
}

impl Bench {
    fn new(assignments: &[&str]) -> Self {
        let mut config = Config::default();
        for assignment in assignments {
            config.set_assignment(assignment).unwrap();
        }
        let clock: Arc<dyn Clock> = Arc::new(VirtualClock::new(Duration::from_micros(10)));
        let mut app = App::new(&config, Arc::clone(&clock)).unwrap();
        app.warm_up().unwrap();
        Self { app, clock, scans: 0 }
    }

    /// The true pose of the laser at this scan. The motion starts and jerks, so that predictions are wrong by centimetres.
    fn truth(scan: u32) -> Pose2 {
        let (step, jerk) = (f64::from(scan), if scan.is_multiple_of(2) { 0.02 } else { -0.02 });
        Pose2::new(0.05 * step, jerk, 0.02 * step + jerk)
    }

    /// Processes the next scan, including the work after the answer.
    fn answer(&mut self) -> (Estimate, f64) {
        let laser = Laser::with_field_of_view(270.0, 721);
        let truth = Self::truth(self.scans);
        let scan = laser.message(Stamp::from_seconds(1000.0 + 0.025 * f64::from(self.scans)), truth);
        self.scans += 1;
        let arrival = self.clock.now();
        let mut estimate = self.app.on_scan(&scan, arrival);
        self.app.conclude(&mut estimate);
        self.app.maintain(&NeverInterrupt);
        let error = Self::truth(0).between(&truth).between(&estimate.registration.map_from_base()).distance();
        (estimate, error)
    }

    fn answers(&mut self) -> Vec<(Estimate, f64)> {
        (0..20).map(|_| self.answer()).collect()
    }
}

fn iterations(estimate: &Estimate) -> u32 {
    estimate.registration.refinement.map_or(0, |report| report.iterations)
}

fn mean(values: impl Iterator<Item = f64> + Clone) -> f64 {
    values.clone().sum::<f64>() / values.count() as f64
}

#[test]
fn no_answer_is_late_if_costs_are_known_and_more_time_gives_better_answers() {
    let mut last = (f64::INFINITY, 0.0);
    for budget in [60, 100, 150, 1000] {
        let mut bench = Bench::new(&[&format!("contract.time_budget={budget}us")]);
        let answers = bench.answers();
        assert!(answers.iter().all(|(estimate, _)| estimate.deadline_met()), "{budget}");
        let error = mean(answers.iter().map(|(_, error)| *error));
        let count = mean(answers.iter().map(|(estimate, _)| f64::from(iterations(estimate))));
        assert!(error <= last.0 + 1e-4 && count >= last.1, "{budget} us: {error} m by {count} iterations after {last:?}");
        last = (error, count);
    }
    assert!(last.0 < 0.005);
    let unlimited = Bench::new(&[]).answers();
    assert!((mean(unlimited.iter().map(|(_, error)| *error)) - last.0).abs() < 1e-9);
}

#[test]
fn without_time_the_answer_is_the_prediction_with_its_reason() {
    let mut bench = Bench::new(&["contract.time_budget=20us"]);
    let answers = bench.answers();
    for (estimate, _) in &answers[1..] {
        assert!(matches!(&estimate.registration.outcome, Outcome::Predicted(failure) if failure.text.contains("time budget")));
        assert_eq!(estimate.registration.refinement.unwrap().stop_reason, StopReason::Budget);
        assert!(!estimate.deadline_met() && estimate.overrun() > Duration::ZERO, "{:?}", estimate.elapsed);
    }
    assert_eq!(bench.app.counters().deadline_misses, 20);
}

#[test]
fn unfinished_matches_are_finished_after_the_answer() {
    let predicted = |assignments: &[&str]| {
        let mut bench = Bench::new(assignments);
        let answers = bench.answers();
        let finished = bench.app.odometry_counters().finished_later;
        (mean(answers.iter().map(|(_, error)| *error)), finished)
    };
    let (with, finished) = predicted(&["contract.time_budget=20us"]);
    let (without, none) = predicted(&["contract.time_budget=20us", "contract.finish_after_answer=false"]);
    assert_eq!((finished, none), (19, 0));
    assert!(with < 0.5 * without, "{with} {without}");
}

#[test]
fn an_error_bound_saves_time() {
    let mut complete = Bench::new(&[]);
    let mut bounded = Bench::new(&["contract.translation_error_bound=0.01", "contract.rotation_error_bound=0.01"]);
    for ((all, _), (some, error)) in complete.answers().iter().zip(bounded.answers()).skip(1) {
        assert!(iterations(&some) < iterations(all), "{some:?} {all:?}");
        assert_eq!(some.registration.refinement.unwrap().stop_reason, StopReason::ErrorBound);
        assert!(some.error_excess().translation == 0.0 && some.error_excess().rotation == 0.0);
        assert!(error < 0.01, "{error}");
    }
}

#[test]
fn a_missed_bound_is_reported_with_its_excess() {
    let mut bench = Bench::new(&["contract.time_budget=70us", "contract.translation_error_bound=0.00001"]);
    for (estimate, _) in &bench.answers()[1..] {
        let error = estimate.registration.estimated_error.translation;
        assert!(
            (estimate.error_excess().translation - (3.0 * error - 0.000_01)).abs() < 1e-12 && error > 0.000_01,
            "{estimate:?}"
        );
    }
}

#[test]
fn an_answer_can_be_requested() {
    let mut bench = Bench::new(&[]);
    let request = Arc::new(InterruptRequest::default());
    bench.app.set_interrupt(Arc::clone(&request) as Arc<_>);
    bench.answer();
    assert_eq!(bench.answer().0.registration.outcome, Outcome::Matched);
    request.make();
    let (estimate, _) = bench.answer();
    assert_eq!(estimate.registration.refinement.unwrap().stop_reason, StopReason::Interrupted);
    assert!(matches!(&estimate.registration.outcome, Outcome::Predicted(failure) if failure.text.contains("requested before")));
    request.clear();
    assert_eq!(bench.answer().0.registration.outcome, Outcome::Matched);
}
