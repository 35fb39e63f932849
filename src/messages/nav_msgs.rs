//! `nav_msgs`.

#![allow(missing_docs)] // the fields are those of the message definitions

use speedy::{Readable, Writable};

use super::Message;

/// `nav_msgs/Odometry`.
#[derive(Clone, Debug, Default, PartialEq, Readable, Writable)]
pub struct Odometry {
    pub header: super::std_msgs::Header,
    pub child_frame_id: String,
    pub pose: super::geometry_msgs::PoseWithCovariance,
    pub twist: super::geometry_msgs::TwistWithCovariance,
}

impl Message for Odometry {
    const TYPE: &'static str = "nav_msgs/Odometry";
    const MD5: &'static str = "cd5e73d190d741a2f92e81eda573aca7";
    const DEFINITIONS: &'static [(&'static str, &'static str)] = &[
        ("nav_msgs/Odometry", include_str!("../../definitions/nav_msgs/msg/Odometry.msg")),
        ("std_msgs/Header", include_str!("../../definitions/std_msgs/msg/Header.msg")),
        ("geometry_msgs/PoseWithCovariance", include_str!("../../definitions/geometry_msgs/msg/PoseWithCovariance.msg")),
        ("geometry_msgs/Pose", include_str!("../../definitions/geometry_msgs/msg/Pose.msg")),
        ("geometry_msgs/Point", include_str!("../../definitions/geometry_msgs/msg/Point.msg")),
        ("geometry_msgs/Quaternion", include_str!("../../definitions/geometry_msgs/msg/Quaternion.msg")),
        ("geometry_msgs/TwistWithCovariance", include_str!("../../definitions/geometry_msgs/msg/TwistWithCovariance.msg")),
        ("geometry_msgs/Twist", include_str!("../../definitions/geometry_msgs/msg/Twist.msg")),
        ("geometry_msgs/Vector3", include_str!("../../definitions/geometry_msgs/msg/Vector3.msg")),
    ];
}

/// `nav_msgs/Path`.
#[derive(Clone, Debug, Default, PartialEq, Readable, Writable)]
pub struct Path {
    pub header: super::std_msgs::Header,
    pub poses: Vec<super::geometry_msgs::PoseStamped>,
}

impl Message for Path {
    const TYPE: &'static str = "nav_msgs/Path";
    const MD5: &'static str = "6227e2b7e9cce15051f669a5e197bbf7";
    const DEFINITIONS: &'static [(&'static str, &'static str)] = &[
        ("nav_msgs/Path", include_str!("../../definitions/nav_msgs/msg/Path.msg")),
        ("std_msgs/Header", include_str!("../../definitions/std_msgs/msg/Header.msg")),
        ("geometry_msgs/PoseStamped", include_str!("../../definitions/geometry_msgs/msg/PoseStamped.msg")),
        ("geometry_msgs/Pose", include_str!("../../definitions/geometry_msgs/msg/Pose.msg")),
        ("geometry_msgs/Point", include_str!("../../definitions/geometry_msgs/msg/Point.msg")),
        ("geometry_msgs/Quaternion", include_str!("../../definitions/geometry_msgs/msg/Quaternion.msg")),
    ];
}

/// `nav_msgs/MapMetaData`.
#[derive(Clone, Debug, Default, PartialEq, Readable, Writable)]
pub struct MapMetaData {
    pub map_load_time: super::Time,
    pub resolution: f32,
    pub width: u32,
    pub height: u32,
    pub origin: super::geometry_msgs::Pose,
}

impl Message for MapMetaData {
    const TYPE: &'static str = "nav_msgs/MapMetaData";
    const MD5: &'static str = "10cfc8a2818024d3248802c00c95f11b";
    const DEFINITIONS: &'static [(&'static str, &'static str)] = &[
        ("nav_msgs/MapMetaData", include_str!("../../definitions/nav_msgs/msg/MapMetaData.msg")),
        ("geometry_msgs/Pose", include_str!("../../definitions/geometry_msgs/msg/Pose.msg")),
        ("geometry_msgs/Point", include_str!("../../definitions/geometry_msgs/msg/Point.msg")),
        ("geometry_msgs/Quaternion", include_str!("../../definitions/geometry_msgs/msg/Quaternion.msg")),
    ];
}

/// `nav_msgs/OccupancyGrid`.
#[derive(Clone, Debug, Default, PartialEq, Readable, Writable)]
pub struct OccupancyGrid {
    pub header: super::std_msgs::Header,
    pub info: MapMetaData,
    pub data: Vec<i8>,
}

impl Message for OccupancyGrid {
    const TYPE: &'static str = "nav_msgs/OccupancyGrid";
    const MD5: &'static str = "3381f2d731d4076ec5c71b0759edbe4e";
    const DEFINITIONS: &'static [(&'static str, &'static str)] = &[
        ("nav_msgs/OccupancyGrid", include_str!("../../definitions/nav_msgs/msg/OccupancyGrid.msg")),
        ("std_msgs/Header", include_str!("../../definitions/std_msgs/msg/Header.msg")),
        ("nav_msgs/MapMetaData", include_str!("../../definitions/nav_msgs/msg/MapMetaData.msg")),
        ("geometry_msgs/Pose", include_str!("../../definitions/geometry_msgs/msg/Pose.msg")),
        ("geometry_msgs/Point", include_str!("../../definitions/geometry_msgs/msg/Point.msg")),
        ("geometry_msgs/Quaternion", include_str!("../../definitions/geometry_msgs/msg/Quaternion.msg")),
    ];
}
