//! `sensor_msgs`.

#![allow(missing_docs)] // the fields are those of the message definitions

use speedy::{Readable, Writable};

use super::Message;

/// `sensor_msgs/LaserScan`.
#[derive(Clone, Debug, Default, PartialEq, Readable, Writable)]
pub struct LaserScan {
    pub header: super::std_msgs::Header,
    pub angle_min: f32,
    pub angle_max: f32,
    pub angle_increment: f32,
    pub time_increment: f32,
    pub scan_time: f32,
    pub range_min: f32,
    pub range_max: f32,
    pub ranges: Vec<f32>,
    pub intensities: Vec<f32>,
}

impl Message for LaserScan {
    const TYPE: &'static str = "sensor_msgs/LaserScan";
    const MD5: &'static str = "90c7ef2dc6895d81024acba2ac42f369";
    const DEFINITIONS: &'static [(&'static str, &'static str)] = &[
        ("sensor_msgs/LaserScan", include_str!("../../definitions/sensor_msgs/msg/LaserScan.msg")),
        ("std_msgs/Header", include_str!("../../definitions/std_msgs/msg/Header.msg")),
    ];
}

/// `sensor_msgs/Imu`.
#[derive(Clone, Debug, Default, PartialEq, Readable, Writable)]
pub struct Imu {
    pub header: super::std_msgs::Header,
    pub orientation: super::geometry_msgs::Quaternion,
    pub orientation_covariance: [f64; 9],
    pub angular_velocity: super::geometry_msgs::Vector3,
    pub angular_velocity_covariance: [f64; 9],
    pub linear_acceleration: super::geometry_msgs::Vector3,
    pub linear_acceleration_covariance: [f64; 9],
}

impl Message for Imu {
    const TYPE: &'static str = "sensor_msgs/Imu";
    const MD5: &'static str = "6a62c6daae103f4ff57a132d6f95cec2";
    const DEFINITIONS: &'static [(&'static str, &'static str)] = &[
        ("sensor_msgs/Imu", include_str!("../../definitions/sensor_msgs/msg/Imu.msg")),
        ("std_msgs/Header", include_str!("../../definitions/std_msgs/msg/Header.msg")),
        ("geometry_msgs/Quaternion", include_str!("../../definitions/geometry_msgs/msg/Quaternion.msg")),
        ("geometry_msgs/Vector3", include_str!("../../definitions/geometry_msgs/msg/Vector3.msg")),
    ];
}

/// `sensor_msgs/PointField`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Readable, Writable)]
pub struct PointField {
    pub name: String,
    pub offset: u32,
    pub datatype: u8,
    pub count: u32,
}

impl PointField {
    pub const FLOAT32: u8 = 7;
    pub const FLOAT64: u8 = 8;
}

/// `sensor_msgs/PointCloud2`.
#[derive(Clone, Debug, Default, PartialEq, Readable, Writable)]
pub struct PointCloud2 {
    pub header: super::std_msgs::Header,
    pub height: u32,
    pub width: u32,
    pub fields: Vec<PointField>,
    pub is_bigendian: bool,
    pub point_step: u32,
    pub row_step: u32,
    pub data: Vec<u8>,
    pub is_dense: bool,
}

impl Message for PointCloud2 {
    const TYPE: &'static str = "sensor_msgs/PointCloud2";
    const MD5: &'static str = "1158d486dd51d683ce2f1be655c3c181";
    const DEFINITIONS: &'static [(&'static str, &'static str)] = &[
        ("sensor_msgs/PointCloud2", include_str!("../../definitions/sensor_msgs/msg/PointCloud2.msg")),
        ("std_msgs/Header", include_str!("../../definitions/std_msgs/msg/Header.msg")),
        ("sensor_msgs/PointField", include_str!("../../definitions/sensor_msgs/msg/PointField.msg")),
    ];
}
