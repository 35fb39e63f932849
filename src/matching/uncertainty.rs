//! How well a match fixes the pose.

use nalgebra::Matrix3;

use crate::geometry::{Point, PoseCovariance};

/// How well a match fixes the pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Uncertainty {
    /// Covariance of the pose (m, m, rad); `None` where the pairs leave a direction open.
    pub covariance: Option<PoseCovariance>,
    /// Ratio of the largest to the smallest eigenvalue of the information matrix, headings measured by their effect at the pairs'
    /// mean distance; infinite where the pairs leave a direction open.
    pub condition_number: f64,
    /// Unit vector along which the pairs leave the translation open, if they do, in the reference frame. Classic pairs do not say.
    pub free_direction: Option<Point>,
    /// What the pairs alone know of the pose, without any prior: the inverse of a covariance in m, m, rad. Nothing along
    /// [`Self::free_direction`].
    pub information: Option<Matrix3<f64>>,
}

/// Of an information matrix (x, y, heading), headings measured by their effect at the distance `lever`, m.
pub(super) fn condition_number(information: &Matrix3<f64>, lever: f64) -> f64 {
    let mut information = *information;
    for i in 0..3 {
        information[(i, 2)] /= lever;
        information[(2, i)] /= lever;
    }
    let eigenvalues = information.symmetric_eigenvalues();
    let (least, most) = (eigenvalues.min(), eigenvalues.max());
    if least > 0.0 { most / least } else { f64::INFINITY }
}
