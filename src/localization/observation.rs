//! What a filter sees of a scan: some of its beams.

use crate::raycasting::Fan;
use crate::scan::Scan;
use crate::time::Stamp;

/// Some beams of a scan, seen from the laser.
#[derive(Clone, Debug)]
pub struct Observation {
    /// When the scan was taken.
    pub stamp: Stamp,
    pub(super) fan: Fan,
    /// Lengths, m; infinite where the laser saw nothing within its reach.
    pub(super) ranges: Vec<f64>,
}

impl Observation {
    /// Up to `beams` beams, evenly spread. `readings` are those of the message, of which `scan` keeps measurements only: here,
    /// that nothing is within reach (`inf`, REP 117) says something too.
    pub fn new(scan: &Scan, readings: &[f32], beams: usize) -> Self {
        let beams = beams.min(scan.len());
        let (mut angles, mut ranges) = (Vec::with_capacity(beams), Vec::with_capacity(beams));
        for ray in (0..beams).map(|k| (2 * k + 1) * scan.len() / (2 * beams)) {
            let range = scan.ranges()[ray];
            let nothing_there = readings.get(ray) == Some(&f32::INFINITY);
            if nothing_there || !range.is_nan() {
                angles.push(scan.beams().angle(ray));
                ranges.push(if nothing_there { f64::INFINITY } else { range });
            }
        }
        Self { stamp: scan.stamp(), fan: Fan::new(angles), ranges }
    }
}
