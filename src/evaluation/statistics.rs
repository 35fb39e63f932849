//! Statistics of errors.

use serde::Serialize;

use crate::geometry::Pose2;

/// Statistics of a set of absolute errors.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Statistics {
    /// Mean.
    pub mean: f64,
    /// Sample standard deviation (N - 1); 0 for a single error.
    pub std: f64,
    /// Median; for an even count, the mean of the middle two.
    pub median: f64,
    /// Root mean square.
    pub rmse: f64,
    /// Maximum.
    pub max: f64,
}

impl Statistics {
    /// Computes the statistics of `errors`; `None` if there are none.
    pub fn of(mut errors: Vec<f64>) -> Option<Self> {
        errors.sort_by(f64::total_cmp);
        let count = errors.len() as f64;
        let mean = errors.iter().sum::<f64>() / count;
        let scatter: f64 = errors.iter().map(|e| (e - mean).powi(2)).sum();
        let mean_square = errors.iter().map(|e| e * e).sum::<f64>() / count;
        Some(Self {
            mean,
            std: if errors.len() > 1 { (scatter / (count - 1.0)).sqrt() } else { 0.0 },
            median: f64::midpoint(*errors.get(errors.len().checked_sub(1)? / 2)?, *errors.get(errors.len() / 2)?),
            rmse: mean_square.sqrt(),
            max: *errors.last()?,
        })
    }
}

/// Statistics of the errors of poses.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PoseErrors {
    /// Number of errors.
    pub count: usize,
    /// Translation errors, m.
    pub trans_m: Statistics,
    /// Absolute rotation errors, degrees.
    pub rot_deg: Statistics,
}

impl PoseErrors {
    /// Each error is the estimated pose in the frame of the true one. `None` if there are no errors.
    pub fn of(errors: &[Pose2]) -> Option<Self> {
        Some(Self {
            count: errors.len(),
            trans_m: Statistics::of(errors.iter().map(Pose2::distance).collect())?,
            rot_deg: Statistics::of(errors.iter().map(|e| e.theta.abs().to_degrees()).collect())?,
        })
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, clippy::float_cmp)]
    use super::*;

    #[test]
    fn statistics_of_three_numbers_match_hand_calculation() {
        let s = Statistics::of(vec![3.0, 1.0, 2.0]).unwrap();
        assert_eq!((s.mean, s.std, s.median, s.max), (2.0, 1.0, 2.0, 3.0));
        assert!((s.rmse - (14.0_f64 / 3.0).sqrt()).abs() < 1e-15);
    }

    #[test]
    fn one_two_and_no_numbers_are_handled() {
        let one = Statistics::of(vec![5.0]).unwrap();
        assert_eq!((one.mean, one.std, one.median, one.rmse, one.max), (5.0, 0.0, 5.0, 5.0, 5.0));
        assert_eq!(Statistics::of(vec![1.0, 4.0]).unwrap().median, 2.5);
        assert_eq!(Statistics::of(vec![]), None);
    }
}
