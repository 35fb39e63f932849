//! Uncertainty of a matched pose.

use nalgebra::Matrix3;

use crate::geometry::{Point, PoseCovariance};

/// Uncertainty of a matched pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Uncertainty {
    /// Covariance of the pose (m, m, rad); `None` if the correspondences leave a direction unconstrained.
    pub covariance: Option<PoseCovariance>,
    /// Ratio of the largest to the smallest eigenvalue of the information matrix, with headings scaled by the mean distance of
    /// the correspondences; infinite if a direction is unconstrained.
    pub condition_number: f64,
    /// Unit vector, in the reference frame, along which the correspondences do not constrain the translation, if there is one.
    /// Always `None` for classic correspondences.
    pub free_direction: Option<Point>,
    /// Information of the correspondences about the pose, without any prior: the inverse of a covariance in m, m, rad. Zero along
    /// [`Self::free_direction`].
    pub information: Option<Matrix3<f64>>,
}

/// Condition number of an information matrix (x, y, heading), with headings scaled by the lever arm, m.
pub(super) fn condition_number(information: &Matrix3<f64>, lever_arm: f64) -> f64 {
    let mut information = *information;
    for i in 0..3 {
        information[(i, 2)] /= lever_arm;
        information[(2, i)] /= lever_arm;
    }
    let eigenvalues = information.symmetric_eigenvalues();
    let (smallest, largest) = (eigenvalues.min(), eigenvalues.max());
    if smallest > 0.0 { largest / smallest } else { f64::INFINITY }
}
