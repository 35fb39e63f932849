//! `anytime_scan_matcher`: the messages this project defines.

#![allow(missing_docs)] // the fields are those of the definitions under msg/

use serde::{Deserialize, Serialize};

use super::Message;

/// `anytime_scan_matcher/Contract`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Contract {
    pub header: super::std_msgs::Header,
    pub time_budget: super::Duration,
    pub translation_error_bound: f64,
    pub rotation_error_bound: f64,
}

impl Message for Contract {
    const TYPE: &'static str = "anytime_scan_matcher/Contract";
    const MD5: &'static str = "ec3f14ad03e5846fa3616163a5021ea8";
    const DEFINITIONS: &'static [(&'static str, &'static str)] = &[
        ("anytime_scan_matcher/Contract", include_str!("../../msg/anytime_scan_matcher/msg/Contract.msg")),
        ("std_msgs/Header", include_str!("../../msg/std_msgs/msg/Header.msg")),
    ];
}
