//! `geometry_msgs`.

use super::definition::messages;
use super::std_msgs::Header;
use crate::geometry::{Pose2, PoseCovariance, Twist2};

/// Covariance of x, y, z, roll, pitch and yaw, row by row.
pub type Covariance = [[f64; 6]; 6];

/// Indices of x, y and yaw in a covariance.
const PLANAR: [usize; 3] = [0, 1, 5];

messages! { "geometry_msgs":
    Point { x: f64, y: f64, z: f64 }
    PointStamped { header: Header, point: Point }
    Quaternion { x: f64, y: f64, z: f64, w: f64 }
    Vector3 { x: f64, y: f64, z: f64 }
    Pose { position: Point, orientation: Quaternion }
    Pose2D { x: f64, y: f64, theta: f64 }
    PoseArray { header: Header, poses: Vec<Pose> }
    PoseStamped { header: Header, pose: Pose }
    PoseWithCovariance { pose: Pose, covariance: Covariance }
    PoseWithCovarianceStamped { header: Header, pose: PoseWithCovariance }
    Twist { linear: Vector3, angular: Vector3 }
    TwistStamped { header: Header, twist: Twist }
    TwistWithCovariance { twist: Twist, covariance: Covariance }
    Transform { translation: Vector3, rotation: Quaternion }
    TransformStamped { header: Header, child_frame_id: String, transform: Transform }
}

impl Quaternion {
    /// A rotation about the z axis by `yaw`, rad.
    pub fn from_yaw(yaw: f64) -> Self {
        let (z, w) = (0.5 * yaw).sin_cos();
        Self { x: 0.0, y: 0.0, z, w }
    }

    /// The yaw angle, rad. It does not depend on the norm of the quaternion.
    pub fn yaw(&self) -> f64 {
        let Self { x, y, z, w } = self;
        (2.0 * (w * z + x * y)).atan2(w * w + x * x - y * y - z * z)
    }

    /// The norm; 1 for a rotation.
    pub fn norm(&self) -> f64 {
        [self.x, self.y, self.z, self.w].iter().map(|v| v * v).sum::<f64>().sqrt()
    }
}

impl From<Pose2> for Pose {
    fn from(pose: Pose2) -> Self {
        Self { position: Point { x: pose.x, y: pose.y, z: 0.0 }, orientation: Quaternion::from_yaw(pose.theta) }
    }
}

impl From<Pose2> for Transform {
    fn from(pose: Pose2) -> Self {
        Self { translation: Vector3 { x: pose.x, y: pose.y, z: 0.0 }, rotation: Quaternion::from_yaw(pose.theta) }
    }
}

impl From<Twist2> for Twist {
    fn from(twist: Twist2) -> Self {
        Self { linear: Vector3 { x: twist.vx, y: twist.vy, z: 0.0 }, angular: Vector3 { x: 0.0, y: 0.0, z: twist.omega } }
    }
}

/// The block of a covariance for x, y and yaw.
pub fn planar_covariance(full: &Covariance) -> PoseCovariance {
    PoseCovariance::from_fn(|row, column| full[PLANAR[row]][PLANAR[column]])
}

/// Extends a covariance of x, y and yaw to 6 dimensions; `unobserved` is the variance of z, roll and pitch, m^2 and rad^2.
pub fn full_covariance(planar: &PoseCovariance, unobserved: f64) -> Covariance {
    let mut full = Covariance::default();
    for i in [2, 3, 4] {
        full[i][i] = unobserved;
    }
    for (row, full_row) in PLANAR.into_iter().enumerate() {
        for (column, full_column) in PLANAR.into_iter().enumerate() {
            full[full_row][full_column] = planar[(row, column)];
        }
    }
    full
}
