//! The algorithm of the particle filter node: it passes messages to the filter and publishes its estimates.

use std::sync::Arc;
use std::time::Duration;

use super::convert::LocalizedPose;
use super::publishers::Publishers;
use crate::anytime::interrupt::Interrupt;
use crate::app::localizer::{Fix, Localizer, LocalizerError};
use crate::app::map_message::{self, MapMessageError};
use crate::app::sensed::SensorMessage;
use crate::app::{InputError, ScanProcessor as _};
use crate::config::Config;
use crate::geometry::PoseCovariance;
use crate::localization::estimate::Belief;
use crate::map::grid::OccupancyGrid;
use crate::messages::nav_msgs;
use crate::messages::own::Contract;
use crate::messages::std_msgs::Header;
use crate::messages::tf2_msgs::TFMessage;
use crate::ros::context::{Context, Shared};
use crate::ros::diagnostics::Sample;
use crate::ros::input::Input;
use crate::ros::mailbox::{NextScan, Request};
use crate::ros::priority::yield_to_writers;
use crate::ros::sink::RawMessage;
use crate::ros::transform_output::ConflictingPublisher;
use crate::ros::worker::Algorithm;
use crate::transforms::TransformTree;

/// Time after which another publisher of the same transform is regarded as permanent, and this node yields to it.
const CONFLICT_TIMEOUT: Duration = Duration::from_secs(2);

/// There is no map.
const NO_MAP: &str = "there is no map yet: set the parameter localization/map, or publish a map on the topic map";
/// The pose of the robot is unknown.
const NOT_LOCALIZED: &str = "the robot is not localized";

/// Everything that the localization thread owns.
pub(super) struct FilterNode {
    config: Config,
    /// The map from a file, until the thread starts.
    file_map: Option<OccupancyGrid>,
    /// The localizer, once there is a map.
    localizer: Option<Localizer>,
    /// Transforms that arrived before the map.
    transforms: TransformTree,
    /// Contract that arrived before the map, and its sender.
    contract: Option<(Contract, String)>,
    /// Covariance of the last pose.
    covariance: PoseCovariance,
    publishers: Publishers,
    /// First and latest time at which another node published the transform to the odometry frame.
    other: Option<(Duration, Duration)>,
}

impl FilterNode {
    /// `file_map`: the map to start with, if there is one.
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

    /// The topics it subscribes to: point clouds or scans, and others. Messages that need the map are ignored before there is
    /// one.
    pub(super) fn inputs(are_clouds: bool) -> Vec<Input<Self>> {
        vec![
            Input::scans(are_clouds),
            Input::interrupts(),
            Input::of("odom", |node: &mut Self, message| node.with_map(|localizer| localizer.on_odometry(message))),
            Input::with_context("map", Self::on_map),
            Input::with_context("initialpose", |node: &mut Self, message, raw, _| {
                node.with_map(|localizer| localizer.on_initial_pose(message, raw.arrival))
            }),
            Input::of("clicked_point", |node: &mut Self, message| node.with_map(|localizer| localizer.on_clicked_point(message))),
            Input::with_context("icp_contract", Self::on_contract),
            Input::with_context("/tf", Self::on_transforms),
            Input::with_context("/tf_static", Self::on_transforms),
        ]
    }

    /// Passes a message to the localizer, or ignores it if there is no map yet.
    fn with_map(&mut self, take: impl FnOnce(&mut Localizer) -> Result<(), InputError>) -> Result<(), InputError> {
        self.localizer.as_mut().map_or(Ok(()), take)
    }

    fn on_map(
        &mut self,
        message: &nav_msgs::OccupancyGrid,
        _: &RawMessage,
        context: &mut Context,
    ) -> Result<(), MapMessageError> {
        self.set_map(map_message::grid(message)?, context);
        Ok(())
    }

    fn on_contract(&mut self, contract: &Contract, raw: &RawMessage, _: &mut Context) -> Result<(), InputError> {
        if self.localizer.is_none() {
            self.contract = Some((contract.clone(), raw.sender.clone()));
        }
        self.with_map(|localizer| localizer.on_contract(contract))
    }

    fn on_transforms(&mut self, message: &TFMessage, raw: &RawMessage, context: &mut Context) -> Result<(), InputError> {
        self.check_conflicts(message, &raw.sender, &context.shared);
        if self.localizer.is_none() {
            self.transforms.add(message);
        }
        self.with_map(|localizer| localizer.on_transforms(message))
    }

    /// Sets the map. A repeated map, such as a latched one, changes nothing.
    fn set_map(&mut self, map: OccupancyGrid, context: &mut Context) {
        if self.localizer.as_ref().is_some_and(|localizer| *localizer.filter().map() == map) {
            return;
        }
        let size = format!("{} x {} cells of {} m", map.width(), map.height(), map.resolution());
        let outcome = match &mut self.localizer {
            Some(localizer) => localizer.replace_map(map),
            None => self.start_on(map, context),
        };
        match outcome {
            Ok(()) => {
                context.shared.monitor.set_condition(NO_MAP, false);
                context.shared.log.info(&format!("using a map of {size}"));
            }
            Err(error) => context.shared.log.error(&format!("the map of {size} is rejected: {error}")),
        }
    }

    fn start_on(&mut self, map: OccupancyGrid, context: &mut Context) -> Result<(), LocalizerError> {
        let mut localizer = Localizer::new(map, &self.config, Arc::clone(&context.shared.clock))?;
        localizer.set_interrupt(Arc::clone(&context.shared.interrupts) as Arc<dyn Interrupt>);
        localizer.warm_up();
        localizer.set_transforms(std::mem::take(&mut self.transforms));
        if let Some((contract, sender)) = self.contract.take()
            && let Err(problem) = localizer.on_contract(&contract)
        {
            context.reader.reject("icp_contract", &sender, &problem);
        }
        self.localizer = Some(localizer);
        Ok(())
    }

    /// Yields to another publisher of the transform if it continues in spite of this node. A scan matcher would yield itself.
    fn check_conflicts(&mut self, message: &TFMessage, sender: &str, shared: &Shared) {
        let odom_frame = &self.config.frames.odom_frame;
        let Some(other) = ConflictingPublisher::find(message, sender, odom_frame) else { return };
        let now = shared.clock.now();
        let is_recent = |time: Duration| now.saturating_sub(time) <= CONFLICT_TIMEOUT;
        let since = self.other.filter(|(_, last)| is_recent(*last)).map_or(now, |(since, _)| since);
        self.other = Some((since, now));
        if !is_recent(since) {
            self.publishers.transform().yield_to(&other, odom_frame, shared);
        }
    }

    /// Logs problems, and updates the diagnostics.
    fn monitor(&self, fix: &Fix, context: &mut Context) {
        if let Some(localizer) = &self.localizer {
            context.log_mount(localizer.mount());
        }
        context.shared.monitor.set_condition(NOT_LOCALIZED, !fix.belief.as_ref().is_ok_and(Belief::is_localized));
        let problem = fix.belief.as_ref().err().map(ToString::to_string);
        if let Some(problem) = &problem {
            context.reader.warn("scan", &format!("not used: {problem}"));
        }
        context.shared.monitor.record(Sample { elapsed: fix.elapsed, overrun: fix.overrun(), problem });
    }
}

impl Algorithm for FilterNode {
    // A scan should be processed with the odometry of the same time, which arrives on another connection.
    const REAL_TIME_WAKEUP: bool = false;

    fn begin(&mut self, context: &mut Context) {
        context.log_priority();
        context.shared.monitor.set_condition(NO_MAP, true);
        if let Some(map) = self.file_map.take() {
            self.set_map(map, context);
        }
    }

    fn request(&mut self, request: Request, context: &mut Context) {
        match (request, &mut self.localizer) {
            (Request::Reset, Some(localizer)) => localizer.start_globally(),
            (Request::Reset, None) => context.shared.log.warn(NO_MAP),
            (Request::SaveProfile | Request::Change(_), _) => {} // only for the scan matcher
        }
    }

    fn wait_for_inputs(&self, header: &Header) -> Option<Duration> {
        self.localizer.as_ref()?.wait_for_inputs(header)
    }

    fn answer(&mut self, scan: &SensorMessage, arrival: Duration, context: &mut Context) {
        let Some(localizer) = &mut self.localizer else { return context.reader.warn("scan", NO_MAP) };
        context.real_time.set(localizer.contract().time_budget.is_some());
        let (publishers, config, known) = (&mut self.publishers, &self.config, &mut self.covariance);
        let mut answered = localizer.answer(scan, arrival, |localizer, fix| {
            let Ok(Belief { map_from_base, covariance, .. }) = fix.belief else { return };
            *known = covariance;
            let localized = LocalizedPose { stamp: fix.stamp, map_from_base, covariance, twist: localizer.twist(), config };
            publishers.publish_pose(&localized, localizer.odom_from_base(fix.stamp), true);
        });
        context.real_time.set(false);
        yield_to_writers();
        let (_, fix) = answered.parts();
        publishers.publish_report(fix, context.shared.mailbox.dropped().scans, &config.frames.map_frame);
        yield_to_writers();
        let fix = answered.maintain(&NextScan(&context.shared.mailbox));
        if let Ok(belief) = &fix.belief {
            publishers.publish_display(localizer, scan, &belief.map_from_base);
        }
        context.log_remarks(localizer.take_warnings());
        self.monitor(&fix, context);
    }

    /// Between scans, publishes the last pose, moved by the odometry since then.
    fn on_timer(&mut self, _: &mut Context) {
        let Some(localizer) = &self.localizer else { return };
        let Some(stamp) = localizer.odometry_stamp() else { return };
        if let Some(map_from_base) = localizer.extrapolated_to(stamp) {
            let (covariance, twist) = (self.covariance, localizer.twist());
            let localized = LocalizedPose { stamp, map_from_base, covariance, twist, config: &self.config };
            self.publishers.publish_pose(&localized, None, false);
        }
    }
}
