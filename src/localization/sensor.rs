//! The beam model (Thrun et al., 2005), computed beforehand: how likely a range is where the map has another.

crate::knobs! {
    /// The beam model.
    pub struct SensorKnobs {
        /// Beams used of a scan.
        beams: u32 = 60, in 1 to 10000;
        /// Part of the beams that end at the wall the map has.
        hit: f64 = 0.8, in 0 to 1;
        /// Part that end before it, at what the map does not have.
        short: f64 = 0.05, in 0 to 1;
        /// Part that do not come back.
        max: f64 = 0.05, in 0 to 1;
        /// Part that end anywhere.
        random: f64 = 0.1, in 0.000_001 to 1;
        /// Standard deviation of ranges about the map's: noise of the laser, and the size of cells.
        hit_error: f64 = 0.08, in 0.001 to 10, unit "m";
        /// The same while the robot may be anywhere: particles are too far apart for more.
        global_hit_error: f64 = 0.4, in 0.001 to 10, unit "m";
        /// Mean distance of what the map does not have.
        short_distance: f64 = 2.0, in 0.01 to 100, unit "m";
        /// Beams go no farther; at most the laser's `range_max`.
        max_range: f64 = 30.0, in 0.1 to 1000, unit "m";
        /// The likelihood's root of this order is taken: neighbouring beams are not independent.
        squash: f64 = 2.2, in 1 to 100;
    }
}

impl SensorKnobs {
    /// The model for a robot that may be anywhere.
    pub(super) fn global(&self) -> Self {
        Self { hit_error: self.global_hit_error.max(self.hit_error), ..self.clone() }
    }
}

/// Width of the classes of ranges, m.
const CLASS: f64 = 0.025;

/// Logarithms of likelihoods, by class of the range measured, then of the range in the map.
#[derive(Clone, Debug)]
pub(super) struct BeamTable {
    classes: usize,
    log_likelihoods: Vec<f32>,
    /// Classes in a cell.
    classes_per_cell: f32,
}

impl BeamTable {
    pub(super) fn new(knobs: &SensorKnobs, resolution: f64) -> Self {
        let last = (knobs.max_range / CLASS).ceil() as usize;
        let classes = last + 1; // the last one: nothing within reach
        let mut log_likelihoods = Vec::with_capacity(classes * classes);
        for measured in 0..classes {
            for expected in 0..classes {
                let likelihood = likelihood(knobs, measured, expected, last);
                log_likelihoods.push((likelihood.ln() / knobs.squash) as f32);
            }
        }
        Self { classes, log_likelihoods, classes_per_cell: (resolution / CLASS) as f32 }
    }

    /// The rows of the table for beams that measured these ranges, m.
    pub(super) fn rows(&self, ranges: &[f64]) -> Vec<&[f32]> {
        let row = |&range: &f64| {
            let class = ((range / CLASS) as usize).min(self.classes - 1);
            &self.log_likelihoods[class * self.classes..][..self.classes]
        };
        ranges.iter().map(row).collect()
    }

    /// Adds the logarithm of the likelihood of one beam, by its row, to that of each particle where the map has `lengths`, cells. What
    /// is beyond the laser's `reach`, m, it does not see.
    #[inline]
    pub(super) fn add_log_likelihoods(&self, row: &[f32], reach: f64, lengths: &[f32], sums: &mut [f32]) {
        let (row, last) = (&row[..self.classes], self.classes - 1);
        let reach = ((reach / CLASS) as usize).min(last);
        for (sum, length) in sums.iter_mut().zip(lengths) {
            let class = (length * self.classes_per_cell) as usize;
            *sum += row[if class < reach { class } else { last }];
        }
    }
}

/// The geometric mean of the likelihoods that `model` gives to beams that are as `truth` expects.
pub(super) fn expected_fit(truth: &SensorKnobs, model: &SensorKnobs) -> f64 {
    let last = (truth.max_range / CLASS).ceil() as usize;
    let of = |knobs, measured| likelihood(knobs, measured, last / 4, last);
    let likelihoods = (0..=last).map(|measured| (of(truth, measured), of(model, measured)));
    likelihoods.filter(|&(_, likelihood)| likelihood > 0.0).map(|(share, likelihood)| share * likelihood.ln()).sum::<f64>().exp()
}

/// The share of ranges in a class, where the map has the range of another.
fn likelihood(knobs: &SensorKnobs, measured: usize, expected: usize, last: usize) -> f64 {
    if measured == last {
        return knobs.max + if expected == last { knobs.hit } else { 0.0 } + knobs.random / last as f64;
    }
    let off = (measured as f64 - expected as f64) * CLASS / knobs.hit_error;
    let at_wall = if expected == last { 0.0 } else { (-0.5 * off * off).exp() * CLASS / (knobs.hit_error * 2.506_628_274_631) };
    let before = if measured < expected {
        let part = |class: usize| (-(class as f64) * CLASS / knobs.short_distance).exp();
        (part(measured) - part(measured + 1)) / (1.0 - part(expected))
    } else {
        0.0
    };
    knobs.hit * at_wall + knobs.short * before + knobs.random / last as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_likelihoods_of_all_ranges_add_up_to_one() {
        let knobs = SensorKnobs { max_range: 10.0, ..SensorKnobs::default() };
        let last = 400;
        for expected in [40, 200, 360, last] {
            let sum: f64 = (0..=last).map(|measured| likelihood(&knobs, measured, expected, last)).sum();
            // Of an object before a wall that is not there, and of a wall, not both.
            assert!((0.94..1.01).contains(&sum), "{expected}: {sum}");
        }
    }
}
