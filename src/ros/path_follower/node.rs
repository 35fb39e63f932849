//! The follower as a node.

use std::fs;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::Duration;

use rosrust::api::{Master, Ros};

use super::intake::{Intake, Remark};
use super::{AllKnobs, PathFollowerKnobs, convert};
use crate::anytime::clock::{Clock, MonotonicClock};
use crate::anytime::timer::Timer;
use crate::control::follower::{Follower, Step};
use crate::control::progress::Progress;
use crate::control::safety::StopReason;
use crate::control::waypoint_file;
use crate::io::map_file;
use crate::messages::Message;
use crate::messages::ackermann_msgs::AckermannDriveStamped;
use crate::messages::geometry_msgs::PoseStamped;
use crate::messages::nav_msgs::{OccupancyGrid, Odometry, Path};
use crate::messages::own::FollowerReport;
use crate::messages::sensor_msgs::LaserScan;
use crate::messages::tf2_msgs::TFMessage;
use crate::messages::visualization_msgs::Marker;
use crate::ros::NodeError;
use crate::ros::log::Log;
use crate::ros::master::{MasterLink, MasterRegistration};
use crate::ros::output::Output;
use crate::ros::params;
use crate::ros::reader::Reader;
use crate::ros::services::{self, Service};
use crate::ros::shutdown::StopSignal;
use crate::ros::sink::{RawMessage, Topic};
use crate::ros::subscriptions::Subscriptions;
use crate::time::Stamp;

/// From one look at the master to the next.
const MASTER_PERIOD: Duration = Duration::from_secs(1);
/// From one picture of the path to the next.
const MARKER_PERIOD: Duration = Duration::from_millis(200);

/// Its inputs.
#[derive(Clone, Copy, Debug)]
enum Input {
    Path,
    Pose,
    Scan,
    Map,
    Goal,
    Transforms,
    StaticTransforms,
    Resume,
}

impl Input {
    const TOPICS: [Self; 7] =
        [Self::Path, Self::Pose, Self::Scan, Self::Map, Self::Goal, Self::Transforms, Self::StaticTransforms];

    fn topic(self) -> Topic {
        match self {
            Self::Path | Self::Resume => Topic::of::<Path>("path"),
            Self::Pose => Topic::vital::<Odometry>("pose"),
            Self::Scan => Topic::of::<LaserScan>("scan"),
            Self::Map => Topic::of::<OccupancyGrid>("map"),
            Self::Goal => Topic::of::<PoseStamped>("move_base_simple/goal"),
            Self::Transforms => Topic::of::<TFMessage>("/tf"),
            Self::StaticTransforms => Topic::of::<TFMessage>("/tf_static"),
        }
    }
}

/// Its outputs.
struct Publishers {
    drive: Output<AckermannDriveStamped>,
    report: Output<FollowerReport>,
    markers: Output<Marker>,
}

impl Publishers {
    fn new(ros: &Ros) -> Result<Self, NodeError> {
        Ok(Self {
            drive: Output::new(ros, "drive")?,
            report: Output::new(ros, "follower/report")?,
            markers: Output::new(ros, "follower/viz")?,
        })
    }

    fn registrations(&self) -> [MasterRegistration; 3] {
        [self.drive.registration(), self.report.registration(), self.markers.registration()]
    }
}

pub(super) struct Node<'a> {
    ros: &'a Ros,
    clock: Arc<dyn Clock>,
    master: MasterLink<'a>,
    received: Receiver<(Input, Option<RawMessage>)>,
    publishers: Publishers,
    intake: Intake,
    base_frame: String,
    commands: Timer,
    markers: Timer,
    number: u32,
    /// As last said.
    stop: Option<&'static str>,
    log: Log,
    reader: Reader,
    _resume: Service,
    // Dropping this ends them.
    _subscriptions: Subscriptions<'a>,
}

impl<'a> Node<'a> {
    pub(super) fn start(ros: &'a Ros, master: &'a Master, knobs: AllKnobs) -> Result<Self, NodeError> {
        let log = Log::new(ros)?;
        let clock: Arc<dyn Clock> = Arc::new(MonotonicClock::default());
        let publishers = Publishers::new(ros)?;
        let (sender, received) = channel();
        let subscriptions = Subscriptions::new(ros, &clock, &log)?;
        Input::TOPICS.into_iter().try_for_each(|input| subscribe(&subscriptions, input, sender.clone()))?;
        let resume = services::trigger(ros, "~resume", move || {
            drop(sender.send((Input::Resume, None)));
            Ok("the car may go on".into())
        })?;
        let mut registrations: Vec<MasterRegistration> = Input::TOPICS.map(|input| input.topic().registration()).into();
        registrations.extend(publishers.registrations());
        registrations.extend([resume.registration(ros)?, MasterRegistration::ROSOUT]);
        let master = MasterLink::new(ros, master, registrations, &log)?;
        let (now, reader) = (clock.now(), Reader::new(&clock, &log));
        let AllKnobs { node, follower } = knobs;
        log.info(&format!(
            "follows paths by {} at up to {} m/s, {} commands a second",
            follower.law.name(),
            follower.speed,
            node.rate
        ));
        let period = Duration::from_secs_f64(node.rate.recip());
        let mut intake = Intake::new(Follower::new(follower), node.clone());
        read_files(ros.name(), &node, &mut intake, &log)?;
        Ok(Self {
            ros,
            clock,
            master,
            received,
            publishers,
            intake,
            base_frame: node.base_frame,
            commands: Timer::new(period, now),
            markers: Timer::new(MARKER_PERIOD, now),
            number: 0,
            stop: None,
            log,
            reader,
            _resume: resume,
            _subscriptions: subscriptions,
        })
    }

    /// Runs until it is told to stop. The last command is to stand.
    pub(super) fn run(mut self, stop: &StopSignal) {
        let mut looks = Timer::new(MASTER_PERIOD, self.clock.now());
        while !stop.wait(Duration::ZERO) && self.ros.is_ok() {
            if let Ok((input, raw)) = self.received.recv_timeout(self.commands.left(self.clock.now())) {
                self.handle(input, raw.as_ref());
            }
            let now = self.clock.now();
            if self.commands.is_due(now) {
                self.command(now);
            }
            if looks.is_due(now) {
                self.master.check();
            }
        }
        if self.intake.follower.progress().is_some() {
            let message = AckermannDriveStamped::default();
            self.publishers.drive.send(|| message);
        }
    }

    fn now(&self) -> Stamp {
        let time = self.ros.now();
        Stamp::from_ros(time.sec, time.nsec)
    }

    fn handle(&mut self, input: Input, raw: Option<&RawMessage>) {
        let Some(raw) = raw else {
            self.log.info("told to go on");
            return self.intake.follower.resume();
        };
        match input {
            Input::Pose => {
                self.with(raw, "pose", |intake, message| intake.on_pose(&message));
                let remark = self.intake.begin_round();
                self.say(remark);
            }
            Input::Scan => self.with(raw, "scan", |intake, message| intake.on_scan(&message)),
            Input::Map => self.with(raw, "map", |intake, message| intake.on_map(&message)),
            Input::Transforms | Input::StaticTransforms => {
                self.with(raw, "tf", |intake, message| {
                    intake.on_transforms(&message);
                    Ok(())
                });
                let remark = self.intake.retry();
                self.say(remark);
            }
            Input::Path | Input::Resume => {
                if let Some(message) = self.reader.read::<Path>(Path::TYPE, raw) {
                    let remark = self.intake.on_path(message);
                    self.say(remark);
                }
            }
            Input::Goal => self.on_goal(raw),
        }
    }

    fn with<T: Message>(
        &mut self,
        raw: &RawMessage,
        name: &'static str,
        take: impl FnOnce(&mut Intake, T) -> Result<(), String>,
    ) {
        if let Some(message) = self.reader.read::<T>(T::TYPE, raw)
            && let Err(problem) = take(&mut self.intake, message)
        {
            self.reader.warn(name, &problem);
        }
    }

    fn on_goal(&mut self, raw: &RawMessage) {
        let Some(message) = self.reader.read::<PoseStamped>(PoseStamped::TYPE, raw) else { return };
        let now = self.now();
        let from = self.intake.follower.pose_at(now);
        match self.intake.on_goal(&message, from, now) {
            Ok(remark) => self.say(remark),
            Err(problem) => self.reader.warn("move_base_simple/goal", &problem),
        }
    }

    fn say(&mut self, remark: Option<Remark>) {
        match remark {
            // A planner that plans again and again is no news.
            Some(Remark::Info(text)) if self.stop.is_some() || self.number == 0 => self.log.info(&text),
            None | Some(Remark::Info(_)) => {}
            Some(Remark::Warning(text)) => self.reader.warn("path", &text),
        }
    }

    /// Publishes a command; nothing on `drive` before there was a path: another node may be in control.
    fn command(&mut self, time: Duration) {
        let now = self.now();
        let step = self.intake.follower.command(now);
        self.tell_stop(&step);
        let (number, frame) = (self.number, self.intake.frame());
        let path = self.intake.follower.progress().map(Progress::path);
        self.publishers.report.send(|| convert::report(number, now, frame, &step, path));
        if path.is_some() || self.number > 0 {
            self.publishers.drive.send(|| convert::drive(number, now, &self.base_frame, &step));
            self.number = self.number.wrapping_add(1).max(1);
        }
        if self.markers.is_due(time)
            && self.publishers.markers.has_listeners()
            && let Some(path) = path
        {
            for marker in convert::markers(now, frame, path, &step) {
                self.publishers.markers.send(|| marker);
            }
        }
    }

    /// A line for each change of mind.
    fn tell_stop(&mut self, step: &Step) {
        let stop = step.stop.as_ref().map(StopReason::code);
        if stop == self.stop {
            return;
        }
        match &step.stop {
            Some(StopReason::Arrived | StopReason::NoPath | StopReason::NoPose) | None => {
                self.log.info(&step.stop.map_or_else(|| "drives".into(), |stop| format!("stands: {stop}")));
            }
            Some(reason) => self.log.warn(&format!("brakes: {reason}")),
        }
        self.stop = stop;
    }
}

fn subscribe(subscriptions: &Subscriptions, input: Input, sender: Sender<(Input, Option<RawMessage>)>) -> Result<(), NodeError> {
    // Nobody listens any more when the node is ending.
    subscriptions.listen(input.topic(), move |raw| drop(sender.send((input, Some(raw)))))
}

/// Takes map and path from the files that the parameters name.
fn read_files(node: &str, knobs: &PathFollowerKnobs, intake: &mut Intake, log: &Log) -> Result<(), NodeError> {
    if let Some(file) = &knobs.map_file {
        let remark = intake.set_map(map_file::read(std::path::Path::new(file))?)?;
        tell(remark, log);
    }
    match &knobs.path_file {
        Some(file) => read_path(node, file, intake, log),
        None => Ok(()),
    }
}

/// The path of a file is older than any that comes.
fn read_path(node: &str, file: &str, intake: &mut Intake, log: &Log) -> Result<(), NodeError> {
    let refused = |problem: String| params::refused(node, "path_file", format!("{file}: {problem}"));
    let text = fs::read_to_string(file).map_err(|problem| refused(problem.to_string()))?;
    let waypoints = waypoint_file::parse(&text).map_err(|problem| refused(problem.to_string()))?;
    match intake.take(&waypoints, Stamp::default()) {
        Some(Remark::Warning(problem)) => Err(refused(problem)),
        remark => {
            tell(remark, log);
            Ok(())
        }
    }
}

fn tell(remark: Option<Remark>, log: &Log) {
    match remark {
        None => {}
        Some(Remark::Info(text)) => log.info(&text),
        Some(Remark::Warning(text)) => log.warn(&text),
    }
}
