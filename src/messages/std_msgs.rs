//! `std_msgs`.

#![allow(missing_docs)] // the fields are those of the message definitions

use speedy::{Readable, Writable};

use super::Message;

/// `std_msgs/Header`.
#[derive(Clone, Debug, Default, PartialEq, Readable, Writable)]
pub struct Header {
    pub seq: u32,
    pub stamp: super::Time,
    pub frame_id: String,
}

/// `std_msgs/Empty`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Readable, Writable)]
pub struct Empty {}

impl Message for Empty {
    const TYPE: &'static str = "std_msgs/Empty";
    const MD5: &'static str = "d41d8cd98f00b204e9800998ecf8427e";
    const DEFINITIONS: &'static [(&'static str, &'static str)] =
        &[("std_msgs/Empty", include_str!("../../definitions/std_msgs/msg/Empty.msg"))];
}

/// `std_msgs/Int32`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Readable, Writable)]
pub struct Int32 {
    pub data: i32,
}

impl Message for Int32 {
    const TYPE: &'static str = "std_msgs/Int32";
    const MD5: &'static str = "da5909fbe378aeaf85e547e830cc1bb7";
    const DEFINITIONS: &'static [(&'static str, &'static str)] =
        &[("std_msgs/Int32", include_str!("../../definitions/std_msgs/msg/Int32.msg"))];
}
