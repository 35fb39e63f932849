//! Poses and covariances as ROS messages have them.

use crate::geometry::{Pose2, PoseCovariance};
use crate::messages::geometry_msgs::{Covariance, TransformStamped, full_covariance};
use crate::messages::std_msgs::Header;

/// Variance of what a planar scan does not observe: height, roll and pitch, m^2 and rad^2.
const UNOBSERVED: f64 = 1e6;
/// Least variance: filters reject a covariance of zero, and no estimate is that good, m^2 and rad^2.
const LEAST_VARIANCE: f64 = 1e-9;

/// What is not known at all has the variance of what is not observed.
pub(super) fn covariance(planar: &PoseCovariance) -> Covariance {
    let known = planar.iter().all(|v| v.is_finite());
    let mut planar = if known { *planar } else { PoseCovariance::from_diagonal_element(UNOBSERVED) };
    (0..3).for_each(|i| planar[(i, i)] = planar[(i, i)].max(LEAST_VARIANCE));
    full_covariance(&planar, UNOBSERVED)
}

/// Where `child` is, in the frame of the header.
pub(super) fn transform(header: Header, child: &str, parent_from_child: Pose2) -> TransformStamped {
    TransformStamped { header, child_frame_id: child.into(), transform: parent_from_child.into() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_planar_covariance_takes_its_places_among_six() {
        let planar = PoseCovariance::new(1.0, 2.0, 3.0, 2.0, 5.0, 6.0, 3.0, 6.0, 0.0);
        let full = covariance(&planar);
        let holds = |row: usize, values: [f64; 6]| assert_eq!(full[row].map(f64::to_bits), values.map(f64::to_bits), "{row}");
        holds(0, [1.0, 2.0, 0.0, 0.0, 0.0, 3.0]);
        holds(1, [2.0, 5.0, 0.0, 0.0, 0.0, 6.0]);
        holds(5, [3.0, 6.0, 0.0, 0.0, 0.0, LEAST_VARIANCE]);
        assert!((2..5).all(|i| full[i][i].to_bits() == UNOBSERVED.to_bits()));
        assert!(covariance(&PoseCovariance::from_element(f64::NAN)).as_flattened().iter().all(|v| v.is_finite()));
    }
}
