//! The algorithm of the path follower node.

use std::fs;
use std::time::Duration;

use rosrust::api::{Master, Ros};

use super::intake::{Intake, Remark};
use super::{AllKnobs, PathFollowerKnobs, convert};
use crate::anytime::timer::Timer;
use crate::app::InputError;
use crate::control::follower::{Follower, Step};
use crate::control::progress::Progress;
use crate::control::safety::StopReason;
use crate::control::waypoint_file;
use crate::io::map_file;
use crate::messages::ackermann_msgs::AckermannDriveStamped;
use crate::messages::geometry_msgs::PoseStamped;
use crate::messages::own::FollowerReport;
use crate::messages::tf2_msgs::TFMessage;
use crate::messages::visualization_msgs::Marker;
use crate::ros::context::{Context, Shared};
use crate::ros::input::Input;
use crate::ros::log::Log;
use crate::ros::mailbox::Request;
use crate::ros::node::{Node, NodeParts};
use crate::ros::output::Output;
use crate::ros::sink::RawMessage;
use crate::ros::worker::Algorithm;
use crate::ros::{NodeError, params, services};
use crate::time::Stamp;

/// The service that lets the car continue after a stop before an obstacle, and its reply.
const RESUME: (&str, &str) = ("~resume", "the car may continue");
/// Time between two publications of the markers.
const MARKER_PERIOD: Duration = Duration::from_millis(200);

/// The publishers of the node.
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
}

/// The follower on the ROS graph.
pub(super) struct FollowerNode<'a> {
    ros: &'a Ros,
    publishers: Publishers,
    intake: Intake,
    base_frame: String,
    markers: Timer,
    number: u32,
    /// Code of the last logged reason for a stop.
    stop: Option<&'static str>,
}

/// Builds the node. It publishes a command each time its timer expires.
pub(super) fn build<'a>(ros: &'a Ros, master: &'a Master, knobs: AllKnobs) -> Result<Node<'a>, NodeError> {
    let mut parts = NodeParts::new(ros, master)?;
    let Shared { clock, log, mailbox, .. } = parts.shared.clone();
    let AllKnobs { node, follower } = knobs;
    let publishers = Publishers::new(ros)?;
    parts.services = vec![services::reset(ros, RESUME, &mailbox)?];
    log.info(&format!(
        "following paths with the control law {}: up to {} m/s, {} commands per second",
        follower.law.name(),
        follower.speed,
        node.rate
    ));
    let mut intake = Intake::new(Follower::new(follower), node.clone());
    read_files(ros.name(), &node, &mut intake, &log)?;
    let now = clock.now();
    let (commands, markers) = (Timer::new(Duration::from_secs_f64(node.rate.recip()), now), Timer::new(MARKER_PERIOD, now));
    let follower = FollowerNode { ros, publishers, intake, base_frame: node.base_frame, markers, number: 0, stop: None };
    parts.build("following", follower, FollowerNode::inputs(), Some(commands))
}

impl FollowerNode<'_> {
    /// The topics it subscribes to.
    fn inputs() -> Vec<Input<Self>> {
        vec![
            Input::with_context("path", |node: &mut Self, message, _, context| {
                let remark = node.intake.on_path(message);
                node.log(remark, context);
                Ok::<_, String>(())
            }),
            Input::with_context("pose", |node: &mut Self, message, _, context| {
                node.intake.on_pose(message)?;
                let remark = node.intake.start_loop();
                node.log(remark, context);
                Ok::<_, String>(())
            })
            .required(),
            Input::of("scan", |node: &mut Self, message| node.intake.on_scan(message)),
            Input::of("map", |node: &mut Self, message| node.intake.on_map(message)),
            Input::with_context("move_base_simple/goal", Self::on_goal),
            Input::with_context("/tf", Self::on_transforms),
            Input::with_context("/tf_static", Self::on_transforms),
        ]
    }

    fn now(&self) -> Stamp {
        let time = self.ros.now();
        Stamp::from_ros(time.sec, time.nsec)
    }

    fn on_transforms(&mut self, message: &TFMessage, _: &RawMessage, context: &mut Context) -> Result<(), InputError> {
        let outcome = self.intake.on_transforms(message);
        let remark = self.intake.retry();
        self.log(remark, context);
        outcome
    }

    fn on_goal(&mut self, message: &PoseStamped, _: &RawMessage, context: &mut Context) -> Result<(), String> {
        let now = self.now();
        let from = self.intake.follower.pose_at(now);
        let remark = self.intake.on_goal(message, from, now)?;
        self.log(remark, context);
        Ok(())
    }

    /// Logs a remark of the intake.
    fn log(&self, remark: Option<Remark>, context: &mut Context) {
        match remark {
            // A planner that keeps sending paths would flood the log.
            Some(Remark::Info(text)) if self.stop.is_some() || self.number == 0 => context.shared.log.info(&text),
            None | Some(Remark::Info(_)) => {}
            Some(Remark::Warning(text)) => context.reader.warn("path", &text),
        }
    }

    /// Publishes a command. Nothing is published on `drive` before the first path, since another node may be in control.
    fn command(&mut self, context: &Context) {
        let now = self.now();
        let step = self.intake.follower.command(now);
        self.log_stop(&step, &context.shared.log);
        let (number, frame) = (self.number, self.intake.frame());
        let path = self.intake.follower.progress().map(Progress::path);
        self.publishers.report.send(|| convert::report(number, now, frame, &step, path));
        if path.is_some() || self.number > 0 {
            self.publishers.drive.send(|| convert::drive(number, now, &self.base_frame, &step));
            self.number = self.number.wrapping_add(1).max(1);
        }
        if self.markers.is_due(context.shared.clock.now())
            && self.publishers.markers.has_subscribers()
            && let Some(path) = path
        {
            for marker in convert::markers(now, frame, path, &step) {
                self.publishers.markers.send(|| marker);
            }
        }
    }

    /// Logs each start, stop and change of the reason for a stop.
    fn log_stop(&mut self, step: &Step, log: &Log) {
        let stop = step.stop.as_ref().map(StopReason::code);
        if stop == self.stop {
            return;
        }
        match &step.stop {
            Some(StopReason::Arrived | StopReason::NoPath | StopReason::NoPose) | None => {
                log.info(&step.stop.map_or_else(|| "driving".into(), |stop| format!("stopped: {stop}")));
            }
            Some(reason) => log.warn(&format!("braking: {reason}")),
        }
        self.stop = stop;
    }
}

impl Algorithm for FollowerNode<'_> {
    /// A call of the service `~resume`.
    fn request(&mut self, request: Request, context: &mut Context) {
        if request == Request::Reset {
            context.shared.log.info("resumed by the service ~resume");
            self.intake.follower.resume();
        }
    }

    fn on_timer(&mut self, context: &mut Context) {
        self.command(context);
    }

    /// Publishes a last command to stop.
    fn end(&mut self, _: &Context) {
        if self.intake.follower.progress().is_some() {
            self.publishers.drive.send(AckermannDriveStamped::default);
        }
    }
}

/// Reads map and path from the files that the parameters name.
fn read_files(node: &str, knobs: &PathFollowerKnobs, intake: &mut Intake, log: &Log) -> Result<(), NodeError> {
    if let Some(file) = &knobs.map_file {
        let remark = intake.set_map(map_file::read(std::path::Path::new(file))?)?;
        log_remark(remark, log);
    }
    match &knobs.path_file {
        Some(file) => read_path(node, file, intake, log),
        None => Ok(()),
    }
}

/// Reads a path file. Its path has the oldest possible stamp, so any path on the topic replaces it.
fn read_path(node: &str, file: &str, intake: &mut Intake, log: &Log) -> Result<(), NodeError> {
    let invalid = |problem: String| params::bad_value(node, "path_file", format!("{file}: {problem}"));
    let text = fs::read_to_string(file).map_err(|problem| invalid(problem.to_string()))?;
    let waypoints = waypoint_file::parse(&text).map_err(|problem| invalid(problem.to_string()))?;
    match intake.take(&waypoints, Stamp::default()) {
        Some(Remark::Warning(problem)) => Err(invalid(problem)),
        remark => {
            log_remark(remark, log);
            Ok(())
        }
    }
}

fn log_remark(remark: Option<Remark>, log: &Log) {
    match remark {
        None => {}
        Some(Remark::Info(text)) => log.info(&text),
        Some(Remark::Warning(text)) => log.warn(&format!("path: {text}")),
    }
}
