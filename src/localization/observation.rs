//! What a filter sees of a scan: some of its beams.

use crate::raycasting::Fan;
use crate::scan::Scan;
use crate::time::Stamp;

/// Some beams of a scan, seen from the laser: in an order in which the first few, however many, are spread all over the scan.
#[derive(Clone, Debug, Default)]
pub struct Observation {
    /// When the scan was taken.
    pub stamp: Stamp,
    pub(super) fan: Fan,
    /// Lengths, m; infinite where the laser saw nothing within its reach.
    pub(super) ranges: Vec<f64>,
    /// The laser's reach, m.
    pub(super) reach: f64,
}

impl Observation {
    /// Up to `beams` beams, evenly spread. That nothing is within reach says something too.
    pub fn new(scan: &Scan, beams: usize) -> Self {
        let beams = beams.min(scan.len());
        let (mut angles, mut ranges) = (Vec::with_capacity(beams), Vec::with_capacity(beams));
        let mut order: Vec<usize> = (0..beams).collect();
        order.sort_by_key(|k| k.reverse_bits());
        for ray in order.into_iter().map(|k| (2 * k + 1) * scan.len() / (2 * beams)) {
            let range = scan.ranges()[ray];
            let nothing_there = scan.saw_nothing(ray);
            if nothing_there || !range.is_nan() {
                let direction = scan.beams().directions()[ray];
                angles.push(direction.y.atan2(direction.x));
                ranges.push(if nothing_there { f64::INFINITY } else { range });
            }
        }
        Self { stamp: scan.stamp(), reach: scan.reach(), ..Self::of(angles, ranges) }
    }

    /// Beams at these angles, rad, with these lengths, m.
    pub(super) fn of(angles: Vec<f64>, ranges: Vec<f64>) -> Self {
        Self { stamp: Stamp::default(), fan: Fan::new(angles), ranges, reach: f64::INFINITY }
    }

    /// Number of beams.
    pub fn len(&self) -> usize {
        self.ranges.len()
    }

    /// Whether the scan says nothing.
    pub fn is_empty(&self) -> bool {
        self.ranges.is_empty()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::BeamGeometry;
    use std::sync::Arc;

    #[test]
    fn the_first_beams_are_spread_all_over_the_scan() {
        let geometry = Arc::new(BeamGeometry::new(-2.0, 4.0 / 1080.0, 1081));
        let scan = Scan::new(
            Stamp::default(),
            Arc::clone(&geometry),
            (0.1, 30.0),
            (0..1081).map(|i| 1.0 + 0.01 * f64::from(i)).collect::<Vec<_>>(),
        );
        let observation = Observation::new(&scan.unwrap(), 60);
        for first in [4, 8, 15, 30, 60] {
            let mut ranges = observation.ranges[..first].to_vec();
            ranges.sort_by(f64::total_cmp);
            let widest = ranges.windows(2).map(|pair| pair[1] - pair[0]).fold(0.0, f64::max);
            assert!(widest < 3.0 * 10.8 / first as f64, "{first}: {widest}");
        }
    }
}
