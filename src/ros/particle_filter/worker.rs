//! The localizing thread: empties the mailbox, drives the filter and publishes what it believes.

use std::sync::Arc;
use std::time::Duration;

use super::convert::Placed;
use super::publishers::Publishers;
use super::subscriptions::Input;
use crate::anytime::clock::Clock;
use crate::anytime::interrupt::Request;
use crate::anytime::timer::Timer;
use crate::app::localizer::{Fix, Localizer};
use crate::app::sensed::Sensed;
use crate::app::{InputError, MountSource, map_message};
use crate::config::Config;
use crate::geometry::PoseCovariance;
use crate::localization::filter::Belief;
use crate::map::grid::OccupancyGrid;
use crate::messages::own::Contract;
use crate::messages::tf2_msgs::TFMessage;
use crate::messages::{Message, nav_msgs};
use crate::ros::diagnostics::{MOUNT_ASSUMED, Monitor, Sample, TRANSFORM_WITHHELD};
use crate::ros::inlet::Letter;
use crate::ros::log::Log;
use crate::ros::mailbox::{Event, Mailbox, NextScan, Work};
use crate::ros::priority::{Urgency, let_writers_go_first};
use crate::ros::reader::Reader;
use crate::ros::transform_output::Rival;
use crate::transforms::TransformTree;

/// Who publishes the same transform for longer than this does not give way to this node.
const PATIENCE_WITH_RIVAL: Duration = Duration::from_secs(2);

/// Conditions of this node.
const NO_MAP: &str = "there is no map yet (parameter localization/map, or topic map)";
const NOT_LOCALIZED: &str = "where the robot is, is not known";

/// Everything the localizing thread owns.
pub(super) struct Worker {
    config: Config,
    /// Once there is a map.
    localizer: Option<Localizer>,
    /// What came before it.
    transforms: TransformTree,
    contract: Option<Contract>,
    /// The newest scan, until an update is due.
    held: Option<Letter>,
    /// How sure the last pose was.
    covariance: PoseCovariance,
    publishers: Publishers,
    mailbox: Arc<Mailbox<Input>>,
    /// Somebody wants the answer to the scan that is being worked on.
    request: Arc<Request>,
    clock: Arc<dyn Clock>,
    monitor: Arc<Monitor>,
    log: Log,
    reader: Reader,
    /// Since when another node says where the odometry's frame is, and when it last did.
    rival: Option<(Duration, Duration)>,
}

impl Worker {
    pub(super) fn new(
        config: Config,
        publishers: Publishers,
        mailbox: Arc<Mailbox<Input>>,
        request: Arc<Request>,
        clock: Arc<dyn Clock>,
        monitor: Arc<Monitor>,
        log: Log,
    ) -> Self {
        monitor.set_condition(NO_MAP, true);
        let reader = Reader::new(&clock, &log).counting(&monitor);
        Self {
            config,
            localizer: None,
            transforms: TransformTree::default(),
            contract: None,
            held: None,
            covariance: PoseCovariance::zeros(),
            publishers,
            mailbox,
            request,
            clock,
            monitor,
            log,
            reader,
            rival: None,
        }
    }

    /// Works until the mailbox is closed; from the start on this map, if there is one already.
    pub(super) fn run(mut self, map: Option<OccupancyGrid>) {
        let mut urgency = Urgency::of_this_thread();
        urgency.set(false);
        if let Some(map) = map {
            self.set_map(map);
        }
        let mut timer = self.config.localization.timer(self.clock.now());
        while let Some(Work { events, scan }) = self.next_work(timer.as_ref()) {
            for event in events {
                self.handle(event);
            }
            if let Some(scan) = scan {
                let unused = self.held.replace(scan).is_some();
                self.mailbox.count_lost_scans(unused.into());
            }
            let now = self.clock.now();
            if timer.as_mut().is_none_or(|timer| timer.is_due(now)) {
                match self.held.take() {
                    // Where a timer calls for the update, the time counts from its call.
                    Some(letter) => self
                        .answer(&Letter { arrival: if timer.is_some() { now } else { letter.arrival }, ..letter }, &mut urgency),
                    None if timer.is_some() => self.carry_on(),
                    None => {}
                }
            }
        }
    }

    fn next_work(&self, timer: Option<&Timer>) -> Option<Work<Input>> {
        match timer {
            Some(timer) => self.mailbox.take_within(timer.left(self.clock.now())),
            None => self.mailbox.take(),
        }
    }

    /// A map that comes again, as a latched one does, changes nothing.
    fn set_map(&mut self, map: OccupancyGrid) {
        if self.localizer.as_ref().is_some_and(|localizer| *localizer.filter().map() == map) {
            return;
        }
        let size = format!("{} x {} cells of {} m", map.width(), map.height(), map.resolution());
        let outcome = match &mut self.localizer {
            Some(localizer) => localizer.replace_map(map),
            None => self.begin(map),
        };
        match outcome {
            Ok(()) => {
                self.monitor.set_condition(NO_MAP, false);
                self.log.info(&format!("has a map of {size}"));
            }
            Err(error) => self.log.error(&format!("the map of {size} is of no use: {error}")),
        }
    }

    fn begin(&mut self, map: OccupancyGrid) -> Result<(), crate::app::localizer::LocalizerError> {
        let mut localizer = Localizer::new(map, &self.config, Arc::clone(&self.clock))?;
        localizer.warm_up();
        localizer.set_transforms(std::mem::take(&mut self.transforms));
        if let Some(contract) = self.contract.take() {
            let outcome = localizer.on_contract(&contract);
            self.judge(Input::Contract, "before the map", outcome);
        }
        self.localizer = Some(localizer);
        Ok(())
    }

    fn handle(&mut self, event: Event<Input>) {
        match event {
            Event::Reset => match &mut self.localizer {
                Some(localizer) => localizer.spread(),
                None => self.log.warn(NO_MAP),
            },
            Event::Message(Input::Map, letter) => {
                if let Some(message) = self.reader.read::<nav_msgs::OccupancyGrid>(Input::Map.name(), &letter) {
                    match map_message::grid(&message) {
                        Ok(map) => self.set_map(map),
                        Err(error) => self.reader.refuse(Input::Map.name(), &letter.sender, &error),
                    }
                }
            }
            Event::Message(input, letter) => self.hear(input, &letter),
            Event::SaveProfile | Event::Change(_) => {} // the scan matcher's alone
        }
    }

    fn hear(&mut self, input: Input, letter: &Letter) {
        let sender = letter.sender.as_str();
        match input {
            Input::Scan | Input::Cloud | Input::Map | Input::Interrupt => {} // have their own ways
            Input::Odometry => self.tell(input, letter, |localizer, message| localizer.on_odometry(&message)),
            Input::InitialPose => {
                self.tell(input, letter, |localizer, message| localizer.on_initial_pose(&message, letter.arrival));
            }
            Input::ClickedPoint => self.tell(input, letter, |localizer, message| localizer.on_clicked_point(&message)),
            Input::Contract => match (self.reader.read::<Contract>(input.name(), letter), &mut self.localizer) {
                (Some(contract), Some(localizer)) => {
                    let outcome = localizer.on_contract(&contract);
                    self.judge(input, sender, outcome);
                }
                (contract, _) => self.contract = contract.or(self.contract.take()),
            },
            Input::Transforms | Input::StaticTransforms => {
                let Some(message) = self.reader.read::<TFMessage>(input.name(), letter) else { return };
                self.give_way(&message, sender);
                if let Some(localizer) = &mut self.localizer {
                    let outcome = localizer.on_transforms(&message);
                    self.judge(input, sender, outcome);
                } else {
                    self.transforms.add(&message);
                }
            }
        }
    }

    /// Hands a message on; before there is a map, nobody needs it.
    fn tell<T: Message>(
        &mut self,
        input: Input,
        letter: &Letter,
        take: impl FnOnce(&mut Localizer, T) -> Result<(), InputError>,
    ) {
        let Some(message) = self.reader.read(input.name(), letter) else { return };
        if let Some(localizer) = &mut self.localizer {
            let outcome = take(localizer, message);
            self.judge(input, &letter.sender, outcome);
        }
    }

    fn judge(&mut self, input: Input, sender: &str, outcome: Result<(), InputError>) {
        if let Err(error) = outcome {
            self.reader.refuse(input.name(), sender, &error);
        }
    }

    /// To who goes on in spite of this node; a scan matcher gives way itself.
    fn give_way(&mut self, message: &TFMessage, sender: &str) {
        let odom_frame = &self.config.frames.odom_frame;
        let Some(rival) = Rival::find(message, sender, odom_frame) else { return };
        let now = self.clock.now();
        let is_recent = |heard: Duration| now.saturating_sub(heard) <= PATIENCE_WITH_RIVAL;
        let since = self.rival.filter(|(_, last)| is_recent(*last)).map_or(now, |(since, _)| since);
        self.rival = Some((since, now));
        if !is_recent(since)
            && let Some(warning) = self.publishers.transform().give_way(&rival, odom_frame)
        {
            self.log.warn(&warning);
            self.monitor.set_condition(TRANSFORM_WITHHELD, true);
        }
    }

    /// Holds a scan back while the localizer wants to see more odometry first.
    fn await_odometry(&mut self, scan: &Sensed, letter: &Letter) {
        let wait = |worker: &Self| worker.localizer.as_ref()?.wait_for_odometry(scan.stamp());
        while let Some(longest) = wait(self) {
            let left = (letter.arrival + longest).saturating_sub(self.clock.now());
            let Some(events) = self.mailbox.events_for_held_scan(left, &*self.request) else { return };
            for event in events {
                self.handle(event);
            }
        }
    }

    fn read_sensed(&mut self, letter: &Letter) -> Option<Sensed> {
        if self.config.cloud.input {
            self.reader.read(Input::Cloud.name(), letter).map(Sensed::Cloud)
        } else {
            self.reader.read(Input::Scan.name(), letter).map(Sensed::Scan)
        }
    }

    fn answer(&mut self, letter: &Letter, urgency: &mut Urgency) {
        let Some(scan) = self.read_sensed(letter) else { return };
        if self.localizer.is_none() {
            return self.reader.warn("scan", NO_MAP);
        }
        self.request.clear();
        self.await_odometry(&scan, letter);
        let Some(localizer) = &mut self.localizer else { return };
        urgency.set(localizer.contract().time_budget.is_some());
        let mut fix = localizer.on_sensed(&scan, letter.arrival, &*self.request);
        if let Ok(belief) = &fix.belief {
            self.covariance = belief.covariance;
            let placed = Placed {
                stamp: fix.stamp,
                map_from_base: belief.map_from_base,
                covariance: belief.covariance,
                twist: localizer.twist(),
                config: &self.config,
            };
            self.publishers.publish_pose(&placed, localizer.odom_from_base(fix.stamp), true);
        }
        localizer.conclude(&mut fix);
        urgency.set(false);
        let_writers_go_first();
        self.publishers.publish_report(&fix, self.mailbox.dropped().scans, &self.config.frames.map_frame);
        let_writers_go_first();
        localizer.maintain(&NextScan(&self.mailbox));
        if let Ok(belief) = &fix.belief {
            self.publishers.publish_display(localizer, &scan, &belief.map_from_base);
        }
        let mount_assumed = localizer.mount().1 == MountSource::Assumed;
        for remark in localizer.take_remarks() {
            self.log.warn(&format!("scan: {remark}"));
        }
        self.watch(&fix, mount_assumed);
    }

    fn watch(&mut self, fix: &Fix, mount_assumed: bool) {
        self.monitor.set_condition(MOUNT_ASSUMED, mount_assumed);
        self.monitor.set_condition(NOT_LOCALIZED, !fix.belief.as_ref().is_ok_and(Belief::is_localized));
        let problem = fix.belief.as_ref().err().map(ToString::to_string);
        if let Some(problem) = &problem {
            self.reader.warn("scan", &format!("not used: {problem}"));
        }
        self.monitor.record(Sample { elapsed: fix.elapsed, overrun: fix.overrun(), problem });
    }

    /// Between scans: the last pose, moved on by the odometry that has come since.
    fn carry_on(&mut self) {
        let Some(localizer) = &self.localizer else { return };
        let Some(stamp) = localizer.odometry_stamp() else { return };
        if let Some(map_from_base) = localizer.carried_to(stamp) {
            let (covariance, twist) = (self.covariance, localizer.twist());
            let placed = Placed { stamp, map_from_base, covariance, twist, config: &self.config };
            self.publishers.publish_pose(&placed, None, false);
        }
    }
}
