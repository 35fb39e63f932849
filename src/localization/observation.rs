//! An observation: the beams of a scan that the filter uses.

use std::ops::Range;

use crate::raycasting::Fan;
use crate::scan::Scan;
use crate::time::Stamp;

/// Beams of a scan in the laser's frame. They are ordered such that the first few, however many, are spread over the whole scan.
#[derive(Clone, Debug, Default)]
pub struct Observation {
    /// Stamp of the scan.
    pub stamp: Stamp,
    pub(super) fan: Fan,
    /// Ranges, m; infinite if a beam was out of range.
    pub(super) ranges: Vec<f64>,
    /// Maximum range of the laser, m.
    pub(super) max_range: f64,
}

impl Observation {
    /// Selects up to `beams` beams, evenly spread. Beams that were out of range count, too.
    pub fn new(scan: &Scan, beams: usize) -> Self {
        let beams = beams.min(scan.len());
        let (mut angles, mut ranges) = (Vec::with_capacity(beams), Vec::with_capacity(beams));
        let mut order: Vec<usize> = (0..beams).collect();
        order.sort_by_key(|k| k.reverse_bits());
        for ray in order.into_iter().map(|k| (2 * k + 1) * scan.len() / (2 * beams)) {
            let range = scan.ranges()[ray];
            let is_out_of_range = scan.is_out_of_range(ray);
            if is_out_of_range || !range.is_nan() {
                let direction = scan.beams().directions()[ray];
                angles.push(direction.y.atan2(direction.x));
                ranges.push(if is_out_of_range { f64::INFINITY } else { range });
            }
        }
        Self { stamp: scan.stamp(), max_range: scan.max_range(), ..Self::of(angles, ranges) }
    }

    /// Beams at these angles, rad, with these ranges, m.
    pub(super) fn of(angles: Vec<f64>, ranges: Vec<f64>) -> Self {
        Self { stamp: Stamp::default(), fan: Fan::new(angles), ranges, max_range: f64::INFINITY }
    }

    /// A subset of the beams, by index.
    pub(super) fn subset(&self, beams: Range<usize>) -> Self {
        Self { fan: self.fan.subset(beams.clone()), ranges: self.ranges[beams].to_vec(), ..*self }
    }

    /// Number of beams.
    pub fn len(&self) -> usize {
        self.ranges.len()
    }

    /// Whether there are no beams.
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
    fn the_first_beams_are_spread_over_the_whole_scan() {
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
