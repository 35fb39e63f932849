//! `tf2_msgs`.

#![allow(missing_docs)] // the fields are those of the message definitions

use speedy::{Readable, Writable};

use super::Message;

/// `tf2_msgs/TFMessage`.
#[derive(Clone, Debug, Default, PartialEq, Readable, Writable)]
pub struct TFMessage {
    pub transforms: Vec<super::geometry_msgs::TransformStamped>,
}

impl Message for TFMessage {
    const TYPE: &'static str = "tf2_msgs/TFMessage";
    const MD5: &'static str = "94810edda583a504dfda3829e70d7eec";
    const DEFINITIONS: &'static [(&'static str, &'static str)] = &[
        ("tf2_msgs/TFMessage", include_str!("../../definitions/tf2_msgs/msg/TFMessage.msg")),
        ("geometry_msgs/TransformStamped", include_str!("../../definitions/geometry_msgs/msg/TransformStamped.msg")),
        ("std_msgs/Header", include_str!("../../definitions/std_msgs/msg/Header.msg")),
        ("geometry_msgs/Transform", include_str!("../../definitions/geometry_msgs/msg/Transform.msg")),
        ("geometry_msgs/Vector3", include_str!("../../definitions/geometry_msgs/msg/Vector3.msg")),
        ("geometry_msgs/Quaternion", include_str!("../../definitions/geometry_msgs/msg/Quaternion.msg")),
    ];
}
