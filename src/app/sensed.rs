//! The sensor messages that are matched: a laser scan or a point cloud.

use crate::cloud::{self, CloudKnobs};
use crate::messages::sensor_msgs::{LaserScan, PointCloud2};
use crate::messages::std_msgs::Header;
use crate::scan::{Scan, ScanConverter};
use crate::time::Stamp;
use crate::transforms::Mount;

/// A scan or a point cloud.
#[derive(Clone, Debug, PartialEq)]
pub enum SensorMessage {
    /// A laser scan.
    Scan(LaserScan),
    /// A point cloud.
    Cloud(PointCloud2),
}

impl SensorMessage {
    /// The header.
    pub fn header(&self) -> &Header {
        match self {
            Self::Scan(scan) => &scan.header,
            Self::Cloud(cloud) => &cloud.header,
        }
    }

    /// The stamp.
    pub fn stamp(&self) -> Stamp {
        self.header().stamp.into()
    }

    /// Number of beams of the scan, or of the scan that the cloud is converted to.
    pub fn beams(&self, knobs: &CloudKnobs) -> usize {
        match self {
            Self::Scan(scan) => scan.ranges.len(),
            Self::Cloud(_) => knobs.beams as usize,
        }
    }

    /// Converts the message to a scan; `None` if it is unusable.
    pub fn scan(&self, converter: &mut ScanConverter, knobs: &CloudKnobs, mount: &Mount) -> Option<Scan> {
        match self {
            Self::Scan(scan) => converter.convert(scan, mount.upside_down).ok(),
            Self::Cloud(cloud) => cloud::scan(cloud, knobs, &mount.level_from_laser).ok()?.masked(converter.mask()).ok(),
        }
    }
}
