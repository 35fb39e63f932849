//! CARMEN logs: text with one message on each line, packed with bzip2 or gzip, or not.
//!
//! Public logs come from many programs: this reader uses what it can, and counts and locates what it skips.

mod clock;
mod line;
pub mod record;

use std::collections::BTreeMap;
use std::io::Read;
use std::path::Path;

use super::text::TextFileError;
use crate::geometry::Pose2;
use crate::time::Stamp;
pub use clock::Mended;
use line::Line;

/// What a log must have at least one of.
const EXPECTED: &str = "FLASER n [ranges] x y theta odom_x odom_y odom_theta ipc_timestamp ipc_hostname logger_timestamp";
/// What a file packed with gzip begins with.
const GZIP: &[u8] = b"\x1f\x8b";
/// Laser poses that keep within this of one place on the robot (m, rad) are a mount; others are corrected by some other program.
const MOUNT_TOLERANCE: f64 = 2e-3;
/// No reading beyond is a distance, m: lasers by SICK report their errors as 81.83 m and more.
const ERROR_CODES: f64 = 80.0;
/// When more than this part of a log's readings are the largest one, it stands for "nothing seen".
const NOTHING_SEEN: f64 = 1e-3;

/// A pose by wheel odometry.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CarmenOdometry {
    /// When.
    pub stamp: Stamp,
    /// Where.
    pub odom_from_base: Pose2,
    /// Speed, m/s, and yaw rate, rad/s, where the line has them.
    pub velocity: Option<(f64, f64)>,
}

/// A laser scan.
#[derive(Clone, Debug, PartialEq)]
pub struct CarmenScan {
    /// Where the robot was, and when.
    pub odometry: CarmenOdometry,
    /// Where the line has the laser.
    pub odom_from_laser: Pose2,
    /// Whether the line tells these poses; those of `RAWLASER1` lines do not, and stand at the origin.
    pub posed: bool,
    /// Direction of the first beam, rad.
    pub angle_min: f64,
    /// Angle from beam to beam, rad.
    pub angle_increment: f64,
    /// Readings of this and above are misses, m; `None` where the line does not say.
    pub nothing_seen: Option<f64>,
    /// Readings, m.
    pub ranges: Vec<f32>,
}

/// What a log holds. Its lines are in the order of time; stamps that are out of order are repaired.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CarmenLog {
    /// The scans of the front laser.
    pub scans: Vec<CarmenScan>,
    /// Wheel odometry between the scans.
    pub odometry: Vec<CarmenOdometry>,
    /// What was done to the stamps of the scans.
    pub mended: Mended,
    /// Lines of other kinds: how many of each.
    pub passed_over: BTreeMap<String, usize>,
    /// Damaged lines, which were left out: number from 1, and what is wrong.
    pub damaged: Vec<(usize, String)>,
    /// Distance of the laser ahead of the robot's centre that a `PARAM` line tells, m.
    frontlaser_offset: Option<f64>,
}

/// Where the laser sits, and how that is known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Mount {
    /// All scans agree.
    Scans(Pose2),
    /// The scans do not agree, but a `PARAM` line says it.
    Parameter(Pose2),
    /// The scans have no poses, and there is no `PARAM` line: assumed at the centre of the robot.
    Untold,
    /// Unknown: assumed at the centre of the robot.
    Unknown,
}

impl Mount {
    /// The pose on the robot.
    pub fn laser_in_base(self) -> Pose2 {
        match self {
            Self::Scans(pose) | Self::Parameter(pose) => pose,
            Self::Untold | Self::Unknown => Pose2::IDENTITY,
        }
    }
}

impl CarmenLog {
    /// Reads a log with at least one scan. `FLASER` lines do not tell their field of view: without one given (from the first beam to
    /// the last, rad), it is 180 degrees for an odd number of beams and a beam less for an even one, as CARMEN has it.
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
                Ok(Line::Other(kind)) => *log.passed_over.entry(kind).or_default() += 1,
                Ok(Line::Nothing) => {}
                Err(problem) => log.damaged.push((index + 1, problem)),
            }
        }
        // Some logs have every scan in both forms.
        if robot_lasers.len() >= log.scans.len() {
            log.scans = robot_lasers;
        }
        // Scans without poses are used where there are no others.
        if log.scans.is_empty() {
            log.scans = raw_lasers;
        } else if !raw_lasers.is_empty() {
            log.passed_over.insert("RAWLASER1".into(), raw_lasers.len());
        }
        if log.scans.is_empty() {
            let path = path.to_path_buf();
            return Err(match log.damaged.into_iter().next() {
                Some((line, problem)) => TextFileError::Line { path, line, problem },
                None => TextFileError::Empty { path, expected: EXPECTED },
            });
        }
        log.mended = clock::mend(&mut log.scans, |scan| &mut scan.odometry.stamp);
        clock::mend(&mut log.odometry, |odometry| &mut odometry.stamp);
        Ok(log)
    }

    /// Where the laser sits.
    pub fn mount(&self) -> Mount {
        let offset = |scan: &CarmenScan| scan.odometry.odom_from_base.between(&scan.odom_from_laser);
        let seen = self.scans.first().map(offset).unwrap_or_default();
        let is_seen = |offset: Pose2| {
            let off = seen.between(&offset);
            off.distance() <= MOUNT_TOLERANCE && off.theta.abs() <= MOUNT_TOLERANCE
        };
        match self.frontlaser_offset {
            _ if self.has_poses() && self.scans.iter().map(offset).all(is_seen) => Mount::Scans(seen),
            Some(ahead) => Mount::Parameter(Pose2::new(ahead, 0.0, 0.0)),
            None if self.has_poses() => Mount::Unknown,
            None => Mount::Untold,
        }
    }

    /// Whether the scans have poses of the robot.
    fn has_poses(&self) -> bool {
        self.scans.iter().all(|scan| scan.posed)
    }

    /// The reading that stands for "nothing seen", m, where the scans themselves do not tell.
    fn nothing_seen(&self) -> f64 {
        let readings = || self.scans.iter().flat_map(|scan| &scan.ranges).copied().filter(|range| range.is_finite());
        let largest = readings().fold(0.0, f32::max);
        let as_large = readings().filter(|range| *range >= largest).count();
        let is_a_distance = as_large as f64 <= NOTHING_SEEN * readings().count() as f64;
        if is_a_distance { ERROR_CODES } else { f64::from(largest).min(ERROR_CODES) }
    }
}

/// The text of the file. Where it is no UTF-8 (names of places, damage) the characters are replaced.
fn load(path: &Path) -> Result<String, TextFileError> {
    let error = |source| TextFileError::Read { path: path.into(), source };
    let mut bytes = std::fs::read(path).map_err(error)?;
    let mut unpacked = Vec::new();
    if bytes.starts_with(b"BZh") {
        bzip2::read::MultiBzDecoder::new(bytes.as_slice()).read_to_end(&mut unpacked).map_err(error)?;
        bytes = unpacked;
    } else if bytes.starts_with(GZIP) {
        flate2::read::MultiGzDecoder::new(bytes.as_slice()).read_to_end(&mut unpacked).map_err(error)?;
        bytes = unpacked;
    }
    Ok(String::from_utf8(bytes).unwrap_or_else(|error| String::from_utf8_lossy(error.as_bytes()).into_owned()))
}
