//! The beam model (Thrun et al., 2005) as a precomputed table: the likelihood of a measured range for each expected range.

crate::knobs! {
    /// The beam model.
    pub struct SensorKnobs {
        /// Number of beams used of a scan.
        beams: u32 = 60, in 1 to 10000;
        /// Fraction of the beams that end at the expected wall of the map.
        hit: f64 = 0.8, in 0 to 1;
        /// Fraction that end before it, at an object missing in the map.
        short: f64 = 0.05, in 0 to 1;
        /// Fraction that return no range.
        max: f64 = 0.05, in 0 to 1;
        /// Fraction that end at a random range.
        random: f64 = 0.1, in 0.000_001 to 1;
        /// Standard deviation of ranges from the expected ones: laser noise and cell size.
        hit_error: f64 = 0.08, in 0.001 to 10, unit "m";
        /// The same for the global search: its particles are too sparse for a smaller one.
        global_hit_error: f64 = 0.4, in 0.001 to 10, unit "m";
        /// Mean distance of objects missing in the map.
        short_distance: f64 = 2.0, in 0.01 to 100, unit "m";
        /// Maximum range; at most the laser's `range_max`.
        max_range: f64 = 30.0, in 0.1 to 1000, unit "m";
        /// Order of the root taken of the likelihood of a scan, because neighbouring beams are correlated.
        squash: f64 = 2.2, in 1 to 100;
    }
}

impl SensorKnobs {
    /// The beam model of the global search.
    pub(super) fn global(&self) -> Self {
        Self { hit_error: self.global_hit_error.max(self.hit_error), ..self.clone() }
    }
}

/// Width of the range bins, m.
const BIN_WIDTH: f64 = 0.025;

/// Log-likelihoods, by the bin of the measured range, then by the bin of the expected range.
#[derive(Clone, Debug)]
pub(super) struct BeamTable {
    bins: usize,
    log_likelihoods: Vec<f32>,
    /// Range bins per cell.
    bins_per_cell: f32,
}

impl BeamTable {
    pub(super) fn new(knobs: &SensorKnobs, resolution: f64) -> Self {
        let last = (knobs.max_range / BIN_WIDTH).ceil() as usize;
        let bins = last + 1; // the last one: out of range
        let mut log_likelihoods = Vec::with_capacity(bins * bins);
        for measured in 0..bins {
            for expected in 0..bins {
                let likelihood = likelihood(knobs, measured, expected, last);
                log_likelihoods.push((likelihood.ln() / knobs.squash) as f32);
            }
        }
        Self { bins, log_likelihoods, bins_per_cell: (resolution / BIN_WIDTH) as f32 }
    }

    /// Adds the log-likelihood of a beam that measured `range`, m, to that of each particle whose expected ranges are `lengths`,
    /// cells. Expected ranges beyond the laser's `max_range`, m, count as out of range.
    pub(super) fn add_log_likelihoods(&self, range: f64, max_range: f64, lengths: &[f32], sums: &mut [f32]) {
        let last = self.bins - 1;
        let bin_of = |range: f64| ((range / BIN_WIDTH) as usize).min(last);
        let (row, max_range) = (&self.log_likelihoods[bin_of(range) * self.bins..][..self.bins], bin_of(max_range));
        for (sum, length) in sums.iter_mut().zip(lengths) {
            let bin = (length * self.bins_per_cell) as usize;
            *sum += row[if bin < max_range { bin } else { last }];
        }
    }
}

/// The geometric mean of the likelihoods that `model` assigns to beams distributed according to `truth`.
pub(super) fn expected_fit(truth: &SensorKnobs, model: &SensorKnobs) -> f64 {
    let last = (truth.max_range / BIN_WIDTH).ceil() as usize;
    let of = |knobs, measured| likelihood(knobs, measured, last / 4, last);
    let likelihoods = (0..=last).map(|measured| (of(truth, measured), of(model, measured)));
    likelihoods
        .filter(|&(_, likelihood)| likelihood > 0.0)
        .map(|(fraction, likelihood)| fraction * likelihood.ln())
        .sum::<f64>()
        .exp()
}

/// Probability of a measured range bin, given the bin of the expected range.
fn likelihood(knobs: &SensorKnobs, measured: usize, expected: usize, last: usize) -> f64 {
    if measured == last {
        return knobs.max + if expected == last { knobs.hit } else { 0.0 } + knobs.random / last as f64;
    }
    let off = (measured as f64 - expected as f64) * BIN_WIDTH / knobs.hit_error;
    let at_wall =
        if expected == last { 0.0 } else { (-0.5 * off * off).exp() * BIN_WIDTH / (knobs.hit_error * 2.506_628_274_631) };
    let before = if measured < expected {
        let tail = |bin: usize| (-(bin as f64) * BIN_WIDTH / knobs.short_distance).exp();
        (tail(measured) - tail(measured + 1)) / (1.0 - tail(expected))
    } else {
        0.0
    };
    knobs.hit * at_wall + knobs.short * before + knobs.random / last as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_likelihoods_of_all_ranges_sum_to_one() {
        let knobs = SensorKnobs { max_range: 10.0, ..SensorKnobs::default() };
        let last = 400;
        for expected in [40, 200, 360, last] {
            let sum: f64 = (0..=last).map(|measured| likelihood(&knobs, measured, expected, last)).sum();
            // Only approximately 1, because ranges are discretized.
            assert!((0.94..1.01).contains(&sum), "{expected}: {sum}");
        }
    }
}
