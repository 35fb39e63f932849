//! CARMEN logs: text with one message per line, optionally compressed with bzip2 or gzip.
//!
//! Public logs come from many programs. This reader uses what it can, counts what it skips, and reports where it is.

mod clock;
mod line;
pub mod record;

use std::collections::BTreeMap;
use std::io::Read;
use std::path::Path;

use super::text::TextFileError;
use crate::geometry::Pose2;
use crate::time::Stamp;
pub use clock::StampRepair;
use line::Line;

/// Shown if a log has no scan: the usual form of a line with a scan.
const EXPECTED: &str = "FLASER n [ranges] x y theta odom_x odom_y odom_theta ipc_timestamp ipc_hostname logger_timestamp";
/// First bytes of a gzip file.
const GZIP_MAGIC: &[u8] = b"\x1f\x8b";
/// Maximum deviation of the laser's poses relative to the base, m and rad, for them to be its mount. If they deviate more,
/// another program has corrected them.
const MOUNT_TOLERANCE: f64 = 2e-3;
/// Readings above this are not distances, m: SICK lasers report errors as 81.83 m and more.
const MAX_DISTANCE: f64 = 80.0;
/// If more than this fraction of all readings of a log equal the largest one, that value means "no return".
const NO_RETURN_FRACTION: f64 = 1e-3;

/// A pose of the wheel odometry.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CarmenOdometry {
    /// Stamp of the line.
    pub stamp: Stamp,
    /// Pose of the base in the odometry frame.
    pub odom_from_base: Pose2,
    /// Speed, m/s, and yaw rate, rad/s, if the line has them.
    pub velocity: Option<(f64, f64)>,
}

/// A laser scan.
#[derive(Clone, Debug, PartialEq)]
pub struct CarmenScan {
    /// Stamp, and pose of the robot.
    pub odometry: CarmenOdometry,
    /// Pose of the laser in the odometry frame.
    pub odom_from_laser: Pose2,
    /// Whether the line gives these poses. `RAWLASER1` lines do not; their poses are the identity.
    pub has_poses: bool,
    /// Direction of the first beam, rad.
    pub angle_min: f64,
    /// Angle from one beam to the next, rad.
    pub angle_increment: f64,
    /// Readings of this value and above mean "no return", m; `None` if the line does not give it.
    pub no_return_range: Option<f64>,
    /// Readings, m.
    pub ranges: Vec<f32>,
}

/// The content of a log. Its lines are taken to be in the order of time; stamps that are out of order are repaired.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CarmenLog {
    /// The scans of the front laser.
    pub scans: Vec<CarmenScan>,
    /// Wheel odometry between the scans.
    pub odometry: Vec<CarmenOdometry>,
    /// How the stamps of the scans were repaired.
    pub stamp_repair: StampRepair,
    /// Number of skipped lines of other kinds, by kind.
    pub skipped: BTreeMap<String, usize>,
    /// Damaged lines, which were skipped: line number from 1, and what is wrong.
    pub damaged: Vec<(usize, String)>,
    /// Distance of the laser ahead of the robot's centre according to a `PARAM` line, m.
    frontlaser_offset: Option<f64>,
}

/// Pose of the laser on the robot, and where it comes from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Mount {
    /// From the scans, which all agree.
    Scans(Pose2),
    /// From a `PARAM` line, as the scans do not agree or have no poses.
    Parameter(Pose2),
    /// The scans have no poses, and there is no `PARAM` line: assumed at the centre of the robot.
    NoPoses,
    /// The scans do not agree, and there is no `PARAM` line: assumed at the centre of the robot.
    Inconsistent,
}

impl Mount {
    /// The pose of the laser relative to the base.
    pub fn laser_in_base(self) -> Pose2 {
        match self {
            Self::Scans(pose) | Self::Parameter(pose) => pose,
            Self::NoPoses | Self::Inconsistent => Pose2::IDENTITY,
        }
    }
}

impl CarmenLog {
    /// Reads a log with at least one scan. `FLASER` lines do not tell their field of view: without one given (from the first beam
    /// to the last, rad), it is 180 degrees for an odd number of beams and a beam less for an even one, as CARMEN has it.
    pub fn read(path: &Path, field_of_view: Option<f64>) -> Result<Self, TextFileError> {
        Self::parse(&load(path)?, path, field_of_view)
    }

    /// Reads a log from its text; `path` names it in errors.
    pub fn parse(text: &str, path: &Path, field_of_view: Option<f64>) -> Result<Self, TextFileError> {
        let mut log = Self::default();
        let (mut robot_lasers, mut raw_lasers) = (Vec::new(), Vec::new());
        for (index, line) in text.lines().enumerate() {
            match line::parse(line, field_of_view) {
                Ok(Line::FrontLaser(scan)) => log.scans.push(scan),
                Ok(Line::RobotLaser(scan)) => robot_lasers.push(scan),
                Ok(Line::RawLaser(scan)) => raw_lasers.push(scan),
                Ok(Line::Odometry(odometry)) => log.odometry.push(odometry),
                Ok(Line::FrontLaserOffset(offset)) => log.frontlaser_offset = Some(offset),
                Ok(Line::Other(kind)) => *log.skipped.entry(kind).or_default() += 1,
                Ok(Line::Blank) => {}
                Err(problem) => log.damaged.push((index + 1, problem)),
            }
        }
        // Some logs have every scan as both FLASER and ROBOTLASER1.
        if robot_lasers.len() >= log.scans.len() {
            log.scans = robot_lasers;
        }
        // Scans without poses are used only if there are no others.
        if log.scans.is_empty() {
            log.scans = raw_lasers;
        } else if !raw_lasers.is_empty() {
            log.skipped.insert("RAWLASER1".into(), raw_lasers.len());
        }
        if log.scans.is_empty() {
            let path = path.to_path_buf();
            return Err(match log.damaged.into_iter().next() {
                Some((line, problem)) => TextFileError::Line { path, line, problem },
                None => TextFileError::Empty { path, expected: EXPECTED },
            });
        }
        log.stamp_repair = clock::repair_stamps(&mut log.scans, |scan| &mut scan.odometry.stamp);
        clock::repair_stamps(&mut log.odometry, |odometry| &mut odometry.stamp);
        Ok(log)
    }

    /// The pose of the laser on the robot.
    pub fn mount(&self) -> Mount {
        let offset = |scan: &CarmenScan| scan.odometry.odom_from_base.between(&scan.odom_from_laser);
        let first = self.scans.first().map(offset).unwrap_or_default();
        let agrees = |offset: Pose2| {
            let difference = first.between(&offset);
            difference.distance() <= MOUNT_TOLERANCE && difference.theta.abs() <= MOUNT_TOLERANCE
        };
        match self.frontlaser_offset {
            _ if self.has_poses() && self.scans.iter().map(offset).all(agrees) => Mount::Scans(first),
            Some(ahead) => Mount::Parameter(Pose2::new(ahead, 0.0, 0.0)),
            None if self.has_poses() => Mount::Inconsistent,
            None => Mount::NoPoses,
        }
    }

    /// Whether all scans have poses of the robot.
    fn has_poses(&self) -> bool {
        self.scans.iter().all(|scan| scan.has_poses)
    }

    /// The reading that means "no return", m, for scans that do not give it themselves.
    fn no_return_range(&self) -> f64 {
        let readings = || self.scans.iter().flat_map(|scan| &scan.ranges).copied().filter(|range| range.is_finite());
        let largest = readings().fold(0.0, f32::max);
        let as_large = readings().filter(|range| *range >= largest).count();
        let is_a_distance = as_large as f64 <= NO_RETURN_FRACTION * readings().count() as f64;
        if is_a_distance { MAX_DISTANCE } else { f64::from(largest).min(MAX_DISTANCE) }
    }
}

/// Reads and decompresses the text of the file. Invalid UTF-8 (names of places, damage) is replaced.
fn load(path: &Path) -> Result<String, TextFileError> {
    let error = |source| TextFileError::Read { path: path.into(), source };
    let mut bytes = std::fs::read(path).map_err(error)?;
    let mut unpacked = Vec::new();
    if bytes.starts_with(b"BZh") {
        bzip2::read::MultiBzDecoder::new(bytes.as_slice()).read_to_end(&mut unpacked).map_err(error)?;
        bytes = unpacked;
    } else if bytes.starts_with(GZIP_MAGIC) {
        flate2::read::MultiGzDecoder::new(bytes.as_slice()).read_to_end(&mut unpacked).map_err(error)?;
        bytes = unpacked;
    }
    Ok(String::from_utf8(bytes).unwrap_or_else(|error| String::from_utf8_lossy(error.as_bytes()).into_owned()))
}
