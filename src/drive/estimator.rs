//! What says where the car is: the application of the nodes, on a modelled processor.

use std::sync::Arc;
use std::time::Duration;

use super::course::Course;
use super::processor::{At, Processor};
use super::{DriveError, EstimatorKind};
use crate::anytime::ErrorEstimate;
use crate::anytime::clock::Clock;
use crate::anytime::interrupt::Never;
use crate::anytime::mode::Conditions;
use crate::app::localizer::Localizer;
use crate::app::{Answering as _, App};
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

/// An answer, and when it comes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Answer {
    pub(super) reading: PoseReading,
    /// When it is there, from the start.
    pub(super) ready: Duration,
    /// When the estimator takes up another scan.
    pub(super) free: Duration,
    /// Later than its contract.
    pub(super) is_late: bool,
    /// Whether it is a match, or a belief; else a prediction.
    pub(super) is_ok: bool,
    /// Whether it was the whole answer: nothing ended the work on it early.
    pub(super) is_whole: bool,
    /// What it found; `None`: it tells nothing.
    pub(super) conditions: Option<Conditions>,
    /// Processor time that it took.
    pub(super) work: Duration,
}

/// When a scan came, was taken up, and the next one comes, from the start.
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
    /// Of a car that stands at `start`, warmed up on the quiet machine.
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
                let _ = app.on_transforms(&mount); // of the simulator: never refused
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
        // What the simulator says is never refused.
        let _ = match &mut self.kind {
            Kind::Truth => Ok(()),
            Kind::ScanMatcher(app) => app.on_odometry(message),
            Kind::ParticleFilter(localizer) => localizer.on_odometry(message),
        };
    }

    /// The answer to a scan. `truth`: where the car was, and how fast.
    pub(super) fn answer(&mut self, scan: &LaserScan, times: Times, terms: Terms, truth: (Pose2, f64)) -> Answer {
        self.processor.set(times.begin);
        let before = self.processor.worked();
        let mut answer = match &mut self.kind {
            Kind::Truth => of_truth(scan, times, truth),
            Kind::ScanMatcher(app) => {
                app.set_max_iterations(terms.max_iterations.unwrap_or(self.max_iterations));
                app.set_contract(terms.contract);
                of_matcher(app, scan, times, &self.processor)
            }
            Kind::ParticleFilter(localizer) => {
                localizer.set_contract(terms.contract);
                of_filter(localizer, scan, times, &self.processor)
            }
        };
        answer.free = self.processor.now();
        answer.work = self.processor.worked().saturating_sub(before);
        answer
    }
}

/// What the simulator knows, at once.
pub(super) fn of_truth(scan: &LaserScan, times: Times, (pose, speed): (Pose2, f64)) -> Answer {
    let reading = PoseReading { stamp: scan.header.stamp.into(), pose, speed: Some(speed), deviation: 0.0 };
    answer(reading, times.begin, true)
}

fn of_matcher(app: &mut App, scan: &LaserScan, times: Times, processor: &Arc<Processor>) -> Answer {
    let mut estimate = app.on_scan(scan, times.arrival);
    app.conclude(&mut estimate);
    let ready = processor.now();
    let registration = &estimate.registration;
    let reading = PoseReading {
        stamp: Stamp::from(scan.header.stamp),
        pose: registration.map_from_base(),
        speed: Some(registration.twist.vx),
        // It grows along the way, whatever loops are closed: it says nothing of the pose on the map.
        deviation: 0.0,
    };
    let stop = registration.refinement.map(|report| report.stop_reason);
    let mut answer = answer(reading, ready, registration.outcome.is_ok());
    answer.conditions = estimate.conditions();
    (answer.is_late, answer.is_whole) = (!estimate.overrun().is_zero(), is_whole(stop));
    app.maintain(&At { processor: Arc::clone(processor), time: times.next });
    answer
}

fn of_filter(localizer: &mut Localizer, scan: &LaserScan, times: Times, processor: &Arc<Processor>) -> Answer {
    let mut fix = localizer.on_scan(scan, times.arrival, &Never);
    localizer.conclude(&mut fix);
    let ready = processor.now();
    let pose = fix
        .belief
        .as_ref()
        .ok()
        .map(|belief| (belief.map_from_base, ErrorEstimate::of_covariance(&belief.covariance).translation));
    let (pose, deviation) = pose.unwrap_or((Pose2::IDENTITY, f64::INFINITY));
    let reading = PoseReading { stamp: fix.stamp, pose, speed: Some(localizer.twist().vx), deviation };
    let mut answer = answer(reading, ready, fix.belief.is_ok());
    answer.conditions = fix.belief.as_ref().ok().map(Belief::conditions);
    (answer.is_late, answer.is_whole) = (!fix.overrun().is_zero(), is_whole(fix.stop_reason));
    localizer.maintain(&At { processor: Arc::clone(processor), time: times.next });
    answer
}

fn is_whole(stop: Option<StopReason>) -> bool {
    stop.is_some_and(|reason| !matches!(reason, StopReason::Budget | StopReason::ErrorBound | StopReason::Interrupted))
}

fn answer(reading: PoseReading, ready: Duration, is_ok: bool) -> Answer {
    Answer { reading, ready, free: ready, is_late: false, is_ok, is_whole: true, conditions: None, work: Duration::ZERO }
}
