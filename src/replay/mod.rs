//! Runs a bag through the application that the node runs.

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

use self::ahead::Ahead;
use crate::anytime::clock::Clock;
use crate::anytime::interrupt::Never;
use crate::app::sensed::Sensed;
use crate::app::{Answering, App, Estimate};
use crate::io::bag::{Bag, BagError, BagMessage};
use crate::io::contract_schedule::ContractSchedule;
use crate::messages::nav_msgs::Odometry;
use crate::messages::sensor_msgs::{Imu, LaserScan, PointCloud2};
use crate::messages::tf2_msgs::TFMessage;
use crate::messages::{Message, header_stamp};
use crate::time::Stamp;

/// Where transforms are published.
const TRANSFORM_TOPICS: [&str; 2] = ["/tf", "/tf_static"];

/// The topics to replay.
#[derive(Clone, Debug)]
pub struct Topics {
    /// Laser scans or point clouds, by the type of the topic.
    pub scan: String,
    /// Wheel odometry; `None`: do without.
    pub odometry: Option<String>,
    /// An IMU; `None`: do without.
    pub imu: Option<String>,
    /// The odometry is read so far ahead of everything else. Zero: as it was recorded, which is what a robot has.
    pub odometry_ahead: Duration,
}

impl Topics {
    /// The topics asked for. If none is named, odometry is optional.
    pub fn resolve(bag: &Bag, scan: &str, odometry: Option<&str>) -> Result<Self, BagError> {
        expect_scans(bag, scan)?;
        Ok(Self {
            scan: scan.into(),
            odometry: optional::<Odometry>(bag, odometry, "/odom")?,
            imu: None,
            odometry_ahead: Duration::ZERO,
        })
    }

    /// The same, and an IMU: the one asked for, or the usual one.
    pub fn with_imu(self, bag: &Bag, imu: Option<&str>) -> Result<Self, BagError> {
        Ok(Self { imu: optional::<Imu>(bag, imu, "/imu/data")?, ..self })
    }

    /// Of the same, the scans alone.
    #[must_use]
    pub fn scan_only(self) -> Self {
        Self { odometry: None, imu: None, ..self }
    }

    /// Every topic that is read.
    pub fn all(&self) -> Vec<&str> {
        let optional = self.odometry.as_deref().into_iter().chain(self.imu.as_deref());
        [self.scan.as_str()].into_iter().chain(optional).chain(TRANSFORM_TOPICS).collect()
    }
}

/// Checks that there are scans on a topic, or clouds.
fn expect_scans(bag: &Bag, topic: &str) -> Result<(), BagError> {
    let clouds = bag.topics_of::<PointCloud2>();
    if clouds.contains(&topic) {
        return Ok(());
    }
    bag.expect_topic::<LaserScan>(topic).map_err(|mut error| {
        if let (BagError::NoSuchTopic { alternatives, .. }, false) = (&mut error, clouds.is_empty()) {
            alternatives.extend(["; ", PointCloud2::TYPE, " is on: ", &clouds.join(", ")]);
        }
        error
    })
}

/// The scan or the cloud that a message is.
fn sensed(message: &BagMessage) -> Result<Sensed, BagError> {
    if message.connection.carries::<LaserScan>() {
        message.decode().map(Sensed::Scan)
    } else if message.connection.carries::<PointCloud2>() {
        message.decode().map(Sensed::Cloud)
    } else {
        message.decode().map(Sensed::Scan) // the error names the right type
    }
}

/// The topic asked for, which must be there, or else the usual one, which may be.
fn optional<T: Message>(bag: &Bag, wanted: Option<&str>, usual: &str) -> Result<Option<String>, BagError> {
    match wanted {
        Some(topic) => bag.expect_topic::<T>(topic).map(|()| Some(topic.to_owned())),
        None => Ok(bag.topics_of::<T>().contains(&usual).then(|| usual.to_owned())),
    }
}

/// What is replayed.
#[derive(Clone, Copy)]
pub struct Source<'a> {
    /// The bag.
    pub bag: &'a Bag,
    /// Topics of it.
    pub topics: &'a Topics,
    /// Contracts that are not the configuration's.
    pub schedule: &'a ContractSchedule,
}

/// Problems during a replay.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ReplayLog {
    /// Messages that could not be read or used: of each kind the first, and how many.
    unusable: Vec<UnusableMessages>,
    /// What was odd in those that could.
    remarks: Vec<String>,
    /// How many could not, in all.
    pub unusable_messages: u64,
}

/// Messages that could not be used for the same reason.
#[derive(Clone, Debug, PartialEq, Eq)]
struct UnusableMessages {
    reason: String,
    /// When, where the reason does not say.
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
            (_, Some(first)) => write!(f, " ({count} messages, the first at {first})"),
        }
    }
}

impl ReplayLog {
    const KEPT: usize = 10;

    /// Why there is nothing to show: what was wrong with the `unusable` scans; if nothing, which messages were unusable, and what the bag
    /// lost. Empty if unknown.
    pub fn reasons(&self, bag: &Bag, unusable: &[String]) -> String {
        let messages =
            self.unusable.first().map(|first| format!("{} unusable messages, the first: {first}", self.unusable_messages));
        let lost = bag.problems();
        let of_messages = messages.into_iter().chain(lost.iter().map(ToString::to_string));
        let reasons: Vec<String> = if unusable.is_empty() { of_messages.collect() } else { unusable.to_vec() };
        if reasons.is_empty() { String::new() } else { format!(": {}", reasons.join("; ")) }
    }

    /// What the user should know, in words: the first kinds of messages that could not be used, and what was odd.
    pub fn problems(&self) -> impl Iterator<Item = String> {
        self.unusable.iter().map(ToString::to_string).chain(self.remarks.iter().cloned())
    }

    /// Takes note of a message that could not be used.
    fn note(&mut self, time: Option<Stamp>, reason: &str) {
        self.unusable_messages += 1;
        if let Some(known) = self.unusable.iter_mut().find(|known| known.reason == reason) {
            known.count += 1;
        } else if self.unusable.len() < Self::KEPT {
            self.unusable.push(UnusableMessages { reason: reason.into(), first: time, count: 1 });
        }
    }
}

/// Replays a bag. `on_estimate` gets each scan with its answer; `on_message` is called for every message read, to show progress. An
/// error of `on_estimate` ends the replay.
pub fn replay<E: From<BagError>>(
    source: &Source,
    app: &mut App,
    clock: &dyn Clock,
    on_message: impl FnMut(),
    mut on_estimate: impl FnMut(&Sensed, &Estimate, &mut App) -> Result<(), E>,
) -> Result<ReplayLog, E> {
    let mut first_stamp = None;
    feed(source.bag, source.topics, app, on_message, |message, app, log| {
        let arrival = clock.now();
        match sensed(message) {
            Ok(scan) => {
                let stamp = scan.stamp();
                let first_stamp = *first_stamp.get_or_insert(stamp);
                if let Some(contract) = source.schedule.at(stamp.seconds_since(first_stamp)) {
                    app.set_contract(contract);
                }
                let mut answered = app.answer(&scan, arrival, |_, _| ());
                let (app, estimate) = answered.parts();
                on_estimate(&scan, estimate, app)?;
                answered.maintain(&Never);
            }
            Err(error) => log.note(None, &error.to_string()),
        }
        Ok(())
    })
}

/// Hands the messages of a bag to a listener in their order, and its scans to `answer`, each when the odometry for it has come, or
/// it can wait no longer.
fn feed<L: Answering, E>(
    bag: &Bag,
    topics: &Topics,
    listener: &mut L,
    mut on_message: impl FnMut(),
    mut answer: impl FnMut(&BagMessage, &mut L, &mut ReplayLog) -> Result<(), E>,
) -> Result<ReplayLog, E> {
    let mut log = ReplayLog::default();
    let mut held: Option<HeldScan> = None;
    let messages = bag.messages(Some(&topics.all()));
    for message in Ahead::new(messages, topics.odometry.as_deref(), topics.odometry_ahead) {
        on_message();
        let message = match message {
            Ok(message) => message,
            Err(error) => {
                log.note(None, &error.to_string());
                continue;
            }
        };
        let is_scan = message.connection.topic == topics.scan;
        if let Some(scan) = held.take_if(|scan| is_scan || !scan.can_wait(listener, message.time)) {
            answer(&scan.message, listener, &mut log)?;
        }
        if is_scan {
            held = Some(HeldScan::new(message));
        } else if let Err(problem) = take(listener, topics, &message) {
            log.note(Some(message.time), &problem);
        }
        if let Some(scan) = held.take_if(|scan| !scan.can_wait(listener, scan.message.time)) {
            answer(&scan.message, listener, &mut log)?;
        }
    }
    if let Some(scan) = held {
        answer(&scan.message, listener, &mut log)?;
    }
    log.remarks = listener.take_remarks();
    Ok(log)
}

/// A scan held back until the odometry for it has come, as the node does.
struct HeldScan<'bag> {
    message: BagMessage<'bag>,
    stamp: Stamp,
}

impl<'bag> HeldScan<'bag> {
    fn new(message: BagMessage<'bag>) -> Self {
        // A scan that cannot be read has no stamp; any will do, it will be answered with an error.
        let stamp = header_stamp(&message.data).unwrap_or(message.time);
        Self { message, stamp }
    }

    fn can_wait(&self, listener: &impl Answering, now: Stamp) -> bool {
        listener.wait_for_odometry(self.stamp).is_some_and(|wait| now.seconds_since(self.message.time) < wait.as_secs_f64())
    }
}

fn take(listener: &mut impl Answering, topics: &Topics, message: &BagMessage) -> Result<(), String> {
    let topic = message.connection.topic.as_str();
    let in_words = |problem: &dyn fmt::Display| format!("{topic}: {problem}");
    if topics.odometry.as_deref() == Some(topic) {
        let odometry = message.decode().map_err(|e| e.to_string())?;
        listener.on_odometry(&odometry).map_err(|e| in_words(&e))
    } else if topics.imu.as_deref() == Some(topic) {
        let imu = message.decode().map_err(|e| e.to_string())?;
        listener.on_imu(&imu).map_err(|e| in_words(&e))
    } else {
        let transforms: TFMessage = message.decode().map_err(|e| e.to_string())?;
        listener.on_transforms(&transforms).map_err(|e| in_words(&e))
    }
}

/// Microseconds, for people and files.
pub(crate) fn microseconds(duration: Duration) -> f64 {
    duration.as_secs_f64() * 1e6
}
