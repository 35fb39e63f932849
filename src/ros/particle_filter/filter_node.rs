//! The particle filter's work: drives the filter and publishes what it believes.

use std::sync::Arc;
use std::time::Duration;

use super::convert::Placed;
use super::input::Input;
use super::publishers::Publishers;
use crate::anytime::interrupt::Interrupt;
use crate::app::localizer::{Fix, Localizer, LocalizerError};
use crate::app::sensed::Sensed;
use crate::app::{Answering as _, InputError, map_message};
use crate::config::Config;
use crate::geometry::PoseCovariance;
use crate::localization::estimate::Belief;
use crate::map::grid::OccupancyGrid;
use crate::messages::own::Contract;
use crate::messages::tf2_msgs::TFMessage;
use crate::messages::{Message, nav_msgs};
use crate::ros::diagnostics::{Sample, TRANSFORM_WITHHELD};
use crate::ros::mailbox::{Event, NextScan};
use crate::ros::priority::let_writers_go_first;
use crate::ros::sink::RawMessage;
use crate::ros::transform_output::ConflictingPublisher;
use crate::ros::worker::{self, Estimator, NodeInput as _};
use crate::time::Stamp;
use crate::transforms::TransformTree;

type Desk = worker::Desk<Input>;

/// Who publishes the same transform for longer than this does not give way to this node.
const CONFLICT_TIMEOUT: Duration = Duration::from_secs(2);

/// Conditions of this node.
const NO_MAP: &str = "there is no map yet (parameter localization/map, or topic map)";
const NOT_LOCALIZED: &str = "where the robot is, is not known";

/// Everything the localizing thread owns.
pub(super) struct FilterNode {
    config: Config,
    /// The map of a file, until the work begins.
    file_map: Option<OccupancyGrid>,
    /// Once there is a map.
    localizer: Option<Localizer>,
    /// What came before it.
    transforms: TransformTree,
    contract: Option<Contract>,
    /// How sure the last pose was.
    covariance: PoseCovariance,
    publishers: Publishers,
    /// Since when another node says where the odometry's frame is, and when it last did.
    other: Option<(Duration, Duration)>,
}

impl FilterNode {
    /// From the start on `file_map`, if there is one.
    pub(super) fn new(config: Config, publishers: Publishers, file_map: Option<OccupancyGrid>) -> Self {
        Self {
            config,
            file_map,
            localizer: None,
            transforms: TransformTree::default(),
            contract: None,
            covariance: PoseCovariance::zeros(),
            publishers,
            other: None,
        }
    }

    /// A map that comes again, as a latched one does, changes nothing.
    fn set_map(&mut self, map: OccupancyGrid, desk: &mut Desk) {
        if self.localizer.as_ref().is_some_and(|localizer| *localizer.filter().map() == map) {
            return;
        }
        let size = format!("{} x {} cells of {} m", map.width(), map.height(), map.resolution());
        let outcome = match &mut self.localizer {
            Some(localizer) => localizer.replace_map(map),
            None => self.begin_on(map, desk),
        };
        match outcome {
            Ok(()) => {
                desk.monitor.set_condition(NO_MAP, false);
                desk.log.info(&format!("has a map of {size}"));
            }
            Err(error) => desk.log.error(&format!("the map of {size} is unusable: {error}")),
        }
    }

    fn begin_on(&mut self, map: OccupancyGrid, desk: &mut Desk) -> Result<(), LocalizerError> {
        let mut localizer = Localizer::new(map, &self.config, Arc::clone(&desk.clock))?;
        localizer.set_interrupt(Arc::clone(&desk.interrupts) as Arc<dyn Interrupt>);
        localizer.warm_up();
        localizer.set_transforms(std::mem::take(&mut self.transforms));
        if let Some(contract) = self.contract.take() {
            let outcome = localizer.on_contract(&contract);
            judge(Input::Contract, "before the map", outcome, desk);
        }
        self.localizer = Some(localizer);
        Ok(())
    }

    fn hear(&mut self, input: Input, raw: &RawMessage, desk: &mut Desk) {
        let sender = raw.sender.as_str();
        match input {
            Input::Scan | Input::Cloud | Input::Map | Input::Interrupt => {} // have their own ways
            Input::Odometry => self.tell(input, raw, desk, |localizer, message| localizer.on_odometry(&message)),
            Input::InitialPose => {
                self.tell(input, raw, desk, |localizer, message| localizer.on_initial_pose(&message, raw.arrival));
            }
            Input::ClickedPoint => self.tell(input, raw, desk, |localizer, message| localizer.on_clicked_point(&message)),
            Input::Contract => match (desk.reader.read::<Contract>(input.name(), raw), &mut self.localizer) {
                (Some(contract), Some(localizer)) => {
                    let outcome = localizer.on_contract(&contract);
                    judge(input, sender, outcome, desk);
                }
                (contract, _) => self.contract = contract.or(self.contract.take()),
            },
            Input::Transforms | Input::StaticTransforms => {
                let Some(message) = desk.reader.read::<TFMessage>(input.name(), raw) else { return };
                self.give_way(&message, sender, desk);
                if let Some(localizer) = &mut self.localizer {
                    let outcome = localizer.on_transforms(&message);
                    judge(input, sender, outcome, desk);
                } else {
                    self.transforms.add(&message);
                }
            }
        }
    }

    /// Hands a message on; before there is a map it is not needed.
    fn tell<T: Message>(
        &mut self,
        input: Input,
        raw: &RawMessage,
        desk: &mut Desk,
        take: impl FnOnce(&mut Localizer, T) -> Result<(), InputError>,
    ) {
        let Some(message) = desk.reader.read(input.name(), raw) else { return };
        if let Some(localizer) = &mut self.localizer {
            let outcome = take(localizer, message);
            judge(input, &raw.sender, outcome, desk);
        }
    }

    /// To who goes on in spite of this node; a scan matcher gives way itself.
    fn give_way(&mut self, message: &TFMessage, sender: &str, desk: &Desk) {
        let odom_frame = &self.config.frames.odom_frame;
        let Some(other) = ConflictingPublisher::find(message, sender, odom_frame) else { return };
        let now = desk.clock.now();
        let is_recent = |heard: Duration| now.saturating_sub(heard) <= CONFLICT_TIMEOUT;
        let since = self.other.filter(|(_, last)| is_recent(*last)).map_or(now, |(since, _)| since);
        self.other = Some((since, now));
        if !is_recent(since)
            && let Some(warning) = self.publishers.transform().give_way(&other, odom_frame)
        {
            desk.log.warn(&warning);
            desk.monitor.set_condition(TRANSFORM_WITHHELD, true);
        }
    }

    fn watch(&self, fix: &Fix, desk: &mut Desk) {
        if let Some(localizer) = &self.localizer {
            desk.watch_mount(localizer.mount());
        }
        desk.monitor.set_condition(NOT_LOCALIZED, !fix.belief.as_ref().is_ok_and(Belief::is_localized));
        let problem = fix.belief.as_ref().err().map(ToString::to_string);
        if let Some(problem) = &problem {
            desk.reader.warn("scan", &format!("not used: {problem}"));
        }
        desk.monitor.record(Sample { elapsed: fix.elapsed, overrun: fix.overrun(), problem });
    }
}

impl Estimator for FilterNode {
    type Input = Input;
    // A scan is of most use with the odometry of its time, which comes on another connection.
    const WAKES_AT_ONCE: bool = false;

    fn begin(&mut self, desk: &mut Desk) {
        desk.monitor.set_condition(NO_MAP, true);
        if let Some(map) = self.file_map.take() {
            self.set_map(map, desk);
        }
    }

    fn handle(&mut self, event: Event<Input>, desk: &mut Desk) {
        match event {
            Event::Reset => match &mut self.localizer {
                Some(localizer) => localizer.spread(),
                None => desk.log.warn(NO_MAP),
            },
            Event::Message(Input::Map, raw) => {
                if let Some(message) = desk.reader.read::<nav_msgs::OccupancyGrid>(Input::Map.name(), &raw) {
                    match map_message::grid(&message) {
                        Ok(map) => self.set_map(map, desk),
                        Err(error) => desk.reader.refuse(Input::Map.name(), &raw.sender, &error),
                    }
                }
            }
            Event::Message(input, raw) => self.hear(input, &raw, desk),
            Event::SaveProfile | Event::Change(_) => {} // the scan matcher's alone
        }
    }

    fn wait_for_odometry(&self, stamp: Stamp) -> Option<Duration> {
        self.localizer.as_ref()?.wait_for_odometry(stamp)
    }

    fn answer(&mut self, scan: &Sensed, arrival: Duration, desk: &mut Desk) {
        let Some(localizer) = &mut self.localizer else { return desk.reader.warn("scan", NO_MAP) };
        desk.urgency.set(localizer.contract().time_budget.is_some());
        let (publishers, config, known) = (&mut self.publishers, &self.config, &mut self.covariance);
        let mut answered = localizer.answer(scan, arrival, |localizer, fix| {
            let Ok(Belief { map_from_base, covariance, .. }) = fix.belief else { return };
            *known = covariance;
            let placed = Placed { stamp: fix.stamp, map_from_base, covariance, twist: localizer.twist(), config };
            publishers.publish_pose(&placed, localizer.odom_from_base(fix.stamp), true);
        });
        desk.urgency.set(false);
        let_writers_go_first();
        let (_, fix) = answered.parts();
        publishers.publish_report(fix, desk.mailbox.dropped().scans, &config.frames.map_frame);
        let_writers_go_first();
        let fix = answered.maintain(&NextScan(&desk.mailbox));
        if let Ok(belief) = &fix.belief {
            publishers.publish_display(localizer, scan, &belief.map_from_base);
        }
        desk.tell(localizer.take_remarks());
        self.watch(&fix, desk);
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

fn judge(input: Input, sender: &str, outcome: Result<(), InputError>, desk: &mut Desk) {
    if let Err(error) = outcome {
        desk.reader.refuse(input.name(), sender, &error);
    }
}
