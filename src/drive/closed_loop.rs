//! Simulation of one closed-loop drive, in steps of a millisecond.

use std::sync::Arc;
use std::time::Duration;

use rand::{RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64;

use super::course::Course;
use super::estimator::{Estimator, TimedAnswer, Times, true_answer};
use super::figures::{Ending, Run, Trace};
use super::flaws::{CarFlaws, FlawKnobs};
use super::processor::{Load, Processor};
use super::replanning::{Planner, Replanning, line_jump};
use super::{DriveError, EstimatorKind};
use crate::anytime::cost_model::CostModel;
use crate::anytime::mode::{ConditionMonitor, OutOfRange};
use crate::config::Config;
use crate::control::follower::{Follower, FollowerKnobs, Step};
use crate::control::policy::{Policy, Situation};
use crate::control::progress::Progress;
use crate::geometry::{Point, Pose2};
use crate::messages::sensor_msgs::LaserScan;
use crate::simulation::car::Car;
use crate::simulation::drive::{SCAN_LATENCY_MS, START};
use crate::simulation::lidar::{Lidar, LidarKnobs};
use crate::simulation::odometer::{Odometer, OdometerKnobs};
use crate::simulation::vehicle::{Command, VehicleKnobs};
use crate::time::Stamp;

/// Step of the simulation, ms.
const TICK: u64 = 1;
/// Period of the commands, ms.
const COMMAND_PERIOD: u64 = 20;
/// Sampling period of the true tracking error, ms.
const ERROR_PERIOD: u64 = 10;
/// The drive ends as stopped if the car makes no progress for this long, ms.
const STUCK_TIME: u64 = 10_000;
/// Distance along the path that counts as progress, m.
const MIN_PROGRESS: f64 = 0.2;
/// Below this speed a car that has arrived counts as finished, m/s.
const ARRIVED_SPEED: f64 = 0.2;
/// Weight of the latest complete answer in the moving mean of the work, which the oracle policy knows.
const SMOOTHING: f64 = 0.1;

/// Everything that determines a drive.
#[derive(Clone)]
pub(super) struct Setup<'a> {
    pub(super) course: &'a Course,
    pub(super) estimator: EstimatorKind,
    pub(super) config: &'a Config,
    pub(super) follower: FollowerKnobs,
    pub(super) lidar: LidarKnobs,
    pub(super) odometer: OdometerKnobs,
    pub(super) flaws: FlawKnobs,
    pub(super) costs: CostModel,
    pub(super) load: Load,
    pub(super) policy: Policy,
    pub(super) replanning: Option<Replanning>,
    pub(super) laps: u32,
    pub(super) seed: u32,
    /// Steer by the true poses instead of the estimates, to measure estimates independently of their effect on the drive.
    pub(super) steer_by_truth: bool,
}

/// A scan that is not processed yet.
struct PendingScan {
    /// Time of arrival, ms.
    arrival: u64,
    scan: LaserScan,
    /// True pose and speed, m/s, at the scan's stamp.
    truth: (Pose2, f64),
}

struct ClosedLoop<'a> {
    setup: &'a Setup<'a>,
    estimator: Estimator,
    follower: Follower,
    /// The latest scan that is not processed yet.
    mailbox: Option<PendingScan>,
    /// Answers that are not ready yet.
    answers: Vec<TimedAnswer>,
    /// When the estimator can process the next scan.
    free_at: Duration,
    /// Moving mean of the work on a complete answer, without bursts.
    complete_work: Duration,
    step: Option<Step>,
    /// For a table policy: monitors whether the conditions are those of the table.
    watch: Option<ConditionMonitor>,
    outside: Option<OutOfRange>,
    run: Run,
}

/// Drives until the laps are complete, the car hits a wall, or it has stopped for good.
pub(super) fn drive(setup: &Setup) -> Result<Run, DriveError> {
    let random = |stream| Pcg64::new(setup.seed.into(), stream);
    let mut start_random = Pcg64::seed_from_u64(setup.seed.into());
    let fraction = if setup.course.path.is_closed() { start_random.random_range(0.0..1.0) } else { 0.0 };
    let start = setup.course.start(fraction);
    let vehicle = VehicleKnobs { speed: setup.follower.speed.max(1.0), ..setup.follower.car() };
    let mut car = Car::new(setup.course.world.as_ref(), &vehicle, start);
    let mut lidar = Lidar::new(&setup.lidar, random(1));
    let mut odometer = Odometer::new(&setup.odometer, start, random(2));
    let flaws = CarFlaws::sample(&setup.flaws, vehicle.wheelbase, random(4));
    let mut drive = ClosedLoop::new(setup, start)?;
    let mut truth = Progress::new(setup.course.path.clone(), START);
    let mut planner = setup.replanning.map(|replanning| Planner::new(replanning, &setup.course.path));
    let planned = planner.as_mut().and_then(|planner| planner.plan(&start));
    drive.follower.follow_path(planned.unwrap_or_else(|| setup.course.path.clone()), START);
    let (scan_period, odometry_period) = (period(setup.lidar.rate), period(setup.odometer.rate));
    let mut pending_commands: Vec<(u64, Command)> = Vec::new();
    let mut command = Command::default();
    let mut last_progress = (0, 0.0);
    let goal = f64::from(setup.laps) * setup.course.path.length();
    for now in 0_u64.. {
        let pose = car.map_from_base();
        if now.is_multiple_of(odometry_period) {
            drive.estimator.on_odometry(&odometer.read(pose, at(now)));
        }
        if now.is_multiple_of(scan_period) {
            let scan = lidar.scan(|_| setup.course.world.as_ref(), |_| pose, at(now));
            drive.send(PendingScan { arrival: now + u64::from(SCAN_LATENCY_MS), scan, truth: (pose, car.twist().vx) });
        }
        drive.process_scan(now, scan_period);
        drive.deliver_answers(now);
        if let Some((path, planned)) = planner.as_mut().and_then(|planner| planner.tick(now, &pose)) {
            drive.replan(path, at(planned), &pose);
        }
        if now.is_multiple_of(COMMAND_PERIOD) {
            pending_commands.push((now + actuation_delay(&setup.follower), drive.command(now)));
        }
        pending_commands.retain(|&(due, given)| {
            if due <= now {
                command = given;
            }
            due > now
        });
        car.step(flaws.apply(command), TICK as f64 * 1e-3);
        if now.is_multiple_of(ERROR_PERIOD) {
            drive.run.record_error(now, truth.update(&pose, 0.5), &pose);
        }
        let driven = truth.distance_driven();
        if driven > last_progress.1 + MIN_PROGRESS {
            last_progress = (now, driven);
        }
        drive.run.count_laps(now, driven, setup.course.path.length());
        if let Some(ending) = ending(&car, driven >= goal, drive.step, now - last_progress.0) {
            return Ok(drive.end(ending, now, driven));
        }
    }
    unreachable!("every drive ends")
}

fn ending(car: &Car, is_done: bool, step: Option<Step>, idle: u64) -> Option<Ending> {
    if car.hits() > 0 {
        return Some(Ending::Hit);
    }
    let arrived = step.is_some_and(|step| step.stop == Some(crate::control::safety::StopReason::Arrived));
    if is_done || (arrived && car.twist().vx.abs() < ARRIVED_SPEED) {
        return Some(Ending::Finished);
    }
    (idle > STUCK_TIME).then_some(Ending::Stopped)
}

fn at(milliseconds: u64) -> Stamp {
    START.offset_by(milliseconds as f64 * 1e-3)
}

/// Period of a rate in Hz, in whole ms.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // the ranges of the knobs keep it small and positive
fn period(rate: f64) -> u64 {
    (1000.0 / rate).round().max(1.0) as u64
}

/// Actuation delay in whole ms.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // as for `period`
fn actuation_delay(knobs: &FollowerKnobs) -> u64 {
    (1000.0 * knobs.actuation_delay.0).round() as u64
}

impl<'a> ClosedLoop<'a> {
    fn new(setup: &'a Setup<'a>, start: Pose2) -> Result<Self, DriveError> {
        let processor = Arc::new(Processor::new(setup.costs.clone(), setup.load));
        let laser = setup.lidar.laser_in_base;
        let estimator = Estimator::new(setup.estimator, setup.course, setup.config, start, laser, &processor)?;
        Ok(Self {
            setup,
            estimator,
            follower: Follower::new(setup.follower.clone()),
            mailbox: None,
            answers: Vec::new(),
            free_at: Duration::ZERO,
            complete_work: Duration::ZERO,
            step: None,
            watch: match &setup.policy {
                Policy::Table(table) => Some(ConditionMonitor::new(table.conditions)),
                _ => None,
            },
            outside: None,
            run: Run::new(setup.seed),
        })
    }

    fn send(&mut self, pending: PendingScan) {
        self.run.dropped += u64::from(self.mailbox.replace(pending).is_some());
    }

    /// Processes the latest scan if it has arrived and the estimator is idle.
    fn process_scan(&mut self, now: u64, scan_period: u64) {
        let time = Duration::from_millis(now);
        if self.free_at > time {
            return;
        }
        let Some(PendingScan { arrival, scan, truth }) = self.mailbox.take_if(|pending| pending.arrival <= now) else { return };
        let times =
            Times { arrival: Duration::from_millis(arrival), begin: time, next: Duration::from_millis(arrival + scan_period) };
        let terms = self.setup.policy.terms(&self.situation(time, scan_period));
        let answer = self.estimator.answer(&scan, times, terms, truth);
        self.free_at = answer.free_at;
        if answer.is_complete {
            let weight = if self.complete_work.is_zero() { 1.0 } else { SMOOTHING };
            self.complete_work = self.complete_work.mul_f64(1.0 - weight) + answer.work.mul_f64(weight);
        }
        self.run.add_answer(&answer, times, &truth.0);
        if let (Some(watch), Some(conditions)) = (&mut self.watch, &answer.conditions) {
            self.outside = watch.add(conditions);
        }
        if let Some(outside) = self.outside {
            self.run.add_outside(outside);
        }
        self.answers.push(if self.setup.steer_by_truth { true_answer(&scan, times, truth) } else { answer });
    }

    fn situation(&self, time: Duration, scan_period: u64) -> Situation {
        let speed = self.step.map_or(0.0, |step| step.command.speed);
        let lookahead = self.setup.follower.lookahead(speed);
        let along = self.step.and_then(|step| step.projection).map_or(0.0, |projection| projection.along);
        let clearance = self.setup.course.clearance(along, lookahead) - 0.5 * self.setup.follower.width;
        let uncompensated_yaw_rate =
            if self.setup.follower.compensate_delay { 0.0 } else { speed * self.setup.course.curvature(along, lookahead) };
        let period = Duration::from_millis(scan_period);
        let full_answer_time = self.setup.load.finish_time(time, self.complete_work).saturating_sub(time);
        Situation {
            speed,
            lookahead,
            clearance,
            uncompensated_yaw_rate,
            period,
            is_profile_valid: self.outside.is_none(),
            full_answer_time,
        }
    }

    fn deliver_answers(&mut self, now: u64) {
        let time = Duration::from_millis(now);
        let follower = &mut self.follower;
        self.answers.retain(|answer| {
            let is_ready = answer.ready_at <= time;
            if is_ready {
                follower.on_pose(answer.reading);
            }
            !is_ready
        });
    }

    fn replan(&mut self, path: crate::control::path::Path, planned: Stamp, pose: &Pose2) {
        let lateral_error = |follower: &Follower| {
            let progress = follower.progress()?;
            Some(progress.path().project(pose, 0.0, progress.path().length())?.lateral_error)
        };
        let before = lateral_error(&self.follower);
        let update = self.follower.follow_path(path, planned);
        self.run.line_jump = self.run.line_jump.max(line_jump(before, update, lateral_error(&self.follower)));
    }

    fn command(&mut self, now: u64) -> Command {
        let step = self.follower.command(at(now));
        self.run.add_step(&step);
        self.step = Some(step);
        step.command
    }

    fn end(mut self, ending: Ending, now: u64, driven: f64) -> Run {
        self.run.ending = ending;
        self.run.seconds = now as f64 * 1e-3;
        self.run.laps = driven / self.setup.course.path.length();
        self.run
    }
}

impl Run {
    /// Records the true tracking error and, at a fifth of the rate, the car's position for the pictures.
    fn record_error(&mut self, now: u64, projection: Option<crate::control::path::Projection>, pose: &Pose2) {
        let Some(projection) = projection else { return };
        self.add_error(projection.distance);
        if now.is_multiple_of(5 * ERROR_PERIOD) {
            self.trace.push(Trace { point: Point::new(pose.x, pose.y), error: projection.distance });
        }
    }
}
