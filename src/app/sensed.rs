//! What a laser sends: a scan, or a cloud of points.

use crate::cloud::{self, CloudKnobs};
use crate::messages::sensor_msgs::{LaserScan, PointCloud2};
use crate::messages::std_msgs::Header;
use crate::scan::{Scan, ScanConverter};
use crate::time::Stamp;
use crate::transforms::Mount;

/// A message that is to be located.
#[derive(Clone, Debug, PartialEq)]
pub enum Sensed {
    /// Ranges.
    Scan(LaserScan),
    /// Points.
    Cloud(PointCloud2),
}

impl Sensed {
    /// Its header.
    pub fn header(&self) -> &Header {
        match self {
            Self::Scan(scan) => &scan.header,
            Self::Cloud(cloud) => &cloud.header,
        }
    }

    /// Its stamp.
    pub fn stamp(&self) -> Stamp {
        self.header().stamp.into()
    }

    /// Number of beams it has, or will have as a scan.
    pub fn beams(&self, knobs: &CloudKnobs) -> usize {
        match self {
            Self::Scan(scan) => scan.ranges.len(),
            Self::Cloud(_) => knobs.beams as usize,
        }
    }

    /// The scan that it is, if it is a usable one.
    pub fn scan(&self, converter: &mut ScanConverter, knobs: &CloudKnobs, mount: &Mount) -> Option<Scan> {
        match self {
            Self::Scan(scan) => converter.convert(scan, mount.upside_down).ok(),
            Self::Cloud(cloud) => cloud::scan(cloud, knobs, &mount.level_from_laser).ok()?.masked(converter.mask()).ok(),
        }
    }
}
