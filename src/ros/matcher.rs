//! The matching thread: empties the mailbox, drives the application and publishes its answers.

use std::sync::Arc;
use std::sync::mpsc::Sender;
use std::time::Duration;

use super::convert::Answer;
use super::diagnostics::{IMU_DISBELIEVED, MOUNT_ASSUMED, Monitor, ODOMETRY_DISBELIEVED, OUTSIDE_PROFILE, TRANSFORM_WITHHELD};
use super::inlet::Letter;
use super::interrupts::Interrupts;
use super::live_params::MatchingChange;
use super::log::Log;
use super::mailbox::{Event, Mailbox, NextScan, Work};
use super::priority::{Urgency, let_writers_go_first};
use super::publishers::Publishers;
use super::reader::Reader;
use super::services::Reply;
use super::subscriptions::Input;
use super::transform_output::Rival;
use crate::anytime::clock::Clock;
use crate::app::sensed::Sensed;
use crate::app::{App, Estimate, MountSource};
use crate::config::FrameKnobs;
use crate::messages::geometry_msgs::TwistStamped;
use crate::messages::tf2_msgs::TFMessage;
use crate::odometry::Outcome;
use crate::time::Stamp;

/// Transforms may come a little later than the first scans do.
const PATIENCE_FOR_MOUNT: Duration = Duration::from_secs(2);

/// What the matching thread shares with the rest of the node.
pub(super) struct Shared {
    pub(super) mailbox: Arc<Mailbox>,
    pub(super) interrupts: Arc<Interrupts>,
    pub(super) clock: Arc<dyn Clock>,
    pub(super) monitor: Arc<Monitor>,
    /// Takes what came of calls of services.
    pub(super) replies: Sender<Reply>,
    pub(super) log: Log,
}

/// Everything the matching thread owns.
pub(super) struct Matcher {
    app: App,
    publishers: Publishers,
    mailbox: Arc<Mailbox>,
    interrupts: Arc<Interrupts>,
    clock: Arc<dyn Clock>,
    monitor: Arc<Monitor>,
    replies: Sender<Reply>,
    log: Log,
    reader: Reader,
    mount_told: Option<MountSource>,
    first_answer: Option<Duration>,
}

impl Matcher {
    /// `shared`: what it shares with the rest of the node.
    pub(super) fn new(app: App, publishers: Publishers, shared: Shared) -> Self {
        let Shared { mailbox, interrupts, clock, monitor, replies, log } = shared;
        let reader = Reader::new(&clock, &log).counting(&monitor);
        Self { app, publishers, mailbox, interrupts, clock, monitor, replies, log, reader, mount_told: None, first_answer: None }
    }

    /// Works until the mailbox is closed.
    pub(super) fn run(mut self) {
        let mut urgency = Urgency::of_this_thread();
        if !urgency.is_permitted() {
            self.log
                .info("real-time priority is not permitted (CAP_SYS_NICE, or ulimit -r): busy programs can make answers late");
        }
        while let Some(Work { events, scan }) = self.mailbox.take() {
            for event in events {
                self.handle(event);
            }
            if let Some(letter) = scan {
                self.interrupts.begin();
                match self.read_sensed(&letter) {
                    Some(sensed) => {
                        self.await_odometry(sensed.stamp(), letter.arrival);
                        self.answer(&sensed, letter.arrival, &mut urgency);
                    }
                    None => self.interrupts.abandon(),
                }
            }
            urgency.set(true); // the next scan is to wake this thread at once
        }
        if let Err(error) = self.app.store_costs() {
            self.log.warn(&error.to_string());
        }
    }

    fn read_sensed(&mut self, letter: &Letter) -> Option<Sensed> {
        if self.app.config().cloud.input {
            self.reader.read(Input::Cloud.name(), letter).map(Sensed::Cloud)
        } else {
            self.reader.read(Input::Scan.name(), letter).map(Sensed::Scan)
        }
    }

    /// Holds a scan back while the application wants to see more odometry first.
    fn await_odometry(&mut self, stamp: Stamp, arrival: Duration) {
        while let Some(longest) = self.app.wait_for_odometry(stamp) {
            let left = (arrival + longest).saturating_sub(self.clock.now());
            let Some(events) = self.mailbox.events_for_held_scan(left, &*self.interrupts) else { return };
            for event in events {
                self.handle(event);
            }
        }
    }

    fn handle(&mut self, event: Event) {
        let (input, letter) = match event {
            Event::Reset => return self.app.reset(),
            Event::SaveProfile => return self.save_profile(),
            Event::Change(change) => return self.apply(change),
            Event::Message(input, letter) => (input, letter),
        };
        let topic = input.name();
        let outcome = match input {
            Input::Scan | Input::Cloud | Input::Interrupt => Ok(()), // no events
            Input::Odometry => self.reader.read(topic, &letter).map_or(Ok(()), |message| self.app.on_odometry(&message)),
            Input::Imu => self.reader.read(topic, &letter).map_or(Ok(()), |message| self.app.on_imu(&message)),
            Input::Velocity => self.reader.read(topic, &letter).map_or(Ok(()), |message| self.app.on_velocity(&message)),
            Input::StampedVelocity => {
                self.reader.read::<TwistStamped>(topic, &letter).map_or(Ok(()), |message| self.app.on_velocity(&message.twist))
            }
            Input::InitialPose => {
                let app = &mut self.app;
                self.reader.read(topic, &letter).map_or(Ok(()), |message| app.on_initial_pose(&message, letter.arrival))
            }
            Input::Contract => self.reader.read(topic, &letter).map_or(Ok(()), |message| self.app.on_contract(&message)),
            Input::Transforms | Input::StaticTransforms => self.reader.read(topic, &letter).map_or(Ok(()), |message| {
                let outcome = self.app.on_transforms(&message);
                self.give_way(&message, &letter.sender);
                outcome
            }),
        };
        if let Err(error) = outcome {
            self.reader.refuse(topic, &letter.sender, &error);
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
        let _ = self.replies.send(outcome); // nobody waits any more when the node is ending
    }

    fn apply(&mut self, change: MatchingChange) {
        match change {
            MatchingChange::Limit(limit) => self.app.set_contract(limit.applied_to(self.app.contract())),
            MatchingChange::MaxIterations(limit) => self.app.set_max_iterations(limit),
        }
    }

    fn give_way(&self, message: &TFMessage, sender: &str) {
        let FrameKnobs { odom_frame, base_frame, .. } = &self.app.config().frames;
        for child in [base_frame, odom_frame] {
            if let Some(rival) = Rival::find(message, sender, child) {
                self.withhold(&rival, child);
            }
        }
        // Another odometry in our frame, however many transforms it takes to the base: then it is not ours to say where that frame is.
        if self.app.transforms().carries(odom_frame, base_frame) {
            self.withhold(&Rival::new(sender, odom_frame, base_frame), odom_frame);
        }
    }

    fn withhold(&self, rival: &Rival, child: &str) {
        if let Some(warning) = self.publishers.transform().give_way(rival, child) {
            self.log.warn(&warning);
            self.monitor.set_condition(TRANSFORM_WITHHELD, true);
        }
    }

    fn answer(&mut self, sensed: &Sensed, arrival: Duration, urgency: &mut Urgency) {
        urgency.set(self.app.contract().time_budget.is_some());
        self.app.set_keep_matched_points(self.publishers.wants_matched_points());
        let mut estimate = self.app.on_sensed(sensed, arrival);
        let number = self.publish_pose(&mut estimate);
        urgency.set(false);
        let_writers_go_first();
        self.publish_details(&estimate, number);
        let_writers_go_first();
        self.app.maintain(&NextScan(&self.mailbox));
        if let Outcome::Predicted(problem) = &estimate.registration.outcome {
            self.reader.warn("scan", &format!("no match, the pose is the prediction: {problem}"));
        }
        let disbelieved = estimate.registration.disbelieved;
        self.monitor.set_condition(ODOMETRY_DISBELIEVED, disbelieved.odometry);
        self.monitor.set_condition(IMU_DISBELIEVED, disbelieved.imu);
        self.monitor.set_condition(OUTSIDE_PROFILE, estimate.outside_profile.is_some());
        self.watch_mount();
        for remark in self.app.take_remarks() {
            self.log.warn(&format!("scan: {remark}"));
        }
        self.monitor.record((&estimate).into());
    }

    /// What the answer is wanted for, and the time it took. Its number.
    fn publish_pose(&mut self, estimate: &mut Estimate) -> u32 {
        // Numbers of headers wrap around.
        #[allow(clippy::cast_possible_truncation)]
        let number = self.app.counters().scans as u32;
        let frames = &self.app.config().frames;
        self.publishers.publish_pose(&Answer { estimate, number, frames });
        self.app.conclude(estimate);
        self.interrupts.publish(estimate);
        number
    }

    fn publish_details(&mut self, estimate: &Estimate, number: u32) {
        let (now, frames) = (self.clock.now(), &self.app.config().frames);
        let answer = Answer { estimate, number, frames };
        self.publishers.publish_details(&answer, self.app.odometry_counters(), self.mailbox.dropped().scans);
        self.publishers.publish_display(&answer, self.app.matched_points(), now);
    }

    /// Says once where the laser's place is known from, or that it is not.
    fn watch_mount(&mut self) {
        let now = self.clock.now();
        let waited = now.saturating_sub(*self.first_answer.get_or_insert(now));
        let (mount, source) = self.app.mount();
        if self.mount_told == Some(source) || (source == MountSource::Assumed && waited < PATIENCE_FOR_MOUNT) {
            return;
        }
        self.mount_told = Some(source);
        self.monitor.set_condition(MOUNT_ASSUMED, source == MountSource::Assumed);
        let place = mount.base_from_laser;
        let head = if mount.upside_down { ", upside down" } else { "" };
        let text = format!("[{:.3} m, {:.3} m, {:.3} rad]{head}", place.x, place.y, place.theta);
        match source {
            MountSource::Parameter => self.log.info(&format!("the laser's place on the base is {text}, by odometry.laser_in_base")),
            MountSource::Transforms => self.log.info(&format!("the laser's place on the base is {text}, by tf")),
            MountSource::Assumed => self.log.warn(
                "the laser's place on the base is not known and taken to be the base's origin: set the parameter \
                 odometry.laser_in_base to [x, y, yaw], or publish the transform from the base frame to the laser's on /tf_static",
            ),
        }
    }
}
