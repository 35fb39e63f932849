//! The algorithm of the scan matcher node: it passes messages to the application and publishes the answers.

use std::sync::mpsc::Sender;
use std::time::Duration;

use super::compat::Predictors;
use super::convert::Outgoing;
use super::publishers::Publishers;
use crate::app::sensed::SensorMessage;
use crate::app::{App, Estimate, InputError, ScanProcessor as _};
use crate::config::FrameKnobs;
use crate::messages::geometry_msgs::TwistStamped;
use crate::messages::std_msgs::Header;
use crate::messages::tf2_msgs::TFMessage;
use crate::odometry::Outcome;
use crate::ros::context::{Context, Shared};
use crate::ros::diagnostics::{IMU_REJECTED, ODOMETRY_CONTRADICTED, ODOMETRY_REJECTED, OUTSIDE_PROFILE, Sample};
use crate::ros::input::Input;
use crate::ros::live_params::MatchingChange;
use crate::ros::mailbox::{NextScan, Request};
use crate::ros::mapper::MapFeed;
use crate::ros::priority::yield_to_writers;
use crate::ros::services::Reply;
use crate::ros::sink::RawMessage;
use crate::ros::transform_output::ConflictingPublisher;
use crate::ros::worker::Algorithm;

/// Everything that the matching thread owns.
pub(super) struct MatcherNode {
    app: App,
    publishers: Publishers,
    /// Channel for replies to service calls.
    replies: Sender<Reply>,
    /// Channel to the mapping thread, if a map is built.
    map: Option<MapFeed>,
}

impl MatcherNode {
    pub(super) fn new(app: App, publishers: Publishers, replies: Sender<Reply>, map: Option<MapFeed>) -> Self {
        Self { app, publishers, replies, map }
    }

    /// The topics it subscribes to: point clouds or scans, and the wanted sources of prediction.
    pub(super) fn inputs(are_clouds: bool, predictors: Predictors) -> Vec<Input<Self>> {
        let predicting = [
            (predictors.odometry, Input::of("odom", |matcher: &mut Self, message| matcher.app.on_odometry(message))),
            (predictors.imu, Input::of("imu/data", |matcher: &mut Self, message| matcher.app.on_imu(message))),
            (predictors.velocity, Input::of("vel", |matcher: &mut Self, message| matcher.app.on_velocity(message))),
            (
                predictors.stamped_velocity,
                Input::of("vel", |matcher: &mut Self, message: &TwistStamped| matcher.app.on_velocity(&message.twist)),
            ),
        ];
        let others = [
            Input::scans(are_clouds),
            Input::interrupts(),
            Input::of("icp_contract", |matcher: &mut Self, message| matcher.app.on_contract(message)),
            Input::with_context("initialpose", |matcher: &mut Self, message, raw, _| {
                matcher.app.on_initial_pose(message, raw.arrival)
            }),
            Input::with_context("/tf", Self::on_transforms),
            Input::with_context("/tf_static", Self::on_transforms),
        ];
        predicting.into_iter().filter(|(wanted, _)| *wanted).map(|(_, input)| input).chain(others).collect()
    }

    fn on_transforms(&mut self, message: &TFMessage, raw: &RawMessage, context: &mut Context) -> Result<(), InputError> {
        let outcome = self.app.on_transforms(message);
        self.check_conflicts(message, &raw.sender, &context.shared);
        outcome
    }

    fn save_profile(&mut self) {
        let outcome = match &self.app.config().contract.cost_file {
            None => Err("no file to save to: set the parameter contract/cost_file and restart the node".into()),
            Some(path) => {
                let done = format!("the matching costs of this machine are saved to {path}");
                self.app.store_costs().map(|()| done).map_err(|error| error.to_string())
            }
        };
        let _ = self.replies.send(outcome); // fails only while the node is ending
    }

    fn apply(&mut self, change: MatchingChange) {
        match change {
            MatchingChange::Limit(limit) => self.app.set_contract(limit.applied_to(self.app.contract())),
            MatchingChange::MaxIterations(limit) => self.app.set_max_iterations(limit),
        }
    }

    /// Yields to other publishers of this node's transforms.
    fn check_conflicts(&self, message: &TFMessage, sender: &str, shared: &Shared) {
        let FrameKnobs { odom_frame, base_frame, .. } = &self.app.config().frames;
        let transform = self.publishers.transform();
        for child in [base_frame, odom_frame] {
            if let Some(other) = ConflictingPublisher::find(message, sender, child) {
                transform.yield_to(&other, child, shared);
            }
        }
        // Another node publishes odometry in our frame, by a chain of transforms to the base. Then this node must not publish
        // that frame.
        if self.app.transforms().is_ancestor(odom_frame, base_frame) {
            transform.yield_to(&ConflictingPublisher::new(sender, odom_frame, base_frame), odom_frame, shared);
        }
    }

    /// Logs problems, and updates the diagnostics.
    fn monitor(&self, estimate: &Estimate, context: &mut Context) {
        if let Outcome::Predicted(problem) = &estimate.registration.outcome {
            context.reader.warn("scan", &format!("not matched, the pose is the prediction: {problem}"));
        }
        let rejected = estimate.registration.rejected_sources;
        context.shared.monitor.set_condition(ODOMETRY_REJECTED, rejected.odometry);
        context.shared.monitor.set_condition(ODOMETRY_CONTRADICTED, estimate.registration.contradicts_odometry);
        context.shared.monitor.set_condition(IMU_REJECTED, rejected.imu);
        context.shared.monitor.set_condition(OUTSIDE_PROFILE, estimate.outside_profile.is_some());
        context.shared.monitor.set_odometry_lag(self.app.odometry_lag());
        context.log_mount(self.app.mount());
        context.shared.monitor.record(Sample::from(estimate));
    }
}

impl Algorithm for MatcherNode {
    const REAL_TIME_WAKEUP: bool = true;

    fn begin(&mut self, context: &mut Context) {
        context.log_priority();
    }

    fn request(&mut self, request: Request, _: &mut Context) {
        match request {
            Request::Reset => self.app.reset(),
            Request::SaveProfile => self.save_profile(),
            Request::Change(change) => self.apply(change),
        }
    }

    fn wait_for_inputs(&self, header: &Header) -> Option<Duration> {
        self.app.wait_for_inputs(header)
    }

    /// Every scan improves the map, so scans may wait for as long as one is held back for its odometry.
    fn max_queue_time(&self) -> Duration {
        if self.map.is_some() { self.app.max_odometry_wait() } else { Duration::ZERO }
    }

    fn answer(&mut self, scan: &SensorMessage, arrival: Duration, context: &mut Context) {
        context.real_time.set(self.app.contract().time_budget.is_some());
        self.app.set_keep_matched_points(self.publishers.wants_matched_points());
        let (publishers, map) = (&mut self.publishers, &mut self.map);
        let mut answered = self.app.answer(scan, arrival, |app, estimate| {
            if let Some(map) = map {
                map.set_map_from_odom(estimate);
            }
            publishers.publish_pose(&Outgoing { estimate, number: number(app), frames: &app.config().frames });
        });
        let (app, estimate) = answered.parts();
        context.shared.interrupts.publish(estimate);
        context.real_time.set(false);
        yield_to_writers();
        let (now, answer) =
            (context.shared.clock.now(), Outgoing { estimate, number: number(app), frames: &app.config().frames });
        publishers.publish_details(&answer, app.odometry_counters(), context.shared.mailbox.dropped().scans);
        publishers.publish_display(&answer, app.matched_points(), now);
        yield_to_writers();
        if let Some(map) = map {
            map.send(scan, estimate, app);
        }
        let estimate = answered.maintain(&NextScan(&context.shared.mailbox));
        context.log_remarks(self.app.take_warnings());
        self.monitor(&estimate, context);
    }

    fn end(&mut self, context: &Context) {
        if let Err(error) = self.app.store_costs() {
            context.shared.log.warn(&error.to_string());
        }
    }
}

/// Sequence number of the current answer for message headers, where it wraps around.
#[allow(clippy::cast_possible_truncation)]
fn number(app: &App) -> u32 {
    app.counters().scans as u32
}
