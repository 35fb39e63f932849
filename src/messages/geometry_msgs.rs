//! `geometry_msgs`.

#![allow(missing_docs)] // the fields are those of the message definitions

use speedy::{Readable, Writable};

use super::Message;
use crate::geometry::Pose2;

/// `geometry_msgs/Point`.
#[derive(Clone, Debug, Default, PartialEq, Readable, Writable)]
pub struct Point {
    pub x: f64,
    pub y: f64,
    pub z: f64,
}

/// `geometry_msgs/PointStamped`.
#[derive(Clone, Debug, Default, PartialEq, Readable, Writable)]
pub struct PointStamped {
    pub header: super::std_msgs::Header,
    pub point: Point,
}

impl Message for PointStamped {
    const TYPE: &'static str = "geometry_msgs/PointStamped";
    const MD5: &'static str = "c63aecb41bfdfd6b7e1fac37c7cbe7bf";
    const DEFINITIONS: &'static [(&'static str, &'static str)] = &[
        ("geometry_msgs/PointStamped", include_str!("../../definitions/geometry_msgs/msg/PointStamped.msg")),
        ("std_msgs/Header", include_str!("../../definitions/std_msgs/msg/Header.msg")),
        ("geometry_msgs/Point", include_str!("../../definitions/geometry_msgs/msg/Point.msg")),
    ];
}

/// `geometry_msgs/Quaternion`.
#[derive(Clone, Debug, Default, PartialEq, Readable, Writable)]
pub struct Quaternion {
    pub x: f64,
    pub y: f64,
    pub z: f64,
    pub w: f64,
}

impl Quaternion {
    /// A turn about the vertical, rad.
    pub fn from_yaw(yaw: f64) -> Self {
        let (z, w) = (0.5 * yaw).sin_cos();
        Self { x: 0.0, y: 0.0, z, w }
    }

    /// The turn about the vertical, rad; the same for any length of the quaternion.
    pub fn yaw(&self) -> f64 {
        let Self { x, y, z, w } = self;
        (2.0 * (w * z + x * y)).atan2(w * w + x * x - y * y - z * z)
    }

    /// 1 for a rotation.
    pub fn norm(&self) -> f64 {
        [self.x, self.y, self.z, self.w].iter().map(|v| v * v).sum::<f64>().sqrt()
    }
}

/// `geometry_msgs/Vector3`.
#[derive(Clone, Debug, Default, PartialEq, Readable, Writable)]
pub struct Vector3 {
    pub x: f64,
    pub y: f64,
    pub z: f64,
}

/// `geometry_msgs/Pose`.
#[derive(Clone, Debug, Default, PartialEq, Readable, Writable)]
pub struct Pose {
    pub position: Point,
    pub orientation: Quaternion,
}

impl From<Pose2> for Pose {
    fn from(pose: Pose2) -> Self {
        Self { position: Point { x: pose.x, y: pose.y, z: 0.0 }, orientation: Quaternion::from_yaw(pose.theta) }
    }
}

/// `geometry_msgs/PoseStamped`.
#[derive(Clone, Debug, Default, PartialEq, Readable, Writable)]
pub struct PoseStamped {
    pub header: super::std_msgs::Header,
    pub pose: Pose,
}

impl Message for PoseStamped {
    const TYPE: &'static str = "geometry_msgs/PoseStamped";
    const MD5: &'static str = "d3812c3cbc69362b77dc0b19b345f8f5";
    const DEFINITIONS: &'static [(&'static str, &'static str)] = &[
        ("geometry_msgs/PoseStamped", include_str!("../../definitions/geometry_msgs/msg/PoseStamped.msg")),
        ("std_msgs/Header", include_str!("../../definitions/std_msgs/msg/Header.msg")),
        ("geometry_msgs/Pose", include_str!("../../definitions/geometry_msgs/msg/Pose.msg")),
        ("geometry_msgs/Point", include_str!("../../definitions/geometry_msgs/msg/Point.msg")),
        ("geometry_msgs/Quaternion", include_str!("../../definitions/geometry_msgs/msg/Quaternion.msg")),
    ];
}

/// `geometry_msgs/PoseWithCovariance`.
#[derive(Clone, Debug, PartialEq, Readable, Writable)]
pub struct PoseWithCovariance {
    pub pose: Pose,
    pub covariance: [f64; 36],
}

impl Default for PoseWithCovariance {
    fn default() -> Self {
        Self { pose: Pose::default(), covariance: [0.0; 36] }
    }
}

/// `geometry_msgs/PoseWithCovarianceStamped`.
#[derive(Clone, Debug, Default, PartialEq, Readable, Writable)]
pub struct PoseWithCovarianceStamped {
    pub header: super::std_msgs::Header,
    pub pose: PoseWithCovariance,
}

impl Message for PoseWithCovarianceStamped {
    const TYPE: &'static str = "geometry_msgs/PoseWithCovarianceStamped";
    const MD5: &'static str = "953b798c0f514ff060a53a3498ce6246";
    const DEFINITIONS: &'static [(&'static str, &'static str)] = &[
        ("geometry_msgs/PoseWithCovarianceStamped", include_str!("../../definitions/geometry_msgs/msg/PoseWithCovarianceStamped.msg")),
        ("std_msgs/Header", include_str!("../../definitions/std_msgs/msg/Header.msg")),
        ("geometry_msgs/PoseWithCovariance", include_str!("../../definitions/geometry_msgs/msg/PoseWithCovariance.msg")),
        ("geometry_msgs/Pose", include_str!("../../definitions/geometry_msgs/msg/Pose.msg")),
        ("geometry_msgs/Point", include_str!("../../definitions/geometry_msgs/msg/Point.msg")),
        ("geometry_msgs/Quaternion", include_str!("../../definitions/geometry_msgs/msg/Quaternion.msg")),
    ];
}

/// `geometry_msgs/Twist`.
#[derive(Clone, Debug, Default, PartialEq, Readable, Writable)]
pub struct Twist {
    pub linear: Vector3,
    pub angular: Vector3,
}

impl Message for Twist {
    const TYPE: &'static str = "geometry_msgs/Twist";
    const MD5: &'static str = "9f195f881246fdfa2798d1d3eebca84a";
    const DEFINITIONS: &'static [(&'static str, &'static str)] = &[
        ("geometry_msgs/Twist", include_str!("../../definitions/geometry_msgs/msg/Twist.msg")),
        ("geometry_msgs/Vector3", include_str!("../../definitions/geometry_msgs/msg/Vector3.msg")),
    ];
}

/// `geometry_msgs/TwistStamped`.
#[derive(Clone, Debug, Default, PartialEq, Readable, Writable)]
pub struct TwistStamped {
    pub header: super::std_msgs::Header,
    pub twist: Twist,
}

impl Message for TwistStamped {
    const TYPE: &'static str = "geometry_msgs/TwistStamped";
    const MD5: &'static str = "98d34b0043a2093cf9d9345ab6eef12e";
    const DEFINITIONS: &'static [(&'static str, &'static str)] = &[
        ("geometry_msgs/TwistStamped", include_str!("../../definitions/geometry_msgs/msg/TwistStamped.msg")),
        ("std_msgs/Header", include_str!("../../definitions/std_msgs/msg/Header.msg")),
        ("geometry_msgs/Twist", include_str!("../../definitions/geometry_msgs/msg/Twist.msg")),
        ("geometry_msgs/Vector3", include_str!("../../definitions/geometry_msgs/msg/Vector3.msg")),
    ];
}

/// `geometry_msgs/TwistWithCovariance`.
#[derive(Clone, Debug, PartialEq, Readable, Writable)]
pub struct TwistWithCovariance {
    pub twist: Twist,
    pub covariance: [f64; 36],
}

impl Default for TwistWithCovariance {
    fn default() -> Self {
        Self { twist: Twist::default(), covariance: [0.0; 36] }
    }
}

/// `geometry_msgs/Transform`.
#[derive(Clone, Debug, Default, PartialEq, Readable, Writable)]
pub struct Transform {
    pub translation: Vector3,
    pub rotation: Quaternion,
}

impl From<Pose2> for Transform {
    fn from(pose: Pose2) -> Self {
        Self { translation: Vector3 { x: pose.x, y: pose.y, z: 0.0 }, rotation: Quaternion::from_yaw(pose.theta) }
    }
}

/// `geometry_msgs/TransformStamped`.
#[derive(Clone, Debug, Default, PartialEq, Readable, Writable)]
pub struct TransformStamped {
    pub header: super::std_msgs::Header,
    pub child_frame_id: String,
    pub transform: Transform,
}

impl Message for TransformStamped {
    const TYPE: &'static str = "geometry_msgs/TransformStamped";
    const MD5: &'static str = "b5764a33bfeb3588febc2682852579b0";
    const DEFINITIONS: &'static [(&'static str, &'static str)] = &[
        ("geometry_msgs/TransformStamped", include_str!("../../definitions/geometry_msgs/msg/TransformStamped.msg")),
        ("std_msgs/Header", include_str!("../../definitions/std_msgs/msg/Header.msg")),
        ("geometry_msgs/Transform", include_str!("../../definitions/geometry_msgs/msg/Transform.msg")),
        ("geometry_msgs/Vector3", include_str!("../../definitions/geometry_msgs/msg/Vector3.msg")),
        ("geometry_msgs/Quaternion", include_str!("../../definitions/geometry_msgs/msg/Quaternion.msg")),
    ];
}
