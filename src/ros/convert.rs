//! Conversion of covariances and transforms to ROS messages.

use crate::geometry::{Pose2, PoseCovariance};
use crate::messages::geometry_msgs::{Covariance, TransformStamped, full_covariance};
use crate::messages::std_msgs::Header;

/// Variance of height, roll and pitch, which a planar scan does not observe, m^2 and rad^2.
const UNOBSERVED: f64 = 1e6;
/// Minimum variance, m^2 and rad^2. Filters reject a covariance of zero, and no estimate is that good.
const MIN_VARIANCE: f64 = 1e-9;

/// Converts a planar covariance to a full one. An unknown (not finite) covariance becomes that of unobserved quantities.
pub(super) fn covariance(planar: &PoseCovariance) -> Covariance {
    let known = planar.iter().all(|v| v.is_finite());
    let mut planar = if known { *planar } else { PoseCovariance::from_diagonal_element(UNOBSERVED) };
    (0..3).for_each(|i| planar[(i, i)] = planar[(i, i)].max(MIN_VARIANCE));
    full_covariance(&planar, UNOBSERVED)
}

/// The transform from the frame of the header to `child`.
pub(super) fn transform(header: Header, child: &str, parent_from_child: Pose2) -> TransformStamped {
    TransformStamped { header, child_frame_id: child.into(), transform: parent_from_child.into() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_planar_covariance_fills_the_rows_of_x_y_and_yaw() {
        let planar = PoseCovariance::new(1.0, 2.0, 3.0, 2.0, 5.0, 6.0, 3.0, 6.0, 0.0);
        let full = covariance(&planar);
        let check_row = |row: usize, values: [f64; 6]| assert_eq!(full[row].map(f64::to_bits), values.map(f64::to_bits), "{row}");
        check_row(0, [1.0, 2.0, 0.0, 0.0, 0.0, 3.0]);
        check_row(1, [2.0, 5.0, 0.0, 0.0, 0.0, 6.0]);
        check_row(5, [3.0, 6.0, 0.0, 0.0, 0.0, MIN_VARIANCE]);
        assert!((2..5).all(|i| full[i][i].to_bits() == UNOBSERVED.to_bits()));
        assert!(covariance(&PoseCovariance::from_element(f64::NAN)).as_flattened().iter().all(|v| v.is_finite()));
    }
}
