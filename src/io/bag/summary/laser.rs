//! Scan geometry of a topic, and how many of its scans are usable.

use std::collections::BTreeSet;

use serde::Serialize;

use crate::messages::sensor_msgs::LaserScan;
use crate::scan::{Scan, ScanConverter};

use super::super::BagMessage;
use super::{Usability, with_cause};

/// Summary of the scans on a topic. The geometry is that of the last scan.
#[derive(Clone, Debug, Default, Serialize)]
pub struct LaserSummary {
    /// Name of the topic.
    pub topic: String,
    /// Number of beams.
    pub beams: usize,
    /// Direction of the first beam, degrees.
    pub angle_min_deg: f64,
    /// Angle from the first to the last beam, degrees.
    pub field_of_view_deg: f64,
    /// Angle from one beam to the next, degrees.
    pub increment_deg: f64,
    /// Minimum range of the laser, m.
    pub range_min_m: f64,
    /// Maximum range of the laser, m.
    pub range_max_m: f64,
    /// How often the geometry changed from one scan to the next.
    pub geometry_changes: u64,
    /// Percentage of the rays of usable scans that have a valid range.
    pub valid_percent: f64,
    /// Which scans can be matched.
    #[serde(flatten)]
    pub usability: Usability,
    /// Irregularities that do not make any scan unusable.
    pub oddities: BTreeSet<String>,
}

impl LaserSummary {
    pub(super) fn problems(&self) -> Vec<String> {
        let topic = &self.topic;
        let mut problems = self.usability.problems(topic, "scans");
        problems.extend(self.oddities.iter().map(|oddity| format!("{topic}: {oddity}")));
        if self.geometry_changes > 0 {
            problems.push(format!("{topic}: the scan geometry changes {} times", self.geometry_changes));
        }
        problems
    }
}

/// Statistics of the scans on a topic, collected while they are read.
pub(super) struct Statistics {
    summary: LaserSummary,
    converter: ScanConverter,
    geometry: Option<Geometry>,
    rays: usize,
    valid_rays: usize,
}

/// Values that must be equal, to the bit, in scans of the same geometry.
#[derive(PartialEq)]
struct Geometry {
    numbers: [u32; 4],
    beams: usize,
}

impl Statistics {
    pub(super) fn new(topic: &str) -> Self {
        let summary = LaserSummary { topic: topic.into(), ..LaserSummary::default() };
        Self { summary, converter: ScanConverter::default(), geometry: None, rays: 0, valid_rays: 0 }
    }

    pub(super) fn add(&mut self, message: &BagMessage<'_>) {
        match message.decode::<LaserScan>() {
            Ok(scan) => self.add_scan(&scan),
            Err(error) => self.summary.usability.reject(with_cause(&error)),
        }
    }

    fn add_scan(&mut self, message: &LaserScan) {
        self.describe(message);
        let scan = self.converter.convert(message, false).and_then(Scan::reject_uniform);
        self.summary.oddities.extend(self.converter.take_warnings().iter().map(ToString::to_string));
        match scan {
            Ok(scan) => {
                self.summary.usability.usable += 1;
                self.rays += scan.len();
                self.valid_rays += scan.valid_len();
            }
            Err(error) => self.summary.usability.reject(error.to_string()),
        }
    }

    fn describe(&mut self, message: &LaserScan) {
        let numbers = [message.angle_min, message.angle_increment, message.range_min, message.range_max].map(f32::to_bits);
        let geometry = Geometry { numbers, beams: message.ranges.len() };
        let changed = self.geometry.as_ref().is_some_and(|previous| *previous != geometry);
        self.geometry = Some(geometry);
        let increment_deg = f64::from(message.angle_increment).to_degrees();
        let summary = &mut self.summary;
        summary.geometry_changes += u64::from(changed);
        summary.usability.frames.insert(message.header.frame_id.clone());
        summary.beams = message.ranges.len();
        summary.angle_min_deg = f64::from(message.angle_min).to_degrees();
        summary.field_of_view_deg = increment_deg.abs() * summary.beams.saturating_sub(1) as f64;
        summary.increment_deg = increment_deg;
        summary.range_min_m = message.range_min.into();
        summary.range_max_m = message.range_max.into();
    }

    pub(super) fn summary(mut self) -> LaserSummary {
        self.summary.valid_percent = 100.0 * self.valid_rays as f64 / self.rays.max(1) as f64;
        self.summary
    }
}
