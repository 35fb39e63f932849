//! Default costs of the estimators, if no cost file is given: as learned on the machine that the numbers in docs/ come from.

use std::path::Path;

use super::{DriveError, EstimatorKind};
use crate::anytime::cost_model::{CostEntry, CostModel};
use crate::io::cost_file;

/// Phase, number of rays, time in us. Measured by `anytime replay bags/demo.bag --clock processor --set contract.cost_file=FILE`.
const SCAN_MATCHER: [(&str, u32, f64); 9] = [
    ("setup", 1024, 22.5),
    ("iteration", 32, 2.5),
    ("iteration", 128, 5.0),
    ("iteration", 512, 13.9),
    ("iteration", 1024, 25.5),
    ("closing", 32, 4.8),
    ("closing", 128, 5.1),
    ("closing", 512, 5.8),
    ("closing", 1024, 6.0),
];
/// Phase, number of particles or of beams cast from all of them, time in us. In total 2.3 ms for 4000 particles and 60 beams
/// (docs/localization.md).
const PARTICLE_FILTER: [(&str, u32, f64); 3] = [("setup", 64, 0.94), ("iteration", 64, 0.61), ("closing", 64, 0.94)];

/// The costs of an estimator: from the file if there is one, otherwise the defaults.
pub(super) fn load(kind: EstimatorKind, file: Option<&Path>, confidence: f64) -> Result<CostModel, DriveError> {
    let mut costs = CostModel::new(confidence);
    let defaults: &[(&str, u32, f64)] = match kind {
        EstimatorKind::Truth => &[],
        EstimatorKind::ScanMatcher => &SCAN_MATCHER,
        EstimatorKind::ParticleFilter => &PARTICLE_FILTER,
    };
    let entry = |&(phase, rays, median_us): &(&str, u32, f64)| CostEntry {
        phase: phase.into(),
        rays,
        samples: 1,
        median_us,
        quantile_us: median_us,
    };
    costs.restore(&defaults.iter().map(entry).collect::<Vec<_>>());
    if let Some(file) = file {
        // `read` treats a missing file as a new one, which would hide a wrong path.
        std::fs::metadata(file).map_err(|problem| DriveError::File { path: file.into(), problem })?;
        costs = CostModel::new(confidence);
        cost_file::read(file, &mut costs)?;
    }
    Ok(costs)
}
