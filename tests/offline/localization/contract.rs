//! The time contract of the filter, on a virtual clock on which every step costs exactly 10 us.

use std::convert::Infallible;
use std::sync::Arc;
use std::time::Duration;

use anytime_scan_matcher::anytime::clock::{Clock, VirtualClock};
use anytime_scan_matcher::anytime::interrupt::NeverInterrupt;
use anytime_scan_matcher::app::ScanProcessor as _;
use anytime_scan_matcher::app::localizer::{Fix, Localizer};
use anytime_scan_matcher::config::Config;
use anytime_scan_matcher::geometry::Pose2;
use anytime_scan_matcher::knobs::Seconds;
use anytime_scan_matcher::matching::StopReason;
use anytime_scan_matcher::simulation::drive::{Settings, simulate};
use anytime_scan_matcher::simulation::scene::Scene;

use super::{Truth, at_truth, feed};
use crate::common::corridor;

/// A short drive with a configuration: every answer with its error, and the number of late answers.
fn drive(assignments: &[&str]) -> (Vec<(Fix, Pose2)>, u64) {
    let mut config = Config::default();
    for assignment in assignments {
        config.set_assignment(assignment).unwrap();
    }
    let clock: Arc<dyn Clock> = Arc::new(VirtualClock::new(Duration::from_micros(10)));
    let mut localizer = Localizer::new(corridor(), &config, Arc::clone(&clock)).unwrap();
    localizer.warm_up();
    let mut settings = Settings::default();
    settings.drive.duration = Seconds(4.0);
    let (mut answers, mut truth) = (Vec::new(), Truth::default());
    simulate::<Infallible>(&settings, &Scene::in_map(corridor(), 4).unwrap(), |_, message| {
        if let Some(scan) = feed(&mut localizer, message, &mut truth, at_truth) {
            let arrival = clock.now();
            let mut fix = localizer.on_scan(&scan, arrival, &NeverInterrupt);
            localizer.conclude(&mut fix);
            localizer.maintain(&NeverInterrupt);
            let error = truth.latest().between(&fix.belief.as_ref().unwrap().map_from_base);
            answers.push((fix, error));
        }
        Ok(())
    })
    .unwrap();
    (answers, localizer.deadline_misses())
}

fn mean(answers: &[(Fix, Pose2)], figure: impl Fn(&(Fix, Pose2)) -> f64) -> f64 {
    answers.iter().map(figure).sum::<f64>() / answers.len() as f64
}

fn beams(answers: &[(Fix, Pose2)]) -> f64 {
    mean(answers, |(fix, _)| fix.belief.as_ref().unwrap().beams as f64)
}

fn particles(answers: &[(Fix, Pose2)]) -> f64 {
    mean(answers, |(fix, _)| fix.belief.as_ref().unwrap().particles as f64)
}

#[test]
fn no_answer_is_late_if_costs_are_known_and_more_time_allows_more_work() {
    let mut last = 0.0;
    for budget in [150, 200, 300, 1000] {
        let (answers, late) = drive(&[&format!("contract.time_budget={budget}us")]);
        // The warm-up does not hand over its answers, so that this cost is only known after the first answer.
        assert!(answers[1..].iter().all(|(fix, _)| fix.overrun().is_zero()) && late <= 1, "{budget} us: {late} late");
        let work = beams(&answers) * particles(&answers);
        assert!(work >= last, "{budget} us: {work} rays after {last}");
        assert!(mean(&answers, |(_, error)| error.distance()) < 0.06);
        let all = answers.iter().all(|(fix, _)| fix.stop_reason == Some(StopReason::Converged));
        assert_eq!(all, budget == 1000, "{budget} us: {} beams", beams(&answers));
        last = work;
    }
    assert!((last - 60.0 * 4000.0).abs() < 1.0, "{last}");
}

#[test]
fn particles_are_dropped_if_not_even_a_fraction_of_the_beams_fits() {
    let (answers, _) = drive(&["contract.time_budget=100us"]);
    assert!(particles(&answers) < 3500.0, "{}", particles(&answers));
    let (answers, _) = drive(&["contract.time_budget=1ms"]);
    assert!((particles(&answers) - 4000.0).abs() < 0.1, "{}", particles(&answers));
}

#[test]
fn without_time_the_answer_is_the_prediction_and_every_miss_is_counted() {
    let (answers, late) = drive(&["contract.time_budget=1us"]);
    assert_eq!(late, answers.len() as u64);
    for (fix, _) in &answers {
        assert!(
            fix.stop_reason == Some(StopReason::Budget)
                && fix.overrun() > Duration::ZERO
                && fix.belief.as_ref().unwrap().beams == 0
        );
    }
    // The rest is processed after the answer, which improves the next prediction.
    let (without, _) = drive(&["contract.time_budget=1us", "contract.finish_after_answer=false"]);
    let of = |answers: &[(Fix, Pose2)]| mean(answers, |(_, error)| error.distance());
    assert!(of(&answers) < 0.1 && of(&without) > 3.0 * of(&answers), "{} {}", of(&answers), of(&without));
}

#[test]
fn an_error_bound_saves_time() {
    let (bounded, _) = drive(&["contract.translation_error_bound=0.3", "contract.rotation_error_bound=0.2"]);
    let early = bounded.iter().filter(|(fix, _)| fix.stop_reason == Some(StopReason::ErrorBound)).count();
    assert!(early * 10 > bounded.len() * 8 && beams(&bounded) < 40.0, "{early} of {}, {} beams", bounded.len(), beams(&bounded));
    assert!(mean(&bounded, |(_, error)| error.distance()) < 0.1);
}

#[test]
fn contracts_are_kept_equally_on_any_number_of_threads() {
    let beliefs = |threads: &str| {
        let (answers, _) = drive(&["contract.time_budget=100us", threads]);
        answers.into_iter().map(|(fix, _)| fix.belief.unwrap()).collect::<Vec<_>>()
    };
    assert!(beliefs("localization.threads=1") == beliefs("localization.threads=3"));
}
