//! Replays a bag through the same application that the node runs.

mod ahead;
pub mod failures;
pub mod localize;
pub mod map_picture;
pub mod map_sketch;
pub mod map_summary;
pub mod recorder;
pub mod row;
pub mod summary;
pub mod survey;
pub mod truth;

use std::fmt;
use std::time::Duration;

use self::ahead::EarlyTopic;
use crate::anytime::clock::Clock;
use crate::anytime::interrupt::NeverInterrupt;
use crate::app::sensed::SensorMessage;
use crate::app::{App, Estimate, ScanProcessor};
use crate::evaluation::trajectory::StampedPose;
use crate::io::bag::{Bag, BagError, BagMessage};
use crate::io::contract_schedule::ContractSchedule;
use crate::messages::nav_msgs::Odometry;
use crate::messages::sensor_msgs::{Imu, LaserScan, PointCloud2};
use crate::messages::std_msgs::Header;
use crate::messages::tf2_msgs::TFMessage;
use crate::messages::{self, Message};
use crate::quantile;
use crate::time::Stamp;

/// Topics of transforms.
const TRANSFORM_TOPICS: [&str; 2] = ["/tf", "/tf_static"];

/// The topics to replay.
#[derive(Clone, Debug)]
pub struct Topics {
    /// Topic of laser scans or point clouds.
    pub scan: String,
    /// Topic of wheel odometry; `None` to use none.
    pub odometry: Option<String>,
    /// Topic of an IMU; `None` to use none.
    pub imu: Option<String>,
    /// How far ahead of all other messages the odometry is read. Zero means as recorded, which is what a robot has.
    pub odometry_ahead: Duration,
}

impl Topics {
    /// Checks that the bag has the requested topics. If no odometry topic is requested, uses `/odom` if the bag has it.
    pub fn resolve(bag: &Bag, scan: &str, odometry: Option<&str>) -> Result<Self, BagError> {
        expect_scans(bag, scan)?;
        Ok(Self {
            scan: scan.into(),
            odometry: optional::<Odometry>(bag, odometry, "/odom")?,
            imu: None,
            odometry_ahead: Duration::ZERO,
        })
    }

    /// Adds the requested IMU topic. If none is requested, adds `/imu/data` if the bag has it.
    pub fn with_imu(self, bag: &Bag, imu: Option<&str>) -> Result<Self, BagError> {
        Ok(Self { imu: optional::<Imu>(bag, imu, "/imu/data")?, ..self })
    }

    /// Keeps only the topic of the scans.
    #[must_use]
    pub fn scan_only(self) -> Self {
        Self { odometry: None, imu: None, ..self }
    }

    /// All topics to read.
    pub fn all(&self) -> Vec<&str> {
        let optional = self.odometry.as_deref().into_iter().chain(self.imu.as_deref());
        [self.scan.as_str()].into_iter().chain(optional).chain(TRANSFORM_TOPICS).collect()
    }
}

/// Checks that a topic carries laser scans or point clouds.
fn expect_scans(bag: &Bag, topic: &str) -> Result<(), BagError> {
    let clouds = bag.topics_of::<PointCloud2>();
    if clouds.contains(&topic) {
        return Ok(());
    }
    bag.expect_topic::<LaserScan>(topic).map_err(|mut error| {
        if let (BagError::NoSuchTopic { alternatives, .. }, false) = (&mut error, clouds.is_empty()) {
            alternatives.extend(["; topics with ", PointCloud2::TYPE, ": ", &clouds.join(", ")]);
        }
        error
    })
}

/// Decodes a message as a laser scan or a point cloud.
fn decode_scan(message: &BagMessage) -> Result<SensorMessage, BagError> {
    if message.connection.carries::<LaserScan>() {
        message.decode().map(SensorMessage::Scan)
    } else if message.connection.carries::<PointCloud2>() {
        message.decode().map(SensorMessage::Cloud)
    } else {
        message.decode().map(SensorMessage::Scan) // gives an error that names the expected type
    }
}

/// The requested topic, which the bag must have. If none is requested, the default topic if the bag has it.
fn optional<T: Message>(bag: &Bag, requested: Option<&str>, default: &str) -> Result<Option<String>, BagError> {
    match requested {
        Some(topic) => bag.expect_topic::<T>(topic).map(|()| Some(topic.to_owned())),
        None => Ok(bag.topics_of::<T>().contains(&default).then(|| default.to_owned())),
    }
}

/// Input of a replay.
#[derive(Clone, Copy)]
pub struct Source<'a> {
    /// The bag.
    pub bag: &'a Bag,
    /// The topics to read.
    pub topics: &'a Topics,
    /// Contracts that replace that of the configuration over time.
    pub schedule: &'a ContractSchedule,
}

/// Problems during a replay.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ReplayLog {
    /// Messages that could not be read or used, grouped by reason; only the first [`Self::MAX_REASONS`] reasons.
    unusable: Vec<UnusableMessages>,
    /// Warnings about messages that were used.
    warnings: Vec<String>,
    /// Total number of messages that could not be read or used.
    pub unusable_messages: u64,
}

/// Messages that could not be used for the same reason.
#[derive(Clone, Debug, PartialEq, Eq)]
struct UnusableMessages {
    reason: String,
    /// Recording time of the first, if the reason does not include it.
    first: Option<Stamp>,
    count: u64,
}

impl fmt::Display for UnusableMessages {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { reason, first, count } = self;
        f.write_str(reason)?;
        match (count, first) {
            (1, None) => Ok(()),
            (1, Some(first)) => write!(f, " (at {first})"),
            (_, None) => write!(f, " ({count} messages)"),
            (_, Some(first)) => write!(f, " ({count} messages; the first at {first})"),
        }
    }
}

impl ReplayLog {
    /// Maximum number of reasons that are kept.
    const MAX_REASONS: usize = 10;

    /// Explains why a replay has no results: `unusable`, the reasons of unusable scans. If there are none, the unusable messages
    /// and the damage of the bag. Empty if the reason is unknown.
    pub fn reasons(&self, bag: &Bag, unusable: &[String]) -> String {
        let messages =
            self.unusable.first().map(|first| format!("{} unusable messages; the first: {first}", self.unusable_messages));
        let damage = bag.problems();
        let other_reasons = messages.into_iter().chain(damage.iter().map(ToString::to_string));
        let reasons: Vec<String> = if unusable.is_empty() { other_reasons.collect() } else { unusable.to_vec() };
        if reasons.is_empty() { String::new() } else { format!(": {}", reasons.join("; ")) }
    }

    /// Warnings for the user, as text: the reasons why messages could not be used, and warnings about the others.
    pub fn problems(&self) -> impl Iterator<Item = String> {
        self.unusable.iter().map(ToString::to_string).chain(self.warnings.iter().cloned())
    }

    /// Records a message that could not be used.
    fn add_unusable(&mut self, time: Option<Stamp>, reason: &str) {
        self.unusable_messages += 1;
        if let Some(known) = self.unusable.iter_mut().find(|known| known.reason == reason) {
            known.count += 1;
        } else if self.unusable.len() < Self::MAX_REASONS {
            self.unusable.push(UnusableMessages { reason: reason.into(), first: time, count: 1 });
        }
    }
}

/// Replays a bag. Calls `on_estimate` with each scan and its estimate, and `on_message` for every message read, to show progress.
/// An error of `on_estimate` ends the replay.
pub fn replay<E: From<BagError>>(
    source: &Source,
    app: &mut App,
    clock: &dyn Clock,
    on_message: impl FnMut(),
    mut on_estimate: impl FnMut(&SensorMessage, &Estimate, &mut App) -> Result<(), E>,
) -> Result<ReplayLog, E> {
    let mut first_stamp = None;
    feed(source.bag, source.topics, app, on_message, |message, app, log| {
        let arrival = clock.now();
        match decode_scan(message) {
            Ok(scan) => {
                let stamp = scan.stamp();
                let first_stamp = *first_stamp.get_or_insert(stamp);
                if let Some(contract) = source.schedule.at(stamp.seconds_since(first_stamp)) {
                    app.set_contract(contract);
                }
                let mut answered = app.answer(&scan, arrival, |_, _| ());
                let (app, estimate) = answered.parts();
                on_estimate(&scan, estimate, app)?;
                answered.maintain(&NeverInterrupt);
            }
            Err(error) => log.add_unusable(None, &error.to_string()),
        }
        Ok(())
    })
}

/// Passes the messages of a bag to `processor` in order, and the scans to `answer`: each scan once its odometry has arrived or
/// the wait for it has timed out.
fn feed<L: ScanProcessor, E>(
    bag: &Bag,
    topics: &Topics,
    processor: &mut L,
    mut on_message: impl FnMut(),
    mut answer: impl FnMut(&BagMessage, &mut L, &mut ReplayLog) -> Result<(), E>,
) -> Result<ReplayLog, E> {
    let mut log = ReplayLog::default();
    let mut held: Option<HeldScan> = None;
    let messages = bag.messages(Some(&topics.all()));
    for message in EarlyTopic::new(messages, topics.odometry.as_deref(), topics.odometry_ahead) {
        on_message();
        let message = match message {
            Ok(message) => message,
            Err(error) => {
                log.add_unusable(None, &error.to_string());
                continue;
            }
        };
        let is_scan = message.connection.topic == topics.scan;
        if let Some(scan) = held.take_if(|scan| is_scan || !scan.can_wait(processor, message.time)) {
            answer(&scan.message, processor, &mut log)?;
        }
        if is_scan {
            held = Some(HeldScan::new(message));
        } else if let Err(problem) = handle_message(processor, topics, &message) {
            log.add_unusable(Some(message.time), &problem);
        }
        if let Some(scan) = held.take_if(|scan| !scan.can_wait(processor, scan.message.time)) {
            answer(&scan.message, processor, &mut log)?;
        }
    }
    if let Some(scan) = held {
        answer(&scan.message, processor, &mut log)?;
    }
    log.warnings = processor.take_warnings();
    Ok(log)
}

/// A scan held back until its odometry and the pose of its laser have arrived, as in the node.
struct HeldScan<'bag> {
    message: BagMessage<'bag>,
    header: Header,
}

impl<'bag> HeldScan<'bag> {
    fn new(message: BagMessage<'bag>) -> Self {
        // Any header will do for a scan that cannot be decoded, because processing it gives an error.
        let header = messages::header(&message.data).unwrap_or_default();
        Self { message, header }
    }

    fn can_wait(&self, processor: &impl ScanProcessor, now: Stamp) -> bool {
        processor.wait_for_inputs(&self.header).is_some_and(|wait| now.seconds_since(self.message.time) < wait.as_secs_f64())
    }
}

/// Passes a message that is not a scan to the processor.
fn handle_message(processor: &mut impl ScanProcessor, topics: &Topics, message: &BagMessage) -> Result<(), String> {
    let topic = message.connection.topic.as_str();
    let with_topic = |problem: &dyn fmt::Display| format!("{topic}: {problem}");
    if topics.odometry.as_deref() == Some(topic) {
        let odometry = message.decode().map_err(|e| e.to_string())?;
        processor.on_odometry(&odometry).map_err(|e| with_topic(&e))
    } else if topics.imu.as_deref() == Some(topic) {
        let imu = message.decode().map_err(|e| e.to_string())?;
        processor.on_imu(&imu).map_err(|e| with_topic(&e))
    } else {
        let transforms: TFMessage = message.decode().map_err(|e| e.to_string())?;
        processor.on_transforms(&transforms).map_err(|e| with_topic(&e))
    }
}

/// Length of the path through these poses, m.
fn path_length(poses: &[StampedPose]) -> f64 {
    poses.windows(2).map(|pair| pair[0].pose.between(&pair[1].pose).distance()).sum()
}

/// The percentiles 50, 99 and 100 of these times, microseconds.
fn time_percentiles(times: &[Duration]) -> [f64; 3] {
    let mut sorted = times.to_vec();
    sorted.sort_unstable();
    [0.5, 0.99, 1.0].map(|fraction| quantile::of_sorted(&sorted, fraction).map_or(0.0, microseconds))
}

/// Converts a duration to microseconds.
pub(crate) fn microseconds(duration: Duration) -> f64 {
    duration.as_secs_f64() * 1e6
}
