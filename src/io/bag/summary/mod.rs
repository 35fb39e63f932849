//! Content and problems of a bag: the output of `anytime info`.

mod cloud;
mod laser;
mod odometry;
mod table;
mod topic;

use std::collections::{BTreeMap, BTreeSet};
use std::error::Error as _;

use serde::Serialize;

use crate::messages::Message;
use crate::messages::nav_msgs::Odometry;
use crate::messages::sensor_msgs::{LaserScan, PointCloud2};
use crate::messages::tf2_msgs::TFMessage;
use crate::transforms::TransformTree;

use super::{Bag, BagError, BagMessage, Connection};

pub use cloud::CloudSummary;
pub use laser::LaserSummary;
pub use odometry::OdometrySummary;
pub use topic::TopicSummary;

/// Usual name of the base frame (REP 105).
const DEFAULT_BASE_FRAME: &str = "base_link";

/// Summary of a bag.
#[derive(Clone, Debug, Serialize)]
pub struct BagSummary {
    /// Path of the file.
    pub path: String,
    /// Size of the file, bytes.
    pub size_bytes: u64,
    /// Recording time of the first message, seconds since 1970.
    pub start_s: Option<f64>,
    /// Time from the first to the last message, s.
    pub duration_s: f64,
    /// Number of messages read.
    pub messages: u64,
    /// Number of chunks by compression.
    pub chunks: BTreeMap<&'static str, usize>,
    /// All topics, sorted by name.
    pub topics: Vec<TopicSummary>,
    /// The topics with laser scans.
    pub lasers: Vec<LaserSummary>,
    /// The topics with point clouds.
    pub clouds: Vec<CloudSummary>,
    /// The topics with odometry.
    pub odometry: Vec<OdometrySummary>,
    /// Problems of the bag, one sentence each.
    pub problems: Vec<String>,
}

impl BagSummary {
    /// Reads the whole bag; calls `on_message` after each message.
    pub fn read(bag: &Bag, mut on_message: impl FnMut()) -> Result<Self, BagError> {
        let mut topics: BTreeMap<&str, TopicReport> = BTreeMap::new();
        for connection in bag.connections() {
            topics.entry(&connection.topic).or_insert_with(|| TopicReport::new(connection));
        }
        let (mut transforms, mut rejected) = (TransformTree::default(), 0);
        for message in bag.messages(None) {
            let message = message?;
            if message.connection.carries::<TFMessage>()
                && let Ok(message) = message.decode()
            {
                rejected += transforms.add(&message);
            }
            if let Some(report) = topics.get_mut(message.connection.topic.as_str()) {
                report.add(&message);
            }
            on_message();
        }
        let mut summary = Self::without_topics(bag);
        for report in topics.into_values() {
            let topic = report.statistics.summary();
            summary.messages += topic.messages;
            summary.problems.extend(topic.problems());
            summary.topics.push(topic);
            match report.content {
                Content::Laser(laser) => summary.lasers.push(laser.summary()),
                Content::Cloud(cloud) => summary.clouds.push(cloud),
                Content::Odometry(odometry) => summary.odometry.push(odometry),
                Content::Other => {}
            }
        }
        summary.problems.extend(summary.lasers.iter().flat_map(LaserSummary::problems));
        summary.problems.extend(summary.tilted_lasers(&transforms));
        summary.problems.extend((rejected > 0).then(|| format!("{rejected} transforms are not rigid motions and were ignored")));
        summary.problems.extend(summary.clouds.iter().flat_map(CloudSummary::problems));
        summary.problems.extend(summary.odometry.iter().flat_map(OdometrySummary::problems));
        summary.problems.extend(summary.missing_data());
        Ok(summary)
    }

    /// Summary without its topics. Call it after the messages were read: some damage is found only then.
    fn without_topics(bag: &Bag) -> Self {
        Self {
            path: bag.path().display().to_string(),
            size_bytes: bag.size(),
            start_s: bag.span().map(|(start, _)| start.seconds()),
            duration_s: bag.span().map_or(0.0, |(start, end)| end.seconds_since(start)),
            messages: 0,
            chunks: bag.compressions().into_iter().map(|(compression, chunks)| (compression.name(), chunks)).collect(),
            topics: Vec::new(),
            lasers: Vec::new(),
            clouds: Vec::new(),
            odometry: Vec::new(),
            problems: bag.problems().iter().map(ToString::to_string).collect(),
        }
    }

    /// Reports lasers that are not mounted level, according to the last transforms in the bag. The base frame is the child frame
    /// of the odometry, or else the one of the usual name.
    fn tilted_lasers(&self, transforms: &TransformTree) -> Vec<String> {
        let of_odometry = self.odometry.iter().flat_map(|odometry| &odometry.child_frames);
        let bases: Vec<&str> = of_odometry.map(String::as_str).chain([DEFAULT_BASE_FRAME]).collect();
        let tilted = |laser: &LaserSummary| {
            let topic = laser.topic.clone();
            let errors = laser.usability.frames.iter().filter_map(|frame| transforms.check_level(&bases, frame).err());
            errors.map(move |error| format!("{topic}: {error}")).collect::<Vec<_>>()
        };
        self.lasers.iter().flat_map(tilted).collect()
    }

    fn missing_data(&self) -> Vec<String> {
        let mut missing = Vec::new();
        if self.messages == 0 {
            missing.push("the bag has no messages".into());
        } else if self.lasers.iter().all(|laser| laser.usability.usable == 0)
            && self.clouds.iter().all(|cloud| cloud.usability.usable == 0)
        {
            missing.push(format!("the bag has no usable scans ({} or {}) to match", LaserScan::TYPE, PointCloud2::TYPE));
        }
        if self.messages > 0 && self.odometry.is_empty() {
            missing.push(format!("the bag has no odometry ({}): poses are predicted by constant velocity", Odometry::TYPE));
        }
        missing
    }
}

/// Statistics of a topic.
struct TopicReport {
    statistics: topic::Statistics,
    content: Content,
}

enum Content {
    Laser(Box<laser::Statistics>),
    Cloud(CloudSummary),
    Odometry(OdometrySummary),
    Other,
}

impl TopicReport {
    fn new(connection: &Connection) -> Self {
        let is = |name: &str, carries: bool| carries || connection.message_type == name;
        let content = if is(LaserScan::TYPE, connection.carries::<LaserScan>()) {
            Content::Laser(Box::new(laser::Statistics::new(&connection.topic)))
        } else if is(PointCloud2::TYPE, connection.carries::<PointCloud2>()) {
            Content::Cloud(CloudSummary::new(&connection.topic))
        } else if is(Odometry::TYPE, connection.carries::<Odometry>()) {
            Content::Odometry(OdometrySummary::new(&connection.topic))
        } else {
            Content::Other
        };
        Self { statistics: topic::Statistics::new(connection), content }
    }

    fn add(&mut self, message: &BagMessage<'_>) {
        self.statistics.add(message);
        match &mut self.content {
            Content::Laser(laser) => laser.add(message),
            Content::Cloud(cloud) => cloud.add(message),
            Content::Odometry(odometry) => odometry.add(message),
            Content::Other => {}
        }
    }
}

/// Frames of the scans or clouds on a topic, and how many of them are usable.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Usability {
    /// Frames of the messages: usually one.
    pub frames: BTreeSet<String>,
    /// Number of usable messages.
    pub usable: u64,
    /// Number of unusable messages.
    pub unusable: u64,
    /// Why the first unusable message is unusable.
    pub first_error: Option<String>,
}

impl Usability {
    /// Counts an unusable message.
    fn reject(&mut self, error: String) {
        self.unusable += 1;
        self.first_error.get_or_insert(error);
    }

    /// The problems; `messages` is the plural name of the messages.
    fn problems(&self, topic: &str, messages: &str) -> Vec<String> {
        let Self { frames, usable, unusable, first_error } = self;
        let mut problems = Vec::new();
        if let Some(error) = first_error {
            problems.push(format!("{topic}: {unusable} of {} {messages} are unusable; the first: {error}", unusable + usable));
        }
        if frames.len() > 1 {
            problems.push(format!("{topic}: {messages} are in {} different frames", frames.len()));
        }
        if frames.contains("") {
            problems.push(format!("{topic}: some {messages} have no frame_id"));
        }
        problems
    }
}

/// An error and its causes, on one line.
fn with_cause(error: &BagError) -> String {
    match error.source() {
        Some(cause) => format!("{error}: {cause}"),
        None => error.to_string(),
    }
}
