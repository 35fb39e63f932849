//! The pose estimator of the closed loop: the application code of the nodes, on a simulated processor.

use std::sync::Arc;
use std::time::Duration;

use super::course::Course;
use super::processor::{InterruptAt, Processor};
use super::{DriveError, EstimatorKind};
use crate::anytime::ErrorEstimate;
use crate::anytime::clock::Clock;
use crate::anytime::interrupt::NeverInterrupt;
use crate::anytime::mode::Conditions;
use crate::app::localizer::Localizer;
use crate::app::{App, ScanProcessor as _};
use crate::config::Config;
use crate::control::follower::PoseReading;
use crate::control::policy::Terms;
use crate::geometry::Pose2;
use crate::localization::estimate::Belief;
use crate::matching::StopReason;
use crate::messages::nav_msgs::Odometry;
use crate::messages::sensor_msgs::LaserScan;
use crate::simulation::drive::{START, mount_message};
use crate::time::Stamp;

/// An answer of the estimator, and its timing.
#[derive(Clone, Copy, Debug)]
pub(super) struct TimedAnswer {
    pub(super) reading: PoseReading,
    /// When the answer is available, since the start.
    pub(super) ready_at: Duration,
    /// When the estimator can process the next scan, since the start.
    pub(super) free_at: Duration,
    /// Whether the answer overran its contract.
    pub(super) is_late: bool,
    /// Whether the pose comes from a match or a filter update, not only from a prediction.
    pub(super) is_ok: bool,
    /// Whether the work ran to completion: no contract or interrupt ended it early.
    pub(super) is_complete: bool,
    /// Conditions of the answer, if the estimator reports them.
    pub(super) conditions: Option<Conditions>,
    /// Processor time spent on the answer.
    pub(super) work: Duration,
}

/// Arrival of a scan, start of its processing, and arrival of the next scan, since the start.
#[derive(Clone, Copy, Debug)]
pub(super) struct Times {
    pub(super) arrival: Duration,
    pub(super) begin: Duration,
    pub(super) next: Duration,
}

pub(super) struct Estimator {
    kind: Kind,
    processor: Arc<Processor>,
    max_iterations: u32,
}

enum Kind {
    Truth,
    ScanMatcher(Box<App>),
    ParticleFilter(Box<Localizer>),
}

impl Estimator {
    /// An estimator for a car at rest at `start`, warmed up without load bursts.
    pub(super) fn new(
        kind: EstimatorKind,
        course: &Course,
        config: &Config,
        start: Pose2,
        laser_in_base: Pose2,
        processor: &Arc<Processor>,
    ) -> Result<Self, DriveError> {
        let clock: Arc<dyn Clock> = Arc::<Processor>::clone(processor);
        let mut config = config.clone();
        config.odometry.initial_pose = start;
        processor.set_quiet(true);
        let mount = mount_message(START, laser_in_base);
        let kind = match kind {
            EstimatorKind::Truth => Kind::Truth,
            EstimatorKind::ScanMatcher => {
                let mut app = App::new(&config, clock)?;
                app.warm_up()?;
                let _ = app.on_transforms(&mount); // messages of the simulator are always valid
                Kind::ScanMatcher(Box::new(app))
            }
            EstimatorKind::ParticleFilter => {
                let map = course.map.clone().ok_or_else(|| DriveError::NoMap(course.name.clone()))?;
                let mut localizer = Localizer::new(map, &config, clock)?;
                localizer.warm_up();
                localizer.start_at(&start, None);
                let _ = localizer.on_transforms(&mount);
                Kind::ParticleFilter(Box::new(localizer))
            }
        };
        processor.set_quiet(false);
        Ok(Self { kind, processor: Arc::clone(processor), max_iterations: config.matching.max_iterations })
    }

    pub(super) fn on_odometry(&mut self, message: &Odometry) {
        // Messages of the simulator are always valid.
        let _ = match &mut self.kind {
            Kind::Truth => Ok(()),
            Kind::ScanMatcher(app) => app.on_odometry(message),
            Kind::ParticleFilter(localizer) => localizer.on_odometry(message),
        };
    }

    /// The answer to a scan. `truth`: true pose and speed of the car.
    pub(super) fn answer(&mut self, scan: &LaserScan, times: Times, terms: Terms, truth: (Pose2, f64)) -> TimedAnswer {
        self.processor.set(times.begin);
        let before = self.processor.busy_time();
        let mut answer = match &mut self.kind {
            Kind::Truth => true_answer(scan, times, truth),
            Kind::ScanMatcher(app) => {
                app.set_max_iterations(terms.max_iterations.unwrap_or(self.max_iterations));
                app.set_contract(terms.contract);
                matcher_answer(app, scan, times, &self.processor)
            }
            Kind::ParticleFilter(localizer) => {
                localizer.set_contract(terms.contract);
                filter_answer(localizer, scan, times, &self.processor)
            }
        };
        answer.free_at = self.processor.now();
        answer.work = self.processor.busy_time().saturating_sub(before);
        answer
    }
}

/// The true pose, without delay.
pub(super) fn true_answer(scan: &LaserScan, times: Times, (pose, speed): (Pose2, f64)) -> TimedAnswer {
    let reading = PoseReading { stamp: scan.header.stamp.into(), pose, speed: Some(speed), deviation: 0.0 };
    new_answer(reading, times.begin, true)
}

fn matcher_answer(app: &mut App, scan: &LaserScan, times: Times, processor: &Arc<Processor>) -> TimedAnswer {
    let mut estimate = app.on_scan(scan, times.arrival);
    app.conclude(&mut estimate);
    let ready_at = processor.now();
    let registration = &estimate.registration;
    let reading = PoseReading {
        stamp: Stamp::from(scan.header.stamp),
        pose: registration.map_from_base(),
        speed: Some(registration.twist.vx),
        // The odometry covariance grows with distance even after loop closures: it is not the uncertainty of the pose on the map.
        deviation: 0.0,
    };
    let stop = registration.refinement.map(|report| report.stop_reason);
    let mut answer = new_answer(reading, ready_at, registration.outcome.is_ok());
    answer.conditions = estimate.conditions();
    (answer.is_late, answer.is_complete) = (!estimate.overrun().is_zero(), is_complete(stop));
    app.maintain(&InterruptAt { processor: Arc::clone(processor), time: times.next });
    answer
}

fn filter_answer(localizer: &mut Localizer, scan: &LaserScan, times: Times, processor: &Arc<Processor>) -> TimedAnswer {
    let mut fix = localizer.on_scan(scan, times.arrival, &NeverInterrupt);
    localizer.conclude(&mut fix);
    let ready_at = processor.now();
    let pose = fix
        .belief
        .as_ref()
        .ok()
        .map(|belief| (belief.map_from_base, ErrorEstimate::of_covariance(&belief.covariance).translation));
    let (pose, deviation) = pose.unwrap_or((Pose2::IDENTITY, f64::INFINITY));
    let reading = PoseReading { stamp: fix.stamp, pose, speed: Some(localizer.twist().vx), deviation };
    let mut answer = new_answer(reading, ready_at, fix.belief.is_ok());
    answer.conditions = fix.belief.as_ref().ok().map(Belief::conditions);
    (answer.is_late, answer.is_complete) = (!fix.overrun().is_zero(), is_complete(fix.stop_reason));
    localizer.maintain(&InterruptAt { processor: Arc::clone(processor), time: times.next });
    answer
}

fn is_complete(stop: Option<StopReason>) -> bool {
    stop.is_some_and(|reason| !matches!(reason, StopReason::Budget | StopReason::ErrorBound | StopReason::Interrupted))
}

fn new_answer(reading: PoseReading, ready_at: Duration, is_ok: bool) -> TimedAnswer {
    TimedAnswer {
        reading,
        ready_at,
        free_at: ready_at,
        is_late: false,
        is_ok,
        is_complete: true,
        conditions: None,
        work: Duration::ZERO,
    }
}
