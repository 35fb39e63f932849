//! A laser scan, checked once and immutable from then on.

use std::f64::consts::TAU;
use std::sync::Arc;

use thiserror::Error;

use crate::geometry::{Point, Twist2};
use crate::messages::sensor_msgs::LaserScan;
use crate::time::Stamp;

/// Fewest beams a scan may have.
pub const MIN_BEAMS: usize = 10;
/// Most beams a scan may have.
pub const MAX_BEAMS: usize = 10_000;
/// Least part of the rays that must carry a measurement.
pub const MIN_VALID_FRACTION: f64 = 0.1;
/// A sweep may exceed a full turn by this much, rad: the rounding of the message's 32-bit angles.
const FULL_TURN_TOLERANCE: f64 = 1e-4;
/// Drivers round the number of beams or the last angle: the two may disagree by this many beams.
const BEAM_COUNT_TOLERANCE: f64 = 1.6;

/// Why a message is not a usable scan.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum ScanError {
    /// A header number is NaN or infinite.
    #[error("{field} is {value}: the driver must fill in a finite number")]
    NotFinite {
        /// Name of the message field.
        field: &'static str,
        /// Its value.
        value: f64,
    },
    /// Two neighbouring beams would coincide.
    #[error("angle_increment is 0: the beams have no directions")]
    ZeroIncrement,
    /// Too few or too many beams.
    #[error("{beams} ranges: a scan has {MIN_BEAMS} to {MAX_BEAMS}")]
    BeamCount {
        /// Number of ranges.
        beams: usize,
    },
    /// The number of ranges is not what the angles say.
    #[error("{beams} ranges, but angle_min, angle_max and angle_increment make {expected:.1}")]
    AngleMismatch {
        /// Number of ranges.
        beams: usize,
        /// Number that the angles give.
        expected: f64,
    },
    /// Intensities are there, but not one for every range.
    #[error("{ranges} ranges but {intensities} intensities: there must be as many, or none")]
    IntensityMismatch {
        /// Number of ranges.
        ranges: usize,
        /// Number of intensities.
        intensities: usize,
    },
    /// The beams pass their start again.
    #[error("the beams sweep {degrees:.1} degrees: more than a full turn")]
    MoreThanATurn {
        /// Angle between the first and the last beam.
        degrees: f64,
    },
    /// No range could be valid.
    #[error("range_min {min} m and range_max {max} m leave no range valid")]
    EmptyRangeInterval {
        /// `range_min`.
        min: f64,
        /// `range_max`.
        max: f64,
    },
    /// Nearly every ray is without a measurement.
    #[error(
        "{valid} of {beams} rays carry a measurement: at least 10 % must (is the laser covered, or range_min/range_max wrong?)"
    )]
    TooFewValid {
        /// Rays with a measurement.
        valid: usize,
        /// All rays.
        beams: usize,
    },
}

/// Directions of the beams of a scan, shared by all scans of the same laser.
#[derive(Clone, Debug, PartialEq)]
pub struct BeamGeometry {
    angle_min: f64,
    angle_increment: f64,
    directions: Vec<Point>,
    is_even: bool,
}

impl BeamGeometry {
    /// Beam `i` points to `angle_min + i * angle_increment`, rad.
    pub fn new(angle_min: f64, angle_increment: f64, beams: usize) -> Self {
        let directions = (0..beams)
            .map(|i| {
                let (sin, cos) = (angle_min + i as f64 * angle_increment).sin_cos();
                Point::new(cos, sin)
            })
            .collect();
        Self { angle_min, angle_increment, directions, is_even: true }
    }

    /// Beam `i` points in direction `i`, which is about `angle_min + i * angle_increment`, rad.
    pub fn about(angle_min: f64, angle_increment: f64, directions: Vec<Point>) -> Self {
        Self { angle_min, angle_increment, directions, is_even: false }
    }

    /// Number of beams.
    pub fn len(&self) -> usize {
        self.directions.len()
    }

    /// Whether there are no beams.
    pub fn is_empty(&self) -> bool {
        self.directions.is_empty()
    }

    /// Direction of beam `i`, rad.
    pub fn angle(&self, i: usize) -> f64 {
        self.angle_min + i as f64 * self.angle_increment
    }

    /// Angle from one beam to the next, rad; negative when the laser sweeps clockwise.
    pub fn angle_increment(&self) -> f64 {
        self.angle_increment
    }

    /// Whether the beams point where their indices say; those of an undistorted scan do so only about.
    pub fn is_even(&self) -> bool {
        self.is_even
    }

    /// Unit vectors of the beams.
    pub fn directions(&self) -> &[Point] {
        &self.directions
    }

    /// Angle between the last beam and the first one, the way that the sweep leaves out, rad. About zero or one increment for a
    /// laser that looks all round.
    pub fn gap(&self) -> f64 {
        TAU - (self.len().saturating_sub(1)) as f64 * self.angle_increment.abs()
    }

    /// Whether the last beam and the first are neighbours like any other two.
    pub fn closes(&self) -> bool {
        self.gap() < 1.5 * self.angle_increment.abs()
    }

    fn is_of(&self, angle_min: f64, angle_increment: f64, beams: usize) -> bool {
        self.len() == beams
            && self.angle_min.to_bits() == angle_min.to_bits()
            && self.angle_increment.to_bits() == angle_increment.to_bits()
    }
}

/// A checked scan: ranges in ray order, with the rays that carry no measurement kept in place.
#[derive(Clone, Debug)]
pub struct Scan {
    stamp: Stamp,
    beams: Arc<BeamGeometry>,
    ranges: Vec<f64>,
    valid: usize,
    /// From one ray to the next, s.
    time_increment: f64,
}

impl Scan {
    /// A scan from ranges in metres. A ray is without a measurement (REP 117) when its range is NaN, infinite, not positive, below
    /// `range_min` or above `range_max`.
    pub fn new(
        stamp: Stamp,
        beams: Arc<BeamGeometry>,
        (range_min, range_max): (f64, f64),
        ranges: impl IntoIterator<Item = f64>,
    ) -> Result<Self, ScanError> {
        let mut valid = 0;
        let ranges: Vec<f64> = ranges
            .into_iter()
            .map(|range| {
                let measured = range.is_finite() && range > 0.0 && range >= range_min && range <= range_max;
                valid += usize::from(measured);
                if measured { range } else { f64::NAN }
            })
            .collect();
        if ranges.len() != beams.len() {
            return Err(ScanError::AngleMismatch { beams: ranges.len(), expected: beams.len() as f64 });
        }
        if (valid as f64) < MIN_VALID_FRACTION * ranges.len() as f64 {
            return Err(ScanError::TooFewValid { valid, beams: ranges.len() });
        }
        Ok(Self { stamp, beams, ranges, valid, time_increment: 0.0 })
    }

    /// When the scan was taken.
    pub fn stamp(&self) -> Stamp {
        self.stamp
    }

    /// The same scan, its rays taken one after the other: `time_increment` s apart.
    #[must_use]
    pub fn with_time_increment(mut self, time_increment: f64) -> Self {
        self.time_increment = time_increment;
        self
    }

    /// Time from the first ray to the last, s.
    pub fn sweep_duration(&self) -> f64 {
        self.time_increment * self.len().saturating_sub(1) as f64
    }

    /// The scan as the laser would have seen it without moving on from where it was at the first ray: what each ray has met, seen from
    /// there. `twist`: of the laser, in its own frame; `sweep_duration`: from the first ray to the last, s.
    #[must_use]
    pub fn undistorted(&self, twist: &Twist2, sweep_duration: f64) -> Self {
        let (mut ranges, mut directions) = (self.ranges.clone(), self.beams.directions.clone());
        let time_increment = sweep_duration / self.len().saturating_sub(1).max(1) as f64;
        for (i, (range, direction)) in ranges.iter_mut().zip(&mut directions).enumerate() {
            let motion = twist.motion(i as f64 * time_increment).transform();
            if range.is_nan() {
                *direction = motion.rotate(*direction);
            } else {
                let point = motion.apply(*direction * *range);
                *range = point.norm();
                *direction = point / *range;
            }
        }
        let beams = BeamGeometry::about(self.beams.angle_min, self.beams.angle_increment, directions);
        Self { stamp: self.stamp, beams: Arc::new(beams), ranges, valid: self.valid, time_increment: 0.0 }
    }

    /// Directions of its beams.
    pub fn beams(&self) -> &BeamGeometry {
        &self.beams
    }

    /// Number of rays, with or without a measurement.
    pub fn len(&self) -> usize {
        self.ranges.len()
    }

    /// Whether the scan has no rays.
    pub fn is_empty(&self) -> bool {
        self.ranges.is_empty()
    }

    /// Number of rays that carry a measurement.
    pub fn valid_len(&self) -> usize {
        self.valid
    }

    /// Ranges in ray order, m; NaN where there is no measurement.
    pub fn ranges(&self) -> &[f64] {
        &self.ranges
    }

    /// The measured point of ray `i` in the laser's frame.
    pub fn point(&self, i: usize) -> Option<Point> {
        let range = *self.ranges.get(i)?;
        (!range.is_nan()).then(|| self.beams.directions()[i] * range)
    }

    /// The rays with a measurement: index, direction, range.
    pub fn rays(&self) -> impl Iterator<Item = (usize, Point, f64)> + '_ {
        self.ranges
            .iter()
            .zip(self.beams.directions())
            .enumerate()
            .filter(|(_, (range, _))| !range.is_nan())
            .map(|(i, (&range, &direction))| (i, direction, range))
    }
}

/// Turns messages of one laser into scans; keeps the beam directions while the geometry stays the same.
#[derive(Debug, Default)]
pub struct ScanConverter {
    beams: Option<Arc<BeamGeometry>>,
}

impl ScanConverter {
    /// Checks a message. `upside_down`: the laser is mounted on its head, its sweep seen from above runs the other way round.
    pub fn convert(&mut self, message: &LaserScan, upside_down: bool) -> Result<Scan, ScanError> {
        let side = if upside_down { -1.0 } else { 1.0 };
        check_header(message)?;
        let angle_min = side * f64::from(message.angle_min);
        let angle_increment = side * f64::from(message.angle_increment);
        let beams = self.beams(angle_min, angle_increment, message.ranges.len());
        let limits = (f64::from(message.range_min), f64::from(message.range_max));
        let ranges = message.ranges.iter().map(|&range| f64::from(range));
        let scan = Scan::new(message.header.stamp.into(), beams, limits, ranges)?;
        Ok(scan.with_time_increment(message.time_increment.into()))
    }

    fn beams(&mut self, angle_min: f64, angle_increment: f64, len: usize) -> Arc<BeamGeometry> {
        match &self.beams {
            Some(beams) if beams.is_of(angle_min, angle_increment, len) => Arc::clone(beams),
            _ => Arc::clone(self.beams.insert(Arc::new(BeamGeometry::new(angle_min, angle_increment, len)))),
        }
    }
}

fn check_header(message: &LaserScan) -> Result<(), ScanError> {
    let numbers = [
        ("angle_min", message.angle_min),
        ("angle_max", message.angle_max),
        ("angle_increment", message.angle_increment),
        ("range_min", message.range_min),
        ("range_max", message.range_max),
        ("time_increment", message.time_increment),
        ("scan_time", message.scan_time),
    ];
    for (field, value) in numbers {
        // Some drivers say "no upper limit" with an infinite range_max.
        let unlimited = field == "range_max" && value == f32::INFINITY;
        if !value.is_finite() && !unlimited {
            return Err(ScanError::NotFinite { field, value: value.into() });
        }
    }
    if message.angle_increment == 0.0 {
        return Err(ScanError::ZeroIncrement);
    }
    let beams = message.ranges.len();
    if !(MIN_BEAMS..=MAX_BEAMS).contains(&beams) {
        return Err(ScanError::BeamCount { beams });
    }
    let increment = f64::from(message.angle_increment);
    let expected = (f64::from(message.angle_max) - f64::from(message.angle_min)) / increment + 1.0;
    if (expected - beams as f64).abs() > BEAM_COUNT_TOLERANCE {
        return Err(ScanError::AngleMismatch { beams, expected });
    }
    let sweep = (beams - 1) as f64 * increment.abs();
    if sweep > TAU + FULL_TURN_TOLERANCE {
        return Err(ScanError::MoreThanATurn { degrees: sweep.to_degrees() });
    }
    let intensities = message.intensities.len();
    if intensities != 0 && intensities != beams {
        return Err(ScanError::IntensityMismatch { ranges: beams, intensities });
    }
    if message.range_max <= message.range_min || message.range_max <= 0.0 {
        return Err(ScanError::EmptyRangeInterval { min: message.range_min.into(), max: message.range_max.into() });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wall_seen_in_passing_is_straight_again() {
        // Past the wall y = 2 and turning: 20 ms from the first ray to the last.
        let twist = Twist2 { vx: 7.0, vy: 0.0, omega: 3.0 };
        let beams = BeamGeometry::new(0.6, 0.01, 181);
        let increment = 0.02 / 180.0;
        let range = |(i, direction): (usize, &Point)| {
            let motion = twist.motion(i as f64 * increment);
            (2.0 - motion.y) / motion.transform().rotate(*direction).y
        };
        let ranges = beams.directions().iter().enumerate().map(range).collect::<Vec<_>>();
        let scan = Scan::new(Stamp::default(), beams.into(), (0.0, 100.0), ranges).unwrap().with_time_increment(increment);
        let off = |scan: &Scan| (0..scan.len()).map(|i| (scan.point(i).unwrap().y - 2.0).abs()).fold(0.0, f64::max);
        let undistorted = scan.undistorted(&twist, scan.sweep_duration());
        assert!(off(&scan) > 0.05 && off(&undistorted) < 1e-9);
        assert!((scan.sweep_duration() - 0.02).abs() < 1e-12 && undistorted.sweep_duration() == 0.0);
    }
}
