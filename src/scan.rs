//! A laser scan, checked once and immutable afterwards.

mod mask;

use std::collections::HashSet;
use std::f64::consts::{FRAC_PI_2, TAU};
use std::mem::Discriminant;
use std::sync::Arc;

use thiserror::Error;

use crate::geometry::{Point, Twist2, wrap_angle};
use crate::messages::sensor_msgs::LaserScan;
use crate::quantile::quantile;
use crate::time::Stamp;
pub use mask::{Mask, ScanKnobs, Sector, Sectors};

/// Minimum number of beams of a scan.
pub const MIN_BEAMS: usize = 10;
/// Maximum number of beams of a scan.
pub const MAX_BEAMS: usize = 10_000;
/// Minimum usable range, m: ten standard deviations of typical range noise. Shorter ranges are mostly noise; a laser touching a
/// wall measures such ranges. Values from 0.06 to 0.2 work equally well.
pub const MIN_RANGE: f64 = 0.1;
/// Minimum fraction of the rays that must have a measurement.
pub const MIN_VALID_FRACTION: f64 = 0.1;
/// Minimum field of view in which equal ranges are suspicious, rad. Over a smaller angle, the rays may face a wall.
const MIN_WIDE_ANGLE: f64 = FRAC_PI_2;
/// Maximum difference of two equal ranges, m: the variation of the ranges of a covered laser.
const MAX_EQUAL_DIFFERENCE: f64 = 0.05;
/// Minimum fraction of rays with equal ranges that shows a surface moving with the laser.
const MIN_EQUAL_FRACTION: f64 = 0.95;
/// Minimum overlap of the fields of view of two scans of the same surroundings, rad; for narrow fields of view, half of the
/// narrower one suffices.
const MIN_VIEW_OVERLAP: f64 = 0.5;
/// Maximum excess of a sweep over a full turn plus one beam, rad: the rounding of the message's 32-bit angles. That one beam may
/// point in the direction of the first one.
const FULL_TURN_TOLERANCE: f64 = 1e-4;
/// Maximum duration of a sweep, s. A longer one is an error of the driver.
const MAX_SWEEP_DURATION: f64 = 1.0;
/// Maximum difference between the number of beams and the one computed from the angles, because drivers round either.
const BEAM_COUNT_TOLERANCE: f64 = 1.6;

/// A problem of a message that does not make the scan unusable. It is reported once, with the remedy.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum ScanWarning {
    /// The number of ranges does not match the angles.
    #[error(
        "{beams} ranges, but angle_min, angle_max and angle_increment give {expected:.1}: beam i is assumed to point to angle_min + i * angle_increment"
    )]
    BeamCount {
        /// Number of ranges.
        beams: usize,
        /// Number computed from the angles.
        expected: f64,
    },
    /// The time between two rays is not a number, or gives a sweep longer than the time between scans.
    #[error(
        "time_increment is {value}, but a sweep cannot take {seconds:.3} s: ignored, all rays are assumed to be simultaneous \
         (set odometry.scan_duration to the duration of a sweep)"
    )]
    TimeIncrement {
        /// Its value.
        value: f32,
        /// Duration of the sweep that it gives, s.
        seconds: f64,
    },
    /// An unused field is not a number.
    #[error("{field} is {value}: ignored")]
    Ignored {
        /// Name of the message field.
        field: &'static str,
        /// Its value.
        value: f32,
    },
    /// There are intensities, but not one for each range.
    #[error("{ranges} ranges but {intensities} intensities: the intensities are ignored")]
    Intensities {
        /// Number of ranges.
        ranges: usize,
        /// Number of intensities.
        intensities: usize,
    },
    /// Many rays have the same maximum range, which is less than `range_max`.
    #[error(
        "rays without a return seem to have a range of about {range:.2} m: they are not used as walls (range_max should be this value)"
    )]
    OutOfRangeMarker {
        /// The range.
        range: f64,
    },
}

/// Why a message is not a usable scan.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum ScanError {
    /// A header number is NaN or infinite.
    #[error("{field} is {value}: the driver must fill in a finite number")]
    NotFinite {
        /// Name of the message field.
        field: &'static str,
        /// Its value.
        value: f32,
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
    /// There is not one range for each beam.
    #[error("{ranges} ranges for {beams} beams")]
    RangeCount {
        /// Number of ranges.
        ranges: usize,
        /// Number of beams.
        beams: usize,
    },
    /// The beams sweep more than a full turn.
    #[error("the beams sweep {degrees:.1} degrees: more than a full turn")]
    MoreThanATurn {
        /// Angle between the first and the last beam.
        degrees: f64,
    },
    /// No range could be valid.
    #[error("range_min {min} m and range_max {max} m leave no range valid")]
    EmptyRangeInterval {
        /// `range_min`.
        min: f32,
        /// `range_max`.
        max: f32,
    },
    /// Too few rays have a measurement.
    #[error(
        "{valid} of {beams} rays have a measurement: at least 10 % are required (is the laser covered, or range_min/range_max wrong?)"
    )]
    TooFewValid {
        /// Rays with a measurement.
        valid: usize,
        /// All rays.
        beams: usize,
    },
    /// The ranges are equal in all directions.
    #[error("the rays measure about {range:.2} m in all directions, which does not constrain the motion (is the laser covered?)")]
    UniformRanges {
        /// The median range, m.
        range: f64,
    },
}

/// Directions of the beams of a scan, shared by all scans of the same laser.
#[derive(Clone, Debug, PartialEq)]
pub struct BeamGeometry {
    angle_min: f64,
    angle_increment: f64,
    directions: Vec<Point>,
    is_uniform: bool,
}

/// The field of view of a laser, rad.
struct FieldOfView {
    middle: f64,
    width: f64,
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
        Self { angle_min, angle_increment, directions, is_uniform: true }
    }

    /// Beam `i` points in direction `i`, which is approximately `angle_min + i * angle_increment`, rad.
    pub fn with_directions(angle_min: f64, angle_increment: f64, directions: Vec<Point>) -> Self {
        Self { angle_min, angle_increment, directions, is_uniform: false }
    }

    /// Number of beams.
    pub fn len(&self) -> usize {
        self.directions.len()
    }

    /// Whether there are no beams.
    pub fn is_empty(&self) -> bool {
        self.directions.is_empty()
    }

    /// Nominal direction of beam `i`, rad: exact for uniform beams, approximate for others.
    pub fn angle(&self, i: usize) -> f64 {
        self.angle_min + i as f64 * self.angle_increment
    }

    /// Angle from one beam to the next, rad; negative when the laser sweeps clockwise.
    pub fn angle_increment(&self) -> f64 {
        self.angle_increment
    }

    /// Whether the beams are exactly at their nominal directions; those of an undistorted scan are only approximately.
    pub fn is_uniform(&self) -> bool {
        self.is_uniform
    }

    /// Unit vectors of the beams.
    pub fn directions(&self) -> &[Point] {
        &self.directions
    }

    /// The field of view.
    fn view(&self) -> FieldOfView {
        let sweep = self.len().saturating_sub(1) as f64 * self.angle_increment;
        FieldOfView { middle: self.angle_min + 0.5 * sweep, width: sweep.abs() }
    }

    /// Angle from the last beam on to the first one, rad: the part of the full turn that the sweep leaves out. About zero or one
    /// increment for a laser with a 360 degree field of view.
    pub fn gap(&self) -> f64 {
        TAU - (self.len().saturating_sub(1)) as f64 * self.angle_increment.abs()
    }

    /// Whether the beams cover a full circle, so that the last beam and the first are neighbours.
    pub fn is_full_circle(&self) -> bool {
        self.gap() < 1.5 * self.angle_increment.abs()
    }

    fn matches(&self, angle_min: f64, angle_increment: f64, beams: usize) -> bool {
        self.len() == beams
            && self.angle_min.to_bits() == angle_min.to_bits()
            && self.angle_increment.to_bits() == angle_increment.to_bits()
    }
}

/// A checked scan: ranges in ray order; rays without a measurement keep their place.
#[derive(Clone, Debug)]
pub struct Scan {
    stamp: Stamp,
    beams: Arc<BeamGeometry>,
    ranges: Vec<f64>,
    valid: usize,
    /// Whether each ray was out of range: nothing within the maximum range.
    out_of_range: Vec<bool>,
    /// Maximum range of the laser, m.
    max_range: f64,
    /// Time from one ray to the next, s.
    time_increment: f64,
}

impl Scan {
    /// Creates a scan from ranges in metres. A ray is out of range (REP 117) if its range is above `range_max`. It has no
    /// measurement if its range is NaN, below `range_min` or [`MIN_RANGE`], or minus infinity.
    pub fn new(
        stamp: Stamp,
        beams: Arc<BeamGeometry>,
        (range_min, range_max): (f64, f64),
        ranges: impl IntoIterator<Item = f64>,
    ) -> Result<Self, ScanError> {
        let (mut valid, mut out_of_range) = (0, Vec::with_capacity(beams.len()));
        let ranges: Vec<f64> = ranges
            .into_iter()
            .map(|range| {
                let measured = range.is_finite() && range >= range_min.max(MIN_RANGE) && range <= range_max;
                valid += usize::from(measured);
                out_of_range.push(range > range_max || range == f64::INFINITY);
                if measured { range } else { f64::NAN }
            })
            .collect();
        if ranges.len() != beams.len() {
            return Err(ScanError::RangeCount { ranges: ranges.len(), beams: beams.len() });
        }
        if (valid as f64) < MIN_VALID_FRACTION * ranges.len() as f64 {
            return Err(ScanError::TooFewValid { valid, beams: ranges.len() });
        }
        Ok(Self { stamp, beams, ranges, valid, out_of_range, max_range: range_max, time_increment: 0.0 })
    }

    /// Rejects a scan whose rays all measure the same range over a wide field of view: no environment has walls at the same
    /// distance in all directions.
    pub fn reject_uniform(self) -> Result<Self, ScanError> {
        if self.valid as f64 * self.beams.angle_increment.abs() < MIN_WIDE_ANGLE {
            return Ok(self);
        }
        let mut readings: Vec<f64> = self.ranges.iter().copied().filter(|range| !range.is_nan()).collect();
        let Some(median) = quantile(&mut readings, 0.5, f64::total_cmp) else { return Ok(self) };
        let same = readings.iter().filter(|&range| (range - median).abs() < MAX_EQUAL_DIFFERENCE).count();
        if same as f64 >= MIN_EQUAL_FRACTION * self.valid as f64 {
            Err(ScanError::UniformRanges { range: median })
        } else {
            Ok(self)
        }
    }

    /// Removes the measurements that a mask excludes.
    pub fn masked(mut self, mask: &Mask) -> Result<Self, ScanError> {
        if mask.is_empty() {
            return Ok(self);
        }
        for (i, direction) in self.beams.directions.iter().enumerate() {
            let limit = mask.limit(direction);
            if self.ranges[i] <= limit {
                self.ranges[i] = f64::NAN;
                self.valid -= 1;
            }
            self.out_of_range[i] &= limit < f64::INFINITY;
        }
        if (self.valid as f64) < MIN_VALID_FRACTION * self.len() as f64 {
            return Err(ScanError::TooFewValid { valid: self.valid, beams: self.len() });
        }
        Ok(self)
    }

    /// Stamp of the scan.
    pub fn stamp(&self) -> Stamp {
        self.stamp
    }

    /// Maximum range of the laser, m: rays that would measure more are out of range.
    pub fn max_range(&self) -> f64 {
        self.max_range
    }

    /// The same scan with its rays taken one after the other, `time_increment` s apart.
    #[must_use]
    pub fn with_time_increment(mut self, time_increment: f64) -> Self {
        self.time_increment = time_increment;
        self
    }

    /// Time from the first ray to the last, s.
    pub fn sweep_duration(&self) -> f64 {
        self.time_increment * self.len().saturating_sub(1) as f64
    }

    /// Undistorts the scan: returns it as the laser would have measured it from its pose at the scan's stamp. `twist` is that of
    /// the laser, in its own frame. The first ray was taken `first_ray` s after the stamp, the last one `sweep_duration` s after
    /// the first one, or before it if negative.
    #[must_use]
    pub fn undistorted(&self, twist: &Twist2, first_ray: f64, sweep_duration: f64) -> Self {
        let (mut ranges, mut directions) = (self.ranges.clone(), self.beams.directions.clone());
        let time_increment = sweep_duration / self.len().saturating_sub(1).max(1) as f64;
        for (i, (range, direction)) in ranges.iter_mut().zip(&mut directions).enumerate() {
            let motion = twist.motion(first_ray + i as f64 * time_increment).transform();
            if range.is_nan() {
                *direction = motion.rotate(*direction);
            } else {
                let point = motion.apply(*direction * *range);
                *range = point.norm();
                *direction = point / *range;
            }
        }
        let beams = Arc::new(BeamGeometry::with_directions(self.beams.angle_min, self.beams.angle_increment, directions));
        let out_of_range = self.out_of_range.clone();
        Self { stamp: self.stamp, beams, ranges, valid: self.valid, out_of_range, max_range: self.max_range, time_increment: 0.0 }
    }

    /// Whether the field of view of another scan overlaps with this one's. The other scan was taken nearby, with the laser
    /// rotated by `rotation` relative to this one.
    ///
    /// ```
    /// use anytime_scan_matcher::scan::{BeamGeometry, Scan};
    /// use anytime_scan_matcher::time::Stamp;
    ///
    /// let beams = BeamGeometry::new(-1.57, 0.0174, 181); // to the front, 180 degrees
    /// let scan = Scan::new(Stamp::default(), beams.into(), (0.1, 30.0), vec![2.0; 181]).unwrap();
    /// assert!(scan.shares_view_with(&scan, 1.57) && !scan.shares_view_with(&scan, 3.14));
    /// ```
    pub fn shares_view_with(&self, other: &Self, rotation: f64) -> bool {
        let (own, others) = (self.beams.view(), other.beams.view());
        let between = wrap_angle(rotation + others.middle - own.middle).abs();
        let within = 0.5 * (own.width + others.width);
        let overlap = (within - between).max(0.0) + (within - (TAU - between)).max(0.0);
        overlap >= MIN_VIEW_OVERLAP.min(0.5 * own.width.min(others.width))
    }

    /// Directions of the beams.
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

    /// Number of rays with a measurement.
    pub fn valid_len(&self) -> usize {
        self.valid
    }

    /// Whether ray `i` was out of range: nothing within the laser's maximum range.
    pub fn is_out_of_range(&self, i: usize) -> bool {
        self.out_of_range.get(i).is_some_and(|&is_out_of_range| is_out_of_range)
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

/// Converts messages into scans; keeps the beam directions while the geometry stays the same.
#[derive(Debug, Default)]
pub struct ScanConverter {
    /// Frame of the laser that `out_of_range` and `intervals` describe.
    frame: String,
    beams: Option<Arc<BeamGeometry>>,
    out_of_range: OutOfRangeDetector,
    intervals: ScanIntervals,
    mask: Mask,
    reported: HashSet<Discriminant<ScanWarning>>,
    warnings: Vec<ScanWarning>,
}

impl ScanConverter {
    /// A converter that masks rays according to these parameters.
    pub fn new(knobs: &ScanKnobs) -> Self {
        Self { mask: Mask::new(knobs), ..Self::default() }
    }

    /// The mask of the rays that are used.
    pub fn mask(&self) -> &Mask {
        &self.mask
    }

    /// Checks and converts a message. `upside_down`: the laser is mounted upside down, so that its sweep, seen from above, has
    /// the opposite direction.
    pub fn convert(&mut self, message: &LaserScan, upside_down: bool) -> Result<Scan, ScanError> {
        let side = if upside_down { -1.0 } else { 1.0 };
        check_header(message)?;
        if self.frame != message.header.frame_id {
            self.frame.clone_from(&message.header.frame_id);
            (self.out_of_range, self.intervals) = Default::default();
        }
        self.intervals.add(message.header.stamp.into());
        self.check_fields(message);
        let angle_min = side * f64::from(message.angle_min);
        let angle_increment = side * f64::from(message.angle_increment);
        let beams = self.beams(angle_min, angle_increment, message.ranges.len());
        let range_max = self.out_of_range.threshold(message);
        if let Some(range) = self.out_of_range.marker {
            self.warn(ScanWarning::OutOfRangeMarker { range });
        }
        let limits = (f64::from(message.range_min), range_max.next_down());
        let ranges = message.ranges.iter().map(|&range| f64::from(range));
        let scan = Scan::new(message.header.stamp.into(), beams, limits, ranges)?.masked(&self.mask)?;
        Ok(scan.with_time_increment(if self.is_sweep(message) { message.time_increment.into() } else { 0.0 }))
    }

    /// Takes the warnings since the last call; each kind is reported once.
    pub fn take_warnings(&mut self) -> Vec<ScanWarning> {
        std::mem::take(&mut self.warnings)
    }

    fn warn(&mut self, warning: ScanWarning) {
        if self.reported.insert(std::mem::discriminant(&warning)) {
            self.warnings.push(warning);
        }
    }

    /// Warns of wrong fields that are not needed for matching.
    fn check_fields(&mut self, message: &LaserScan) {
        let (beams, intensities) = (message.ranges.len(), message.intensities.len());
        let expected = (f64::from(message.angle_max) - f64::from(message.angle_min)) / f64::from(message.angle_increment) + 1.0;
        let fits = (expected - beams as f64).abs() <= BEAM_COUNT_TOLERANCE;
        if !fits {
            self.warn(ScanWarning::BeamCount { beams, expected });
        }
        if !message.scan_time.is_finite() {
            self.warn(ScanWarning::Ignored { field: "scan_time", value: message.scan_time });
        }
        if !self.is_sweep(message) {
            self.warn(ScanWarning::TimeIncrement { value: message.time_increment, seconds: sweep(message) });
        }
        if intensities != 0 && intensities != beams {
            self.warn(ScanWarning::Intensities { ranges: beams, intensities });
        }
    }

    /// Whether the time increment of the message is plausible.
    fn is_sweep(&self, message: &LaserScan) -> bool {
        sweep(message) <= self.intervals.max_sweep_duration().min(MAX_SWEEP_DURATION)
    }

    fn beams(&mut self, angle_min: f64, angle_increment: f64, len: usize) -> Arc<BeamGeometry> {
        match &self.beams {
            Some(beams) if beams.matches(angle_min, angle_increment, len) => Arc::clone(beams),
            _ => Arc::clone(self.beams.insert(Arc::new(BeamGeometry::new(angle_min, angle_increment, len)))),
        }
    }
}

/// Finds the range from which on a ray counts as out of range. For rays without a return, drivers and simulators write `inf` (REP
/// 117), `range_max`, slightly less, or a value of their own, with or without noise.
#[derive(Debug, Default)]
struct OutOfRangeDetector {
    /// The driver's own value for rays without a return: the maximum range that many rays have had at once, m.
    marker: Option<f64>,
}

impl OutOfRangeDetector {
    /// Maximum relative difference of equal readings: it covers a value that was rounded, shifted or had noise added.
    const MAX_RELATIVE_DIFFERENCE: f64 = 0.004;
    /// Maximum angle over which walls have equal ranges, rad. A flat wall has equal ranges within `2 sqrt(2
    /// MAX_RELATIVE_DIFFERENCE)` rad, 10 degrees, and two walls can be at the same distance, one at either end of a corridor.
    const MAX_WALL_ANGLE: f64 = 0.36;
    /// Maximum relative difference of a range from `range_max` that still counts as `range_max`.
    const RANGE_MAX_TOLERANCE: f64 = 0.002;

    /// The minimum range that counts as out of range.
    fn threshold(&mut self, message: &LaserScan) -> f64 {
        let limit = f64::from(message.range_max) * (1.0 - Self::RANGE_MAX_TOLERANCE);
        let range_min = f64::from(message.range_min).max(0.0);
        let readings =
            || message.ranges.iter().map(|&range| f64::from(range)).filter(|&range| range > range_min && range < limit);
        let max_range = readings().fold(0.0, f64::max);
        let is_equal = |range: f64, marker: f64| range >= (1.0 - Self::MAX_RELATIVE_DIFFERENCE) * marker;
        self.marker.take_if(|marker| max_range > *marker * (1.0 + Self::MAX_RELATIVE_DIFFERENCE)); // a ray measured more, so it is not a marker
        let rays = readings().filter(|&range| is_equal(range, max_range)).count();
        let is_wide = rays as f64 * f64::from(message.angle_increment).abs() > Self::MAX_WALL_ANGLE;
        if self.marker.is_none() && is_wide && rays >= MIN_BEAMS {
            self.marker = Some(max_range);
        }
        self.marker.map_or(limit, |marker| limit.min((1.0 - Self::MAX_RELATIVE_DIFFERENCE) * marker))
    }
}

/// Duration of the sweep of a message according to its time increment, s.
fn sweep(message: &LaserScan) -> f64 {
    f64::from(message.time_increment).abs() * message.ranges.len() as f64
}

/// The time between the scans of a laser: a sweep cannot last longer than until the next one begins.
#[derive(Debug, Default)]
struct ScanIntervals {
    /// Stamp of the last scan.
    stamp: Option<Stamp>,
    /// Times between the last consecutive scans of the laser, s.
    intervals: [f64; Self::KEPT],
    /// Number of intervals so far.
    count: usize,
}

impl ScanIntervals {
    /// Number of intervals that are kept.
    const KEPT: usize = 10;
    /// Minimum number of intervals to limit the sweep: the stamps of two scans may be too close to each other.
    const MIN_COUNT: usize = 3;
    /// Maximum relative difference between the clocks of laser and computer.
    const TOLERANCE: f64 = 0.1;

    fn add(&mut self, stamp: Stamp) {
        let since_last = self.stamp.replace(stamp).map(|last| stamp.seconds_since(last));
        if let Some(seconds) = since_last.filter(|seconds| *seconds > 0.0) {
            self.intervals[self.count % Self::KEPT] = seconds;
            self.count += 1;
        }
    }

    /// The maximum duration of a sweep, s.
    fn max_sweep_duration(&self) -> f64 {
        let known = &self.intervals[..self.count.min(Self::KEPT)];
        let max_interval = known.iter().fold(0.0, |max_interval: f64, seconds| max_interval.max(*seconds));
        if known.len() < Self::MIN_COUNT { f64::INFINITY } else { max_interval * (1.0 + Self::TOLERANCE) }
    }
}

fn check_header(message: &LaserScan) -> Result<(), ScanError> {
    let numbers = [
        ("angle_min", message.angle_min),
        ("angle_increment", message.angle_increment),
        ("range_min", message.range_min),
        ("range_max", message.range_max),
    ];
    for (field, value) in numbers {
        // Some drivers express "no upper limit" by an infinite range_max.
        let unlimited = field == "range_max" && value == f32::INFINITY;
        if !value.is_finite() && !unlimited {
            return Err(ScanError::NotFinite { field, value });
        }
    }
    if message.angle_increment == 0.0 {
        return Err(ScanError::ZeroIncrement);
    }
    let beams = message.ranges.len();
    if !(MIN_BEAMS..=MAX_BEAMS).contains(&beams) {
        return Err(ScanError::BeamCount { beams });
    }
    let increment = f64::from(message.angle_increment).abs();
    let sweep = (beams - 1) as f64 * increment;
    if sweep > TAU + increment + FULL_TURN_TOLERANCE {
        return Err(ScanError::MoreThanATurn { degrees: sweep.to_degrees() });
    }
    if message.range_max <= message.range_min || message.range_max <= 0.0 {
        return Err(ScanError::EmptyRangeInterval { min: message.range_min, max: message.range_max });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wall_scanned_while_driving_is_straight_after_undistortion() {
        // The laser passes the wall y = 2 and rotates: 20 ms from the first ray to the last.
        let twist = Twist2 { vx: 7.0, vy: 0.0, omega: 3.0 };
        let beams = BeamGeometry::new(0.6, 0.01, 181);
        let increment = 0.02 / 180.0;
        let range = |(i, direction): (usize, &Point)| {
            let motion = twist.motion(i as f64 * increment);
            (2.0 - motion.y) / motion.transform().rotate(*direction).y
        };
        let ranges = beams.directions().iter().enumerate().map(range).collect::<Vec<_>>();
        let scan = Scan::new(Stamp::default(), beams.into(), (0.0, 100.0), ranges).unwrap().with_time_increment(increment);
        let error = |scan: &Scan| (0..scan.len()).map(|i| (scan.point(i).unwrap().y - 2.0).abs()).fold(0.0, f64::max);
        let undistorted = scan.undistorted(&twist, 0.0, scan.sweep_duration());
        assert!(error(&scan) > 0.05 && error(&undistorted) < 1e-9);
        assert!((scan.sweep_duration() - 0.02).abs() < 1e-12 && undistorted.sweep_duration() == 0.0);
    }

    /// A message of a laser with one beam per degree: walls at 5 m, and `far` beams from the middle on at 51.1 m.
    fn message(frame: &str, far: usize) -> LaserScan {
        let mut message = LaserScan { range_max: 80.0, ..LaserScan::default() };
        (message.angle_min, message.angle_max, message.angle_increment) = (-1.575, 1.575, 0.0175);
        message.header.frame_id = frame.into();
        message.ranges = (0..181).map(|i| if (90..90 + far).contains(&i) { 51.1 } else { 5.0 + 0.01 * i as f32 }).collect();
        message
    }

    #[test]
    fn a_range_that_many_rays_have_at_once_is_not_a_wall_but_that_of_one_wall_is() {
        let mut converter = ScanConverter::default();
        for _ in 0..100 {
            assert_eq!(converter.convert(&message("laser", 20), false).unwrap().valid_len(), 181, "a wall 20 degrees wide");
        }
        assert_eq!(converter.take_warnings(), []);
        let scan = converter.convert(&message("laser", 21), false).unwrap();
        assert!(scan.valid_len() == 160 && scan.is_out_of_range(90));
        assert!(
            matches!(converter.take_warnings()[..], [ScanWarning::OutOfRangeMarker { range }] if (range - 51.1).abs() < 1e-5)
        );
        assert_eq!(converter.convert(&message("laser", 1), false).unwrap().valid_len(), 180, "the value is known now");
    }

    #[test]
    fn the_out_of_range_value_of_one_laser_is_not_used_for_another() {
        let mut converter = ScanConverter::default();
        assert_eq!(converter.convert(&message("front", 60), false).unwrap().valid_len(), 121);
        assert_eq!(converter.convert(&message("rear", 10), false).unwrap().valid_len(), 181, "a wall of the other laser");
    }

    /// The scan of a laser with one beam per degree over this many degrees that measures `range` in the direction `angle` (rad).
    fn scan_of(degrees: usize, range: impl Fn(f64) -> f64) -> Result<Scan, ScanError> {
        let beams = BeamGeometry::new(-(degrees as f64 / 2.0).to_radians(), 1_f64.to_radians(), degrees);
        let ranges: Vec<f64> = (0..degrees).map(|i| range(beams.angle(i))).collect();
        Scan::new(Stamp::default(), beams.into(), (0.05, 30.0), ranges)?.reject_uniform()
    }

    #[test]
    fn scans_of_a_surface_that_moves_with_the_laser_are_rejected() {
        for (range, noise) in [(0.12, 0.01), (0.5, 0.05), (2.0, 0.01)] {
            // Pseudo-noise: the digits of a sine.
            let noisy = |angle: f64| range + noise * (1e4 * angle).sin();
            let is_uniform =
                |scan| matches!(scan, Err(ScanError::UniformRanges { range: reported }) if (reported - range).abs() < noise);
            assert!(is_uniform(scan_of(270, noisy)), "{range} m");
            assert!(is_uniform(scan_of(360, |angle| if angle.abs() < 0.1 { 5.0 } else { noisy(angle) })), "{range} m, and a gap");
        }
        assert!(scan_of(60, |angle| 2.0 / angle.cos()).is_ok(), "a wall in a narrow field of view");
        assert!(scan_of(90, |angle| 0.5 / angle.cos()).is_ok(), "a near wall");
        assert!(scan_of(360, |angle| 1.0 / angle.cos().abs().max(angle.sin().abs())).is_ok(), "in the middle of a square");
        let in_arena = |angle: f64| 0.2 * angle.cos() + (25.0 - (0.2 * angle.sin()).powi(2)).sqrt();
        assert!(scan_of(360, in_arena).is_ok(), "20 cm from the middle of a round arena");
    }
}
