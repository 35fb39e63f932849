//! `sensor_msgs`.

use super::definition::messages;
use super::geometry_msgs::{Quaternion, Vector3};
use super::std_msgs::Header;

messages! { "sensor_msgs":
    LaserScan {
        header: Header,
        angle_min: f32,
        angle_max: f32,
        angle_increment: f32,
        time_increment: f32,
        scan_time: f32,
        range_min: f32,
        range_max: f32,
        ranges: Vec<f32>,
        intensities: Vec<f32>,
    }
    Imu {
        header: Header,
        orientation: Quaternion,
        orientation_covariance: [f64; 9],
        angular_velocity: Vector3,
        angular_velocity_covariance: [f64; 9],
        linear_acceleration: Vector3,
        linear_acceleration_covariance: [f64; 9],
    }
    PointField { name: String, offset: u32, datatype: u8, count: u32 }
    PointCloud2 {
        header: Header,
        height: u32,
        width: u32,
        fields: Vec<PointField>,
        is_bigendian: bool,
        point_step: u32,
        row_step: u32,
        data: Vec<u8>,
        is_dense: bool,
    }
}

#[allow(missing_docs)] // values of `datatype`, named as in the definition
impl PointField {
    pub const FLOAT32: u8 = 7;
    pub const FLOAT64: u8 = 8;
}
