//! `sensor_msgs`.

#![allow(missing_docs)] // the fields are those of the definitions under msg/

use serde::{Deserialize, Serialize};

use super::Message;

/// `sensor_msgs/LaserScan`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
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
        ("sensor_msgs/LaserScan", include_str!("../../msg/sensor_msgs/msg/LaserScan.msg")),
        ("std_msgs/Header", include_str!("../../msg/std_msgs/msg/Header.msg")),
    ];
}
