//! `ackermann_msgs`.

#![allow(missing_docs)] // the fields are those of the message definitions

use speedy::{Readable, Writable};

use super::Message;

/// `ackermann_msgs/AckermannDrive`.
#[derive(Clone, Debug, Default, PartialEq, Readable, Writable)]
pub struct AckermannDrive {
    pub steering_angle: f32,
    pub steering_angle_velocity: f32,
    pub speed: f32,
    pub acceleration: f32,
    pub jerk: f32,
}

/// `ackermann_msgs/AckermannDriveStamped`.
#[derive(Clone, Debug, Default, PartialEq, Readable, Writable)]
pub struct AckermannDriveStamped {
    pub header: super::std_msgs::Header,
    pub drive: AckermannDrive,
}

impl Message for AckermannDriveStamped {
    const TYPE: &'static str = "ackermann_msgs/AckermannDriveStamped";
    const MD5: &'static str = "1fd5d7f58889cefd44d29f6653240d0c";
    const DEFINITIONS: &'static [(&'static str, &'static str)] = &[
        ("ackermann_msgs/AckermannDriveStamped", include_str!("../../definitions/ackermann_msgs/msg/AckermannDriveStamped.msg")),
        ("std_msgs/Header", include_str!("../../definitions/std_msgs/msg/Header.msg")),
        ("ackermann_msgs/AckermannDrive", include_str!("../../definitions/ackermann_msgs/msg/AckermannDrive.msg")),
    ];
}
