//! The scan matcher's work: drives the application and publishes its answers.

use std::sync::mpsc::Sender;
use std::time::Duration;

use super::convert::Outgoing;
use super::diagnostics::{IMU_DISBELIEVED, ODOMETRY_DISBELIEVED, OUTSIDE_PROFILE, TRANSFORM_WITHHELD};
use super::input::Input;
use super::live_params::MatchingChange;
use super::mailbox::{Event, NextScan};
use super::mapper::MapFeed;
use super::priority::let_writers_go_first;
use super::publishers::Publishers;
use super::services::Reply;
use super::sink::RawMessage;
use super::transform_output::ConflictingPublisher;
use super::worker::{Estimator, NodeInput as _};
use crate::app::sensed::Sensed;
use crate::app::{Answering as _, App, Estimate, InputError};
use crate::config::FrameKnobs;
use crate::messages::Message;
use crate::messages::geometry_msgs::TwistStamped;
use crate::messages::tf2_msgs::TFMessage;
use crate::odometry::Outcome;
use crate::time::Stamp;

type Desk = super::worker::Desk<Input>;

/// Everything the matching thread owns.
pub(super) struct Matcher {
    app: App,
    publishers: Publishers,
    /// Takes what came of calls of services.
    replies: Sender<Reply>,
    /// Where answers go that a map is made of.
    map: Option<MapFeed>,
}

impl Matcher {
    pub(super) fn new(app: App, publishers: Publishers, replies: Sender<Reply>, map: Option<MapFeed>) -> Self {
        Self { app, publishers, replies, map }
    }

    fn hear(&mut self, input: Input, raw: &RawMessage, desk: &mut Desk) {
        match input {
            Input::Scan | Input::Cloud | Input::Interrupt => {} // no events
            Input::Odometry => self.take(input, raw, desk, |app, message| app.on_odometry(&message)),
            Input::Imu => self.take(input, raw, desk, |app, message| app.on_imu(&message)),
            Input::Velocity => self.take(input, raw, desk, |app, message| app.on_velocity(&message)),
            Input::StampedVelocity => {
                self.take(input, raw, desk, |app, message: TwistStamped| app.on_velocity(&message.twist));
            }
            Input::InitialPose => {
                self.take(input, raw, desk, |app, message| app.on_initial_pose(&message, raw.arrival));
            }
            Input::Contract => self.take(input, raw, desk, |app, message| app.on_contract(&message)),
            Input::Transforms | Input::StaticTransforms => {
                let mut heard = None;
                self.take(input, raw, desk, |app, message: TFMessage| {
                    let outcome = app.on_transforms(&message);
                    heard = Some(message);
                    outcome
                });
                if let Some(message) = heard {
                    self.give_way(&message, &raw.sender, desk);
                }
            }
        }
    }

    fn take<T: Message>(
        &mut self,
        input: Input,
        raw: &RawMessage,
        desk: &mut Desk,
        take: impl FnOnce(&mut App, T) -> Result<(), InputError>,
    ) {
        if let Some(message) = desk.reader.read(input.name(), raw)
            && let Err(error) = take(&mut self.app, message)
        {
            desk.reader.refuse(input.name(), &raw.sender, &error);
        }
    }

    fn save_profile(&mut self) {
        let outcome = match &self.app.config().contract.cost_file {
            None => Err("there is no file to save to: set the parameter contract/cost_file and start the node again".into()),
            Some(path) => {
                let done = format!("what matching costs on this machine is in {path}");
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

    fn give_way(&self, message: &TFMessage, sender: &str, desk: &Desk) {
        let FrameKnobs { odom_frame, base_frame, .. } = &self.app.config().frames;
        for child in [base_frame, odom_frame] {
            if let Some(other) = ConflictingPublisher::find(message, sender, child) {
                self.withhold(&other, child, desk);
            }
        }
        // Another odometry in our frame, however many transforms it takes to the base: then it is not ours to say where that frame is.
        if self.app.transforms().carries(odom_frame, base_frame) {
            self.withhold(&ConflictingPublisher::new(sender, odom_frame, base_frame), odom_frame, desk);
        }
    }

    fn withhold(&self, other: &ConflictingPublisher, child: &str, desk: &Desk) {
        if let Some(warning) = self.publishers.transform().give_way(other, child) {
            desk.log.warn(&warning);
            desk.monitor.set_condition(TRANSFORM_WITHHELD, true);
        }
    }

    fn watch(&self, estimate: &Estimate, desk: &mut Desk) {
        if let Outcome::Predicted(problem) = &estimate.registration.outcome {
            desk.reader.warn("scan", &format!("no match, the pose is the prediction: {problem}"));
        }
        let disbelieved = estimate.registration.disbelieved;
        desk.monitor.set_condition(ODOMETRY_DISBELIEVED, disbelieved.odometry);
        desk.monitor.set_condition(IMU_DISBELIEVED, disbelieved.imu);
        desk.monitor.set_condition(OUTSIDE_PROFILE, estimate.outside_profile.is_some());
        desk.monitor.set_odometry_lag(self.app.odometry_lag());
        desk.watch_mount(self.app.mount());
        desk.monitor.record(estimate.into());
    }
}

impl Estimator for Matcher {
    type Input = Input;
    const WAKES_AT_ONCE: bool = true;

    fn handle(&mut self, event: Event<Input>, desk: &mut Desk) {
        match event {
            Event::Reset => self.app.reset(),
            Event::SaveProfile => self.save_profile(),
            Event::Change(change) => self.apply(change),
            Event::Message(input, raw) => self.hear(input, &raw, desk),
        }
    }

    fn wait_for_odometry(&self, stamp: Stamp) -> Option<Duration> {
        self.app.wait_for_odometry(stamp)
    }

    /// A map is the better for every scan: it may wait for as long as one is held back for its odometry.
    fn patience_in_line(&self) -> Duration {
        if self.map.is_some() { self.app.patience() } else { Duration::ZERO }
    }

    fn answer(&mut self, scan: &Sensed, arrival: Duration, desk: &mut Desk) {
        desk.urgency.set(self.app.contract().time_budget.is_some());
        self.app.set_keep_matched_points(self.publishers.wants_matched_points());
        let (publishers, map) = (&mut self.publishers, &mut self.map);
        let mut answered = self.app.answer(scan, arrival, |app, estimate| {
            if let Some(map) = map {
                map.place(estimate);
            }
            publishers.publish_pose(&Outgoing { estimate, number: number(app), frames: &app.config().frames });
        });
        let (app, estimate) = answered.parts();
        desk.interrupts.publish(estimate);
        desk.urgency.set(false);
        let_writers_go_first();
        let (now, answer) = (desk.clock.now(), Outgoing { estimate, number: number(app), frames: &app.config().frames });
        publishers.publish_details(&answer, app.odometry_counters(), desk.mailbox.dropped().scans);
        publishers.publish_display(&answer, app.matched_points(), now);
        let_writers_go_first();
        if let Some(map) = map {
            map.send(scan, estimate, app);
        }
        let estimate = answered.maintain(&NextScan(&desk.mailbox));
        desk.tell(self.app.take_remarks());
        self.watch(&estimate, desk);
    }

    fn end(&mut self, desk: &Desk) {
        if let Err(error) = self.app.store_costs() {
            desk.log.warn(&error.to_string());
        }
    }
}

/// The number of the answer that is being given. Those of headers wrap around.
#[allow(clippy::cast_possible_truncation)]
fn number(app: &App) -> u32 {
    app.counters().scans as u32
}
