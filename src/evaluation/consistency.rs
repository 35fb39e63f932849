//! Whether an estimator is as uncertain as it is wrong.

use serde::Serialize;

use crate::geometry::{Pose2, PoseCovariance, wrap_angle};

/// The square of a normalised error in the plane, which 99.73 % of errors do not exceed (chi squared with two degrees of freedom): as
/// often as one number is within three standard deviations.
const THREE_SIGMA: f64 = 11.83;

/// How the errors of poses compare with their covariances (Bar-Shalom, Li and Kirubarajan 2001, 5.4).
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Consistency {
    /// Mean of the normalised estimation error squared of x, y and yaw (NEES); 3 where the covariances are right, more where they are too small.
    pub nees: f64,
    /// Part of the positions that are within three standard deviations of the truth; 0.997 where the covariances are right.
    pub within_three_sigma: f64,
}

impl Consistency {
    /// Of estimates, each with its covariance in the map frame, and the truth; `None` where no covariance can be inverted.
    pub fn of<'a>(estimates: impl IntoIterator<Item = (&'a Pose2, &'a PoseCovariance, &'a Pose2)>) -> Option<Self> {
        let (mut count, mut sum, mut within) = (0, 0.0, 0);
        for (estimate, covariance, truth) in estimates {
            let (x, y) = (estimate.x - truth.x, estimate.y - truth.y);
            let error = nalgebra::Vector3::new(x, y, wrap_angle(estimate.theta - truth.theta));
            let (error_of_position, of_position) = (error.xy(), covariance.fixed_view::<2, 2>(0, 0).into_owned());
            let Some((pose, position)) = covariance.cholesky().zip(of_position.cholesky()) else { continue };
            count += 1;
            sum += error.dot(&pose.solve(&error));
            within += usize::from(error_of_position.dot(&position.solve(&error_of_position)) <= THREE_SIGMA);
        }
        (count > 0).then(|| Self { nees: sum / f64::from(count), within_three_sigma: within as f64 / f64::from(count) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng as _;
    use rand_distr::{Distribution, StandardNormal};

    #[test]
    fn errors_that_their_covariances_predict_are_consistent() {
        let mut random = rand_pcg::Pcg64::seed_from_u64(1);
        let covariance = PoseCovariance::new(4e-4, 1e-4, 1e-5, 1e-4, 1e-4, 0.0, 1e-5, 0.0, 1e-5);
        let root = covariance.cholesky().unwrap().l();
        let truth = Pose2::new(3.0, -2.0, 3.14);
        let estimates: Vec<Pose2> = (0..10_000)
            .map(|_| {
                let off = root * nalgebra::Vector3::from_fn(|_, _| StandardNormal.sample(&mut random));
                Pose2::new(truth.x + off.x, truth.y + off.y, wrap_angle(truth.theta + off.z))
            })
            .collect();
        let of = |claimed: PoseCovariance| Consistency::of(estimates.iter().map(|pose| (pose, &claimed, &truth))).unwrap();
        let (right, bold) = (of(covariance), of(covariance / 9.0));
        assert!((right.nees - 3.0).abs() < 0.1 && (right.within_three_sigma - 0.9973).abs() < 0.002, "{right:?}");
        assert!((bold.nees - 27.0).abs() < 1.0 && bold.within_three_sigma < 0.45, "{bold:?}");
        assert_eq!(Consistency::of([(&truth, &PoseCovariance::zeros(), &truth)]), None);
    }
}
