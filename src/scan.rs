//! A laser scan, checked once and immutable from then on.

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

/// Fewest beams a scan may have.
pub const MIN_BEAMS: usize = 10;
/// Most beams a scan may have.
pub const MAX_BEAMS: usize = 10_000;
/// A shorter range says less of where something is than of its own noise, m: ten standard deviations of what lasers usually err by. A laser
/// in a wall sees such. From 6 to 20 cm do alike.
pub const SHORTEST_RANGE: f64 = 0.1;
/// Least part of the rays that must carry a measurement.
pub const MIN_VALID_FRACTION: f64 = 0.1;
/// Rays over less than this angle may all read much the same: they face a wall, rad.
const WIDE: f64 = FRAC_PI_2;
/// A reading is much the same as another within this, m: what the ranges of a covered laser vary by.
const SAME_RANGE: f64 = 0.05;
/// So many of the rays read the same where the surface that they meet goes along with the laser.
const ALL_ROUND: f64 = 0.95;
/// Scans that share less of their directions are of different things, rad; of narrow views half must do.
const LEAST_SHARED_VIEW: f64 = 0.5;
/// A sweep may exceed a full turn by a beam, which then looks where the first one does, and by this much, rad: the rounding of the
/// message's 32-bit angles.
const FULL_TURN_TOLERANCE: f64 = 1e-4;
/// A sweep that takes longer is a mistake of the driver, s.
const LONGEST_SWEEP: f64 = 1.0;
/// Drivers round the number of beams or the last angle: the two may disagree by this many beams.
const BEAM_COUNT_TOLERANCE: f64 = 1.6;

/// Something odd in a message that keeps no scan from being used: said once, with the remedy.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum Oddity {
    /// The number of ranges is not what the angles say.
    #[error(
        "{beams} ranges, but angle_min, angle_max and angle_increment make {expected:.1}: beam i is taken to point to angle_min + i * angle_increment"
    )]
    BeamCount {
        /// Number of ranges.
        beams: usize,
        /// Number that the angles give.
        expected: f64,
    },
    /// The time between two rays is no number, or one by which a sweep takes longer than there is from one scan to the next.
    #[error(
        "time_increment is {value}, but a sweep cannot take {seconds:.3} s: ignored, all rays are taken to be of one moment \
         (odometry.scan_duration can say how long a sweep takes)"
    )]
    TimeIncrement {
        /// Its value.
        value: f32,
        /// How long a sweep would take, s.
        seconds: f64,
    },
    /// A number that nothing depends on is none.
    #[error("{field} is {value}: ignored")]
    Ignored {
        /// Name of the message field.
        field: &'static str,
        /// Its value.
        value: f32,
    },
    /// Intensities are there, but not one for every range.
    #[error("{ranges} ranges but {intensities} intensities: these are ignored")]
    Intensities {
        /// Number of ranges.
        ranges: usize,
        /// Number of intensities.
        intensities: usize,
    },
    /// Many rays carry the same greatest range, which is less than `range_max`.
    #[error("rays that see nothing seem to carry a range of about {range:.2} m: they are no walls (range_max should be that)")]
    NothingSeen {
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
        min: f32,
        /// `range_max`.
        max: f32,
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
    /// What is seen is the same in every direction.
    #[error("the rays read about {range:.2} m in whatever direction, which says nothing of a motion (is the laser covered?)")]
    SameAllRound {
        /// What most of them read, m.
        range: f64,
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

/// The directions that a laser looks in, rad.
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

    /// Direction of beam `i` by its index, rad: of beams that are not even, about.
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

    /// The directions it looks in.
    fn view(&self) -> FieldOfView {
        let sweep = self.len().saturating_sub(1) as f64 * self.angle_increment;
        FieldOfView { middle: self.angle_min + 0.5 * sweep, width: sweep.abs() }
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
    /// The rays that met nothing within reach.
    nothing_seen: Vec<bool>,
    /// How far the laser sees, m.
    reach: f64,
    /// From one ray to the next, s.
    time_increment: f64,
}

impl Scan {
    /// A scan from ranges in metres. A ray saw nothing (REP 117) when its range is above `range_max`. It is without a measurement when its
    /// range is NaN, below `range_min` or [`SHORTEST_RANGE`], or minus infinity.
    pub fn new(
        stamp: Stamp,
        beams: Arc<BeamGeometry>,
        (range_min, range_max): (f64, f64),
        ranges: impl IntoIterator<Item = f64>,
    ) -> Result<Self, ScanError> {
        let (mut valid, mut nothing_seen) = (0, Vec::with_capacity(beams.len()));
        let ranges: Vec<f64> = ranges
            .into_iter()
            .map(|range| {
                let measured = range.is_finite() && range >= range_min.max(SHORTEST_RANGE) && range <= range_max;
                valid += usize::from(measured);
                nothing_seen.push(range > range_max || range == f64::INFINITY);
                if measured { range } else { f64::NAN }
            })
            .collect();
        if ranges.len() != beams.len() {
            return Err(ScanError::RangeCount { ranges: ranges.len(), beams: beams.len() });
        }
        if (valid as f64) < MIN_VALID_FRACTION * ranges.len() as f64 {
            return Err(ScanError::TooFewValid { valid, beams: ranges.len() });
        }
        Ok(Self { stamp, beams, ranges, valid, nothing_seen, reach: range_max, time_increment: 0.0 })
    }

    /// Refuses a scan whose rays all read the same, though they look far to either side: no room has the laser in the middle of its every
    /// wall.
    pub fn of_surroundings(self) -> Result<Self, ScanError> {
        if self.valid as f64 * self.beams.angle_increment.abs() < WIDE {
            return Ok(self);
        }
        let mut readings: Vec<f64> = self.ranges.iter().copied().filter(|range| !range.is_nan()).collect();
        let Some(median) = quantile(&mut readings, 0.5, f64::total_cmp) else { return Ok(self) };
        let same = readings.iter().filter(|&range| (range - median).abs() < SAME_RANGE).count();
        if same as f64 >= ALL_ROUND * self.valid as f64 { Err(ScanError::SameAllRound { range: median }) } else { Ok(self) }
    }

    /// The same scan without the readings that a mask lets go.
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
            self.nothing_seen[i] &= limit < f64::INFINITY;
        }
        if (self.valid as f64) < MIN_VALID_FRACTION * self.len() as f64 {
            return Err(ScanError::TooFewValid { valid: self.valid, beams: self.len() });
        }
        Ok(self)
    }

    /// When the scan was taken.
    pub fn stamp(&self) -> Stamp {
        self.stamp
    }

    /// How far the laser sees, m: rays that would go farther saw nothing.
    pub fn reach(&self) -> f64 {
        self.reach
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

    /// The scan as the laser would have seen it from where it was at the scan's stamp. `twist`: of the laser, in its own frame. The first
    /// ray was taken `first_ray` s after the stamp, the last one `sweep_duration` s after the first, which may be before it.
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
        let beams = Arc::new(BeamGeometry::about(self.beams.angle_min, self.beams.angle_increment, directions));
        let nothing_seen = self.nothing_seen.clone();
        Self { stamp: self.stamp, beams, ranges, valid: self.valid, nothing_seen, reach: self.reach, time_increment: 0.0 }
    }

    /// Whether another scan, taken near by with the laser turned by `turn` against this one, looks in some of the same directions.
    ///
    /// ```
    /// use anytime_scan_matcher::scan::{BeamGeometry, Scan};
    /// use anytime_scan_matcher::time::Stamp;
    ///
    /// let beams = BeamGeometry::new(-1.57, 0.0174, 181); // to the front, 180 degrees
    /// let scan = Scan::new(Stamp::default(), beams.into(), (0.1, 30.0), vec![2.0; 181]).unwrap();
    /// assert!(scan.shares_view_with(&scan, 1.57) && !scan.shares_view_with(&scan, 3.14));
    /// ```
    pub fn shares_view_with(&self, other: &Self, turn: f64) -> bool {
        let (own, others) = (self.beams.view(), other.beams.view());
        let apart = wrap_angle(turn + others.middle - own.middle).abs();
        let within = 0.5 * (own.width + others.width);
        let shared = (within - apart).max(0.0) + (within - (TAU - apart)).max(0.0);
        shared >= LEAST_SHARED_VIEW.min(0.5 * own.width.min(others.width))
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

    /// Whether ray `i` met nothing within the laser's reach.
    pub fn saw_nothing(&self, i: usize) -> bool {
        self.nothing_seen.get(i).is_some_and(|&nothing| nothing)
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
    reach: Reach,
    pace: Pace,
    mask: Mask,
    said: HashSet<Discriminant<Oddity>>,
    oddities: Vec<Oddity>,
}

impl ScanConverter {
    /// A converter whose scans have the rays that these knobs let count.
    pub fn new(knobs: &ScanKnobs) -> Self {
        Self { mask: Mask::new(knobs), ..Self::default() }
    }

    /// The rays that count.
    pub fn mask(&self) -> &Mask {
        &self.mask
    }

    /// Checks a message. `upside_down`: the laser is mounted on its head, its sweep seen from above runs the other way round.
    pub fn convert(&mut self, message: &LaserScan, upside_down: bool) -> Result<Scan, ScanError> {
        let side = if upside_down { -1.0 } else { 1.0 };
        check_header(message)?;
        self.pace.add(message);
        self.note_oddities(message);
        let angle_min = side * f64::from(message.angle_min);
        let angle_increment = side * f64::from(message.angle_increment);
        let beams = self.beams(angle_min, angle_increment, message.ranges.len());
        let range_max = self.reach.least_of_nothing(message);
        if let Some(range) = self.reach.marker {
            self.note(Oddity::NothingSeen { range });
        }
        let limits = (f64::from(message.range_min), range_max.next_down());
        let ranges = message.ranges.iter().map(|&range| f64::from(range));
        let scan = Scan::new(message.header.stamp.into(), beams, limits, ranges)?.masked(&self.mask)?;
        Ok(scan.with_time_increment(if self.is_sweep(message) { message.time_increment.into() } else { 0.0 }))
    }

    /// What was odd in the messages since the last call, each kind of it once.
    pub fn take_oddities(&mut self) -> Vec<Oddity> {
        std::mem::take(&mut self.oddities)
    }

    fn note(&mut self, oddity: Oddity) {
        if self.said.insert(std::mem::discriminant(&oddity)) {
            self.oddities.push(oddity);
        }
    }

    /// What matching does not need is not refused for.
    fn note_oddities(&mut self, message: &LaserScan) {
        let (beams, intensities) = (message.ranges.len(), message.intensities.len());
        let expected = (f64::from(message.angle_max) - f64::from(message.angle_min)) / f64::from(message.angle_increment) + 1.0;
        let fits = (expected - beams as f64).abs() <= BEAM_COUNT_TOLERANCE;
        if !fits {
            self.note(Oddity::BeamCount { beams, expected });
        }
        if !message.scan_time.is_finite() {
            self.note(Oddity::Ignored { field: "scan_time", value: message.scan_time });
        }
        if !self.is_sweep(message) {
            self.note(Oddity::TimeIncrement { value: message.time_increment, seconds: sweep(message) });
        }
        if intensities != 0 && intensities != beams {
            self.note(Oddity::Intensities { ranges: beams, intensities });
        }
    }

    /// Whether its rays can have been taken one after the other as it says.
    fn is_sweep(&self, message: &LaserScan) -> bool {
        sweep(message) <= self.pace.longest().min(LONGEST_SWEEP)
    }

    fn beams(&mut self, angle_min: f64, angle_increment: f64, len: usize) -> Arc<BeamGeometry> {
        match &self.beams {
            Some(beams) if beams.is_of(angle_min, angle_increment, len) => Arc::clone(beams),
            _ => Arc::clone(self.beams.insert(Arc::new(BeamGeometry::new(angle_min, angle_increment, len)))),
        }
    }
}

/// From which range on a ray of a laser saw nothing. Drivers and simulators write `inf` there (REP 117), `range_max`, a hair less, or a
/// number of their own, with or without noise.
#[derive(Debug, Default)]
struct Reach {
    /// A number of the driver's own: the greatest range that many rays have had at once, m.
    marker: Option<f64>,
}

impl Reach {
    /// Readings this much alike, as a part of them, are one: what is left of a number that was rounded, shifted or had noise added.
    const ALIKE: f64 = 0.004;
    /// A flat wall has ranges that are so much alike within `2 sqrt(2 ALIKE)` rad, 10 degrees. Two of them can be seen at the same distance,
    /// one at either end of a corridor; no more rays than that are walls.
    const WIDEST_WALLS: f64 = 0.36;
    /// A range this near to `range_max`, as a part of it, cannot be told from it.
    const HAIR: f64 = 0.002;

    /// The least range that means nothing was seen.
    fn least_of_nothing(&mut self, message: &LaserScan) -> f64 {
        let limit = f64::from(message.range_max) * (1.0 - Self::HAIR);
        let least = f64::from(message.range_min).max(0.0);
        let readings = || message.ranges.iter().map(|&range| f64::from(range)).filter(|&range| range > least && range < limit);
        let greatest = readings().fold(0.0, f64::max);
        let alike = |range: f64, marker: f64| range >= (1.0 - Self::ALIKE) * marker;
        self.marker.take_if(|marker| greatest > *marker * (1.0 + Self::ALIKE)); // something was seen beyond it
        let rays = readings().filter(|&range| alike(range, greatest)).count();
        let is_wide = rays as f64 * f64::from(message.angle_increment).abs() > Self::WIDEST_WALLS;
        if self.marker.is_none() && is_wide && rays >= MIN_BEAMS {
            self.marker = Some(greatest);
        }
        self.marker.map_or(limit, |marker| limit.min((1.0 - Self::ALIKE) * marker))
    }
}

/// How long its rays have taken one after the other as it says, s.
fn sweep(message: &LaserScan) -> f64 {
    f64::from(message.time_increment).abs() * message.ranges.len() as f64
}

/// How a laser's scans follow one another: a sweep begins when the one before is over.
#[derive(Debug, Default)]
struct Pace {
    frame: String,
    stamp: Option<Stamp>,
    /// Times between the last scans that the same laser took in a row, s.
    intervals: [f64; Self::KEPT],
    /// How many there have been.
    count: usize,
}

impl Pace {
    const KEPT: usize = 10;
    /// So many tell how long a sweep can take: stamps of two scans may be too near to one another.
    const ENOUGH: usize = 3;
    /// Clocks of laser and computer differ by less, as a part.
    const TOLERANCE: f64 = 0.1;

    fn add(&mut self, message: &LaserScan) {
        let stamp = message.header.stamp.into();
        if self.frame != message.header.frame_id {
            *self = Self { frame: message.header.frame_id.clone(), ..Self::default() };
        }
        let since_last = self.stamp.replace(stamp).map(|last| stamp.seconds_since(last));
        if let Some(seconds) = since_last.filter(|seconds| *seconds > 0.0) {
            self.intervals[self.count % Self::KEPT] = seconds;
            self.count += 1;
        }
    }

    /// No sweep takes longer, s.
    fn longest(&self) -> f64 {
        let known = &self.intervals[..self.count.min(Self::KEPT)];
        let longest = known.iter().fold(0.0, |longest: f64, seconds| longest.max(*seconds));
        if known.len() < Self::ENOUGH { f64::INFINITY } else { longest * (1.0 + Self::TOLERANCE) }
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
        // Some drivers say "no upper limit" with an infinite range_max.
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
        let undistorted = scan.undistorted(&twist, 0.0, scan.sweep_duration());
        assert!(off(&scan) > 0.05 && off(&undistorted) < 1e-9);
        assert!((scan.sweep_duration() - 0.02).abs() < 1e-12 && undistorted.sweep_duration() == 0.0);
    }

    /// A laser with a beam for each degree, over so many degrees, that reads `range` in the direction `angle` (rad).
    fn seen(degrees: usize, range: impl Fn(f64) -> f64) -> Result<Scan, ScanError> {
        let beams = BeamGeometry::new(-(degrees as f64 / 2.0).to_radians(), 1_f64.to_radians(), degrees);
        let ranges: Vec<f64> = (0..degrees).map(|i| range(beams.angle(i))).collect();
        Scan::new(Stamp::default(), beams.into(), (0.05, 30.0), ranges)?.of_surroundings()
    }

    #[test]
    fn a_surface_that_goes_along_with_the_laser_says_nothing() {
        for (range, noise) in [(0.12, 0.01), (0.5, 0.05), (2.0, 0.01)] {
            // What passes for noise here: the digits of a sine.
            let noisy = |angle: f64| range + noise * (1e4 * angle).sin();
            let same = |seen| matches!(seen, Err(ScanError::SameAllRound { range: said }) if (said - range).abs() < noise);
            assert!(same(seen(270, noisy)), "{range} m");
            assert!(same(seen(360, |angle| if angle.abs() < 0.1 { 5.0 } else { noisy(angle) })), "{range} m, and a gap");
        }
        assert!(seen(60, |angle| 2.0 / angle.cos()).is_ok(), "a wall before a laser with a narrow view");
        assert!(seen(90, |angle| 0.5 / angle.cos()).is_ok(), "a wall at hand");
        assert!(seen(360, |angle| 1.0 / angle.cos().abs().max(angle.sin().abs())).is_ok(), "in the middle of a square");
        let in_arena = |angle: f64| 0.2 * angle.cos() + (25.0 - (0.2 * angle.sin()).powi(2)).sqrt();
        assert!(seen(360, in_arena).is_ok(), "20 cm from the middle of a round arena");
    }
}
