//! Rays that hit the robot itself.
//!
//! A part of the robot keeps its bearing and range while the robot moves. A wall keeps its range only while the robot drives along it,
//! not while it turns. A reading is therefore a self-hit if it recurs both along the path and during rotations.

use std::ops::Range;

use crate::geometry::Pose2;
use crate::scan::{Scan, Sector};

/// Maximum range of a self-hit, m.
const MAX_RANGE: f64 = 1.5;
/// Width of a range bin, m. A window of [`WINDOW_BINS`] bins covers the range noise.
const BIN_WIDTH: f64 = 0.02;
/// Number of neighbouring bins in which readings count as the same.
const WINDOW_BINS: usize = 3;
/// Distance between the scans that are counted along the path, m.
const SCAN_DISTANCE: f64 = 0.25;
/// Rotation between the scans that are counted during rotations, rad.
const SCAN_ROTATION: f64 = 0.1;
/// Minimum number of scans along the path: 10 m.
const MIN_SCANS_BY_DISTANCE: u32 = 40;
/// Minimum number of scans during rotations: about a full rotation.
const MIN_SCANS_BY_ROTATION: u32 = 60;
/// Fraction of the scans in which a reading must recur, for either count.
const MIN_FRACTION: f64 = 0.9;
/// Margin added to the range of the self-hits, m; readings within it are masked, too.
const MARGIN: f64 = 0.04;

/// Histogram of the ranges of each beam.
#[derive(Clone, Debug, Default)]
struct RangeHistogram {
    last: Option<Pose2>,
    scans: u32,
    /// Counts by beam and bin.
    readings: Vec<u32>,
}

impl RangeHistogram {
    fn add(&mut self, scan: &Scan, bins: usize) {
        self.readings.resize(scan.len() * bins, 0);
        self.scans += 1;
        for (i, _, range) in scan.rays().filter(|&(_, _, range)| range < MAX_RANGE) {
            self.readings[i * bins + bin(range)] += 1;
        }
    }

    /// The bins of a beam that hold nearly all of its readings, if there are such.
    fn constant(&self, beam: usize, bins: usize) -> Option<Range<usize>> {
        let counts = self.readings.get(beam * bins..(beam + 1) * bins)?;
        let (first, count) =
            counts.windows(WINDOW_BINS).map(|window| window.iter().sum::<u32>()).enumerate().max_by_key(|&(_, sum)| sum)?;
        (f64::from(count) >= MIN_FRACTION * f64::from(self.scans)).then_some(first..first + WINDOW_BINS)
    }
}

#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // less than a hundred
fn bin(range: f64) -> usize {
    (range / BIN_WIDTH) as usize
}

/// Detects the rays of a laser that hit its own robot.
#[derive(Clone, Debug, Default)]
pub struct SelfHits {
    by_distance: RangeHistogram,
    by_rotation: RangeHistogram,
    /// Angles of the beams, rad.
    angles: Vec<f64>,
}

impl SelfHits {
    /// Adds a scan as measured, with the laser's pose. A scan with another number of beams resets the counts.
    pub fn add(&mut self, scan: &Scan, odom_from_laser: &Pose2) {
        let bins = bin(MAX_RANGE) + 1;
        if self.angles.len() != scan.len() {
            *self = Self { angles: (0..scan.len()).map(|i| scan.beams().angle(i)).collect(), ..Self::default() };
        }
        let moved = |last: &Option<Pose2>| last.map(|last| last.between(odom_from_laser));
        if moved(&self.by_distance.last).is_none_or(|motion| motion.distance() >= SCAN_DISTANCE) {
            self.by_distance.last = Some(*odom_from_laser);
            self.by_distance.add(scan, bins);
        }
        if moved(&self.by_rotation.last).is_none_or(|motion| motion.theta.abs() >= SCAN_ROTATION) {
            self.by_rotation.last = Some(*odom_from_laser);
            self.by_rotation.add(scan, bins);
        }
    }

    /// The sectors in which the laser sees the robot, with the ranges up to which readings are self-hits. Empty until the robot has
    /// moved enough.
    pub fn sectors(&self) -> Vec<Sector> {
        if self.by_distance.scans < MIN_SCANS_BY_DISTANCE || self.by_rotation.scans < MIN_SCANS_BY_ROTATION {
            return Vec::new();
        }
        let beams: Vec<(usize, f64)> = (0..self.angles.len()).filter_map(|beam| Some((beam, self.range(beam)?))).collect();
        let neighbours = beams.chunk_by(|a, b| b.0 == a.0 + 1);
        neighbours.map(|beams| self.sector(beams)).collect()
    }

    /// The range up to which a beam sees the robot, m; `None` if it does not.
    fn range(&self, beam: usize) -> Option<f64> {
        let bins = bin(MAX_RANGE) + 1;
        let (distance, rotation) = (self.by_distance.constant(beam, bins)?, self.by_rotation.constant(beam, bins)?);
        let is_same = distance.start.abs_diff(rotation.start) < WINDOW_BINS;
        is_same.then(|| BIN_WIDTH * distance.end.max(rotation.end) as f64 + MARGIN)
    }

    /// The sector of a group of neighbouring beams, with half a beam on either side.
    fn sector(&self, beams: &[(usize, f64)]) -> Sector {
        let ends = [beams.first(), beams.last()].map(|end| end.map_or(0.0, |&(beam, _)| self.angles[beam]));
        let half = 0.5 * (self.angles.get(1).unwrap_or(&0.0) - self.angles.first().unwrap_or(&0.0)).abs();
        let range = beams.iter().map(|&(_, range)| range).fold(0.0, f64::max);
        Sector { from: ends[0].min(ends[1]) - half, to: ends[0].max(ends[1]) + half, range: Some(range) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::BeamGeometry;
    use crate::time::Stamp;

    /// A scan in a square room of 8 m; `has_corner`: with the robot's own corner at 0.4 m over 20 degrees.
    fn scan_in_room(pose: &Pose2, has_corner: bool, noise: f64) -> Scan {
        let beams = BeamGeometry::new(-2.4, 0.0175, 275);
        let range = |i: usize| {
            let ripple = noise * ((7 * i) as f64 + 100.0 * pose.x).sin();
            if has_corner && (200..220).contains(&i) {
                return 0.4 + ripple;
            }
            let direction = pose.transform().rotate(beams.directions()[i]);
            let side = |from: f64, along: f64| ((4.0 * along.signum() - from) / along).abs();
            side(pose.x, direction.x).min(side(pose.y, direction.y)) + ripple
        };
        let ranges: Vec<f64> = (0..beams.len()).map(range).collect();
        Scan::new(Stamp::default(), beams.clone().into(), (0.0, 30.0), ranges).unwrap()
    }

    /// Drives along the walls of the room at 1 m distance, with rotations in its corners.
    fn drive(laps: usize, has_corner: bool) -> SelfHits {
        let mut hits = SelfHits::default();
        let mut pose = Pose2::new(-3.0, -3.0, 0.0);
        for _ in 0..4 * laps {
            for _ in 0..60 {
                hits.add(&scan_in_room(&pose, has_corner, 0.01), &pose);
                pose = pose * Pose2::new(0.1, 0.0, 0.0);
            }
            for _ in 0..15 {
                hits.add(&scan_in_room(&pose, has_corner, 0.01), &pose);
                pose = pose * Pose2::new(0.0, 0.0, std::f64::consts::FRAC_PI_2 / 15.0);
            }
        }
        hits
    }

    #[test]
    fn the_robots_own_corner_is_detected() {
        let found = drive(3, true).sectors();
        assert_eq!(found.len(), 1, "{found:?}");
        let Sector { from, to, range } = found[0];
        let first = -2.4 + 0.0175 * 199.5;
        assert!((from - first).abs() < 1e-6 && (to - first - 0.0175 * 20.0).abs() < 1e-6, "{found:?}");
        assert!((0.41..0.5).contains(&range.unwrap()), "{found:?}");
    }

    #[test]
    fn walls_alongside_the_path_are_not_the_robot() {
        assert_eq!(drive(3, false).sectors(), []);
        assert_eq!(drive(1, true).sectors().len(), 1);
        let mut at_rest = SelfHits::default();
        (0..1000).for_each(|_| at_rest.add(&scan_in_room(&Pose2::IDENTITY, true, 0.0), &Pose2::IDENTITY));
        assert_eq!(at_rest.sectors(), [], "a robot at rest cannot tell walls from itself");
    }
}
