//! One drive, millisecond by millisecond.

use std::sync::Arc;
use std::time::Duration;

use rand::{RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64;

use super::course::Course;
use super::estimator::{Answer, Estimator, Times, of_truth};
use super::figures::{Ending, Run, Trace};
use super::flaws::{CarFlaws, FlawKnobs};
use super::processor::{Load, Processor};
use super::replanning::{Planner, Replanning, step_aside};
use super::{DriveError, EstimatorKind};
use crate::anytime::cost_model::CostModel;
use crate::anytime::mode::{Outside, Watch};
use crate::config::Config;
use crate::control::follower::{Follower, FollowerKnobs, Step};
use crate::control::policy::{Policy, Situation};
use crate::control::progress::Progress;
use crate::geometry::{Point, Pose2};
use crate::messages::sensor_msgs::LaserScan;
use crate::simulation::car::Car;
use crate::simulation::drive::START;
use crate::simulation::lidar::{Lidar, LidarKnobs};
use crate::simulation::odometer::{Odometer, OdometerKnobs};
use crate::simulation::vehicle::{Command, VehicleKnobs};
use crate::time::Stamp;

/// From one moment to the next, ms.
const TICK: u64 = 1;
/// From the last ray of a scan to its arrival, ms: drivers take some milliseconds.
const SCAN_LATENCY: u64 = 5;
/// From one command to the next, ms.
const COMMAND_PERIOD: u64 = 20;
/// From one look at the true error to the next, ms.
const LOOK_PERIOD: u64 = 10;
/// A car that has not come on for so long has stopped for good, ms.
const STUCK: u64 = 10_000;
/// It has come on when it is so much farther, m.
const ON: f64 = 0.2;
/// Weight of the last whole answer's work in the mean that an oracle knows.
const SMOOTHING: f64 = 0.1;

/// Everything that makes a drive.
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
    /// The car is steered by the truth, whatever the estimator answers: to see how good the answers are, come what may.
    pub(super) by_truth: bool,
}

/// A scan on its way.
struct Sent {
    arrival: u64,
    scan: LaserScan,
    truth: (Pose2, f64),
}

struct Loop<'a> {
    setup: &'a Setup<'a>,
    estimator: Estimator,
    follower: Follower,
    /// The newest scan that has not been taken up.
    mailbox: Option<Sent>,
    /// Answers that are not ready yet.
    answers: Vec<Answer>,
    free: Duration,
    /// Work on a whole answer without bursts, as a moving mean.
    whole: Duration,
    step: Option<Step>,
    /// Of a policy that goes by a table: whether that holds here.
    watch: Option<Watch>,
    outside: Option<Outside>,
    run: Run,
}

/// Drives until the laps are done, a wall is hit, or the car has stopped.
pub(super) fn drive(setup: &Setup) -> Result<Run, DriveError> {
    let random = |stream| Pcg64::new(setup.seed.into(), stream);
    let mut begin = Pcg64::seed_from_u64(setup.seed.into());
    let part = if setup.course.path.is_closed() { begin.random_range(0.0..1.0) } else { 0.0 };
    let start = setup.course.start(part);
    let vehicle = VehicleKnobs { speed: setup.follower.speed.max(1.0), ..setup.follower.car() };
    let mut car = Car::new(setup.course.world.as_ref(), &vehicle, start);
    let mut lidar = Lidar::new(&setup.lidar, random(1));
    let mut odometer = Odometer::new(&setup.odometer, start, random(2));
    let flaws = CarFlaws::draw(&setup.flaws, vehicle.wheelbase, random(4));
    let mut drive = Loop::new(setup, start)?;
    let mut truth = Progress::new(setup.course.path.clone(), START);
    let mut planner = setup.replanning.map(|how| Planner::new(how, &setup.course.path));
    match planner.as_mut().and_then(|planner| planner.plan(&start)) {
        Some(path) => drop(drive.follower.take_path(path, START)),
        None => drop(drive.follower.take_path(setup.course.path.clone(), START)),
    }
    let (scan_period, odometry_period) = (period(setup.lidar.rate), period(setup.odometer.rate));
    let mut acting: Vec<(u64, Command)> = Vec::new();
    let mut command = Command::default();
    let mut came_on = (0, 0.0);
    let goal = f64::from(setup.laps) * setup.course.path.length();
    for now in 0_u64.. {
        let pose = car.map_from_base();
        if now.is_multiple_of(odometry_period) {
            drive.estimator.on_odometry(&odometer.read(pose, at(now)));
        }
        if now.is_multiple_of(scan_period) {
            let scan = lidar.scan(|_| setup.course.world.as_ref(), |_| pose, at(now));
            drive.send(Sent { arrival: now + SCAN_LATENCY, scan, truth: (pose, car.twist().vx) });
        }
        drive.take_up(now, scan_period);
        drive.deliver(now);
        if let Some((path, planned)) = planner.as_mut().and_then(|planner| planner.tick(now, &pose)) {
            drive.replan(path, at(planned), &pose);
        }
        if now.is_multiple_of(COMMAND_PERIOD) {
            acting.push((now + delay(&setup.follower), drive.command(now)));
        }
        acting.retain(|&(due, given)| {
            if due <= now {
                command = given;
            }
            due > now
        });
        car.step(flaws.done(command), TICK as f64 * 1e-3);
        if now.is_multiple_of(LOOK_PERIOD) {
            drive.run.look(now, truth.look(&pose, 0.5), &pose);
        }
        let driven = truth.driven();
        if driven > came_on.1 + ON {
            came_on = (now, driven);
        }
        drive.run.count_laps(now, driven, setup.course.path.length());
        if let Some(ending) = ending(&car, driven >= goal, drive.step, now - came_on.0) {
            return Ok(drive.end(ending, now, driven));
        }
    }
    unreachable!("a car stops some time")
}

fn ending(car: &Car, is_done: bool, step: Option<Step>, idle: u64) -> Option<Ending> {
    if car.hits() > 0 {
        return Some(Ending::Hit);
    }
    let arrived = step.is_some_and(|step| step.stop == Some(crate::control::safety::StopReason::Arrived));
    if is_done || (arrived && car.twist().vx.abs() < ON) {
        return Some(Ending::Finished);
    }
    (idle > STUCK).then_some(Ending::Stopped)
}

fn at(milliseconds: u64) -> Stamp {
    START.offset_by(milliseconds as f64 * 1e-3)
}

/// In whole ms.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // knobs have their ranges
fn period(rate: f64) -> u64 {
    (1000.0 / rate).round().max(1.0) as u64
}

#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
fn delay(knobs: &FollowerKnobs) -> u64 {
    (1000.0 * knobs.actuation_delay.0).round() as u64
}

impl<'a> Loop<'a> {
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
            free: Duration::ZERO,
            whole: Duration::ZERO,
            step: None,
            watch: match &setup.policy {
                Policy::Table(table) => Some(Watch::new(table.conditions)),
                _ => None,
            },
            outside: None,
            run: Run::new(setup.seed),
        })
    }

    fn send(&mut self, sent: Sent) {
        self.run.dropped += u64::from(self.mailbox.replace(sent).is_some());
    }

    /// A scan that has arrived is taken up when nothing else is worked on.
    fn take_up(&mut self, now: u64, scan_period: u64) {
        let time = Duration::from_millis(now);
        if self.free > time {
            return;
        }
        let Some(Sent { arrival, scan, truth }) = self.mailbox.take_if(|sent| sent.arrival <= now) else { return };
        let times =
            Times { arrival: Duration::from_millis(arrival), begin: time, next: Duration::from_millis(arrival + scan_period) };
        let terms = self.setup.policy.terms(&self.situation(time, scan_period));
        let answer = self.estimator.answer(&scan, times, terms, truth);
        self.free = answer.free;
        if answer.is_whole {
            let rest = if self.whole.is_zero() { 1.0 } else { SMOOTHING };
            self.whole = self.whole.mul_f64(1.0 - rest) + answer.work.mul_f64(rest);
        }
        self.run.add_answer(&answer, times, &truth.0);
        if let (Some(watch), Some(conditions)) = (&mut self.watch, &answer.conditions) {
            self.outside = watch.add(conditions);
        }
        if let Some(outside) = self.outside {
            self.run.add_outside(outside);
        }
        self.answers.push(if self.setup.by_truth { of_truth(&scan, times, truth) } else { answer });
    }

    fn situation(&self, time: Duration, scan_period: u64) -> Situation {
        let speed = self.step.map_or(0.0, |step| step.command.speed);
        let lookahead = self.setup.follower.lookahead(speed);
        let along = self.step.and_then(|step| step.place).map_or(0.0, |place| place.along);
        let room = self.setup.course.clearance(along, lookahead) - 0.5 * self.setup.follower.width;
        let turn = if self.setup.follower.compensate_delay { 0.0 } else { speed * self.setup.course.curvature(along, lookahead) };
        let period = Duration::from_millis(scan_period);
        let whole = self.setup.load.done(time, self.whole).saturating_sub(time);
        Situation {
            speed,
            lookahead,
            clearance: room,
            uncompensated_turn: turn,
            period,
            is_familiar: self.outside.is_none(),
            whole,
        }
    }

    fn deliver(&mut self, now: u64) {
        let time = Duration::from_millis(now);
        let follower = &mut self.follower;
        self.answers.retain(|answer| {
            let is_ready = answer.ready <= time;
            if is_ready {
                follower.on_pose(answer.reading);
            }
            !is_ready
        });
    }

    fn replan(&mut self, path: crate::control::path::Path, planned: Stamp, pose: &Pose2) {
        let line = |follower: &Follower| {
            let progress = follower.progress()?;
            Some(progress.path().project(pose, 0.0, progress.path().length())?.lateral_error)
        };
        let before = line(&self.follower);
        let arrival = self.follower.take_path(path, planned);
        self.run.step_aside = self.run.step_aside.max(step_aside(before, arrival, line(&self.follower)));
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

/// Where the car was, for a picture.
impl Run {
    fn look(&mut self, now: u64, place: Option<crate::control::path::Projection>, pose: &Pose2) {
        let Some(place) = place else { return };
        self.add_error(place.distance);
        if now.is_multiple_of(5 * LOOK_PERIOD) {
            self.trace.push(Trace { point: Point::new(pose.x, pose.y), error: place.distance });
        }
    }
}
