//! Rays that see the robot itself.
//!
//! What a ray sees of the robot stays where it is, by bearing and range, while the robot moves. A wall stays at its distance only while the robot drives along
//! it: not over a turn. So a reading is the robot's own where it comes again and again both along the way and over turns.

use std::ops::Range;

use crate::geometry::Pose2;
use crate::scan::{Scan, Sector};

/// No part of a robot is farther from its laser, m.
const REACH: f64 = 1.5;
/// Readings within so much of each other are one, m: three of these, which is what ranges err by.
const BIN: f64 = 0.02;
/// Readings within so many neighbouring bins are one.
const SPREAD: usize = 3;
/// A scan after this way, m, ...
const STEP: f64 = 0.25;
/// ... and one after this turn, rad, tell something new.
const TURN: f64 = 0.1;
/// Fewest scans of the first kind: 10 m, ...
const FEWEST_BY_WAY: u32 = 40;
/// ... and of the second: about a full turn.
const FEWEST_BY_TURN: u32 = 60;
/// In this part of the scans of either kind a reading must come again.
const SHARE: f64 = 0.9;
/// Readings up to so much farther than the robot's are let go, too, m.
const MARGIN: f64 = 0.04;

/// How often each range was read, by beam.
#[derive(Clone, Debug, Default)]
struct Counts {
    last: Option<Pose2>,
    scans: u32,
    /// By beam and bin.
    readings: Vec<u32>,
}

impl Counts {
    fn add(&mut self, scan: &Scan, bins: usize) {
        self.readings.resize(scan.len() * bins, 0);
        self.scans += 1;
        for (i, _, range) in scan.rays().filter(|&(_, _, range)| range < REACH) {
            self.readings[i * bins + bin(range)] += 1;
        }
    }

    /// The bins of a beam that hold the same reading in nearly all scans.
    fn constant(&self, beam: usize, bins: usize) -> Option<Range<usize>> {
        let counts = self.readings.get(beam * bins..(beam + 1) * bins)?;
        let (first, most) =
            counts.windows(SPREAD).map(|window| window.iter().sum::<u32>()).enumerate().max_by_key(|&(_, sum)| sum)?;
        (f64::from(most) >= SHARE * f64::from(self.scans)).then_some(first..first + SPREAD)
    }
}

#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // less than a hundred
fn bin(range: f64) -> usize {
    (range / BIN) as usize
}

/// Finds what a laser sees of its robot.
#[derive(Clone, Debug, Default)]
pub struct SelfHits {
    by_way: Counts,
    by_turn: Counts,
    /// Angles of the beams, rad.
    angles: Vec<f64>,
}

impl SelfHits {
    /// Takes a scan as it was measured, and where the laser was. Scans of another geometry begin anew.
    pub fn add(&mut self, scan: &Scan, odom_from_laser: &Pose2) {
        let bins = bin(REACH) + 1;
        if self.angles.len() != scan.len() {
            *self = Self { angles: (0..scan.len()).map(|i| scan.beams().angle(i)).collect(), ..Self::default() };
        }
        let moved = |last: &Option<Pose2>| last.map(|last| last.between(odom_from_laser));
        if moved(&self.by_way.last).is_none_or(|motion| motion.distance() >= STEP) {
            self.by_way.last = Some(*odom_from_laser);
            self.by_way.add(scan, bins);
        }
        if moved(&self.by_turn.last).is_none_or(|motion| motion.theta.abs() >= TURN) {
            self.by_turn.last = Some(*odom_from_laser);
            self.by_turn.add(scan, bins);
        }
    }

    /// Bearings, and the ranges up to which readings there are of the robot.
    pub fn found(&self) -> Vec<Sector> {
        if self.by_way.scans < FEWEST_BY_WAY || self.by_turn.scans < FEWEST_BY_TURN {
            return Vec::new();
        }
        let mut beams: Vec<(usize, f64)> = (0..self.angles.len()).filter_map(|beam| Some((beam, self.range(beam)?))).collect();
        beams.dedup_by_key(|beam| beam.0);
        let neighbours = beams.chunk_by(|a, b| b.0 == a.0 + 1);
        neighbours.map(|beams| self.sector(beams)).collect()
    }

    /// The range up to which a beam sees the robot, m.
    fn range(&self, beam: usize) -> Option<f64> {
        let bins = bin(REACH) + 1;
        let (way, turn) = (self.by_way.constant(beam, bins)?, self.by_turn.constant(beam, bins)?);
        let is_same = way.start.abs_diff(turn.start) < SPREAD;
        is_same.then(|| BIN * way.end.max(turn.end) as f64 + MARGIN)
    }

    /// A stretch of beams that see the robot, and half a beam to either side.
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

    /// What is seen in a square room of 8 m, with the robot's own corner at 0.4 m over 20 degrees, where it has one.
    fn look(pose: &Pose2, has_corner: bool, noise: f64) -> Scan {
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

    /// Along the walls of the room, a metre away from them, and round its corners.
    fn drive(laps: usize, has_corner: bool) -> SelfHits {
        let mut hits = SelfHits::default();
        let mut pose = Pose2::new(-3.0, -3.0, 0.0);
        for _ in 0..4 * laps {
            for _ in 0..60 {
                hits.add(&look(&pose, has_corner, 0.01), &pose);
                pose = pose * Pose2::new(0.1, 0.0, 0.0);
            }
            for _ in 0..15 {
                hits.add(&look(&pose, has_corner, 0.01), &pose);
                pose = pose * Pose2::new(0.0, 0.0, std::f64::consts::FRAC_PI_2 / 15.0);
            }
        }
        hits
    }

    #[test]
    fn the_robots_own_corner_is_found() {
        let found = drive(3, true).found();
        assert_eq!(found.len(), 1, "{found:?}");
        let Sector { from, to, range } = found[0];
        let first = -2.4 + 0.0175 * 199.5;
        assert!((from - first).abs() < 1e-6 && (to - first - 0.0175 * 20.0).abs() < 1e-6, "{found:?}");
        assert!((0.41..0.5).contains(&range.unwrap()), "{found:?}");
    }

    #[test]
    fn walls_that_are_driven_along_are_not_the_robot() {
        assert_eq!(drive(3, false).found(), []);
        assert_eq!(drive(1, true).found().len(), 1);
        let mut at_rest = SelfHits::default();
        (0..1000).for_each(|_| at_rest.add(&look(&Pose2::IDENTITY, true, 0.0), &Pose2::IDENTITY));
        assert_eq!(at_rest.found(), [], "who does not move cannot tell");
    }
}
