//! `anytime_scan_matcher`: the messages this project defines.

#![allow(missing_docs)] // the fields are those of the message definitions

use speedy::{Readable, Writable};

use super::Message;

/// `anytime_scan_matcher/Contract`.
#[derive(Clone, Debug, Default, PartialEq, Readable, Writable)]
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
        ("anytime_scan_matcher/Contract", include_str!("../../msg/Contract.msg")),
        ("std_msgs/Header", include_str!("../../definitions/std_msgs/msg/Header.msg")),
    ];
}

/// `anytime_scan_matcher/MatchReport`.
#[derive(Clone, Debug, Default, PartialEq, Readable, Writable)]
pub struct MatchReport {
    pub header: super::std_msgs::Header,
    pub outcome: u8,
    pub ok: bool,
    pub stop_reason: String,
    pub reason: String,
    pub time_budget: super::Duration,
    pub translation_error_bound: f64,
    pub rotation_error_bound: f64,
    pub elapsed: super::Duration,
    pub deadline_met: bool,
    pub overrun: super::Duration,
    pub translation_error_excess: f64,
    pub rotation_error_excess: f64,
    pub expected_translation_error: f64,
    pub expected_translation_error_p95: f64,
    pub expected_rotation_error: f64,
    pub expected_rotation_error_p95: f64,
    pub outside_profile: String,
    pub iterations: u32,
    pub rays: u32,
    pub rays_used: u32,
    pub correspondences: u32,
    pub inliers: u32,
    pub mean_residual: f64,
    pub inlier_ratio: f64,
    pub predicted_translation_error: f64,
    pub predicted_rotation_error: f64,
    pub translation_error: f64,
    pub rotation_error: f64,
    pub condition_number: f64,
    pub free_direction: f64,
    pub disbelieved: String,
    pub new_keyframe: bool,
    pub keyframes: u32,
    pub closed_loops: u32,
    pub dropped: u32,
}

impl Message for MatchReport {
    const TYPE: &'static str = "anytime_scan_matcher/MatchReport";
    const MD5: &'static str = "29ee1f66cd37763f031e10d5f57002a5";
    const DEFINITIONS: &'static [(&'static str, &'static str)] = &[
        ("anytime_scan_matcher/MatchReport", include_str!("../../msg/MatchReport.msg")),
        ("std_msgs/Header", include_str!("../../definitions/std_msgs/msg/Header.msg")),
    ];
}

/// `anytime_scan_matcher/FilterReport`.
#[derive(Clone, Debug, Default, PartialEq, Readable, Writable)]
pub struct FilterReport {
    pub header: super::std_msgs::Header,
    pub ok: bool,
    pub reason: String,
    pub stop_reason: String,
    pub time_budget: super::Duration,
    pub translation_error_bound: f64,
    pub rotation_error_bound: f64,
    pub elapsed: super::Duration,
    pub deadline_met: bool,
    pub overrun: super::Duration,
    pub localized: bool,
    pub particles: u32,
    pub effective: f64,
    pub beams: u32,
    pub fit: f64,
    pub share: f64,
    pub translation_error: f64,
    pub rotation_error: f64,
    pub dropped: u32,
}

impl Message for FilterReport {
    const TYPE: &'static str = "anytime_scan_matcher/FilterReport";
    const MD5: &'static str = "0cad528a8fe8ab41dd259f1f0c003eb5";
    const DEFINITIONS: &'static [(&'static str, &'static str)] = &[
        ("anytime_scan_matcher/FilterReport", include_str!("../../msg/FilterReport.msg")),
        ("std_msgs/Header", include_str!("../../definitions/std_msgs/msg/Header.msg")),
    ];
}

/// `anytime_scan_matcher/FollowerReport`.
#[derive(Clone, Debug, Default, PartialEq, Readable, Writable)]
pub struct FollowerReport {
    pub header: super::std_msgs::Header,
    pub driving: bool,
    pub reason: String,
    pub lateral_error: f64,
    pub heading_error: f64,
    pub progress: f64,
    pub remaining: f64,
    pub speed: f64,
    pub steering_angle: f64,
    pub lookahead: f64,
    pub pose_age: f64,
    pub path_age: f64,
}

impl Message for FollowerReport {
    const TYPE: &'static str = "anytime_scan_matcher/FollowerReport";
    const MD5: &'static str = "b97d3391119f22026f8e1b5be740b101";
    const DEFINITIONS: &'static [(&'static str, &'static str)] = &[
        ("anytime_scan_matcher/FollowerReport", include_str!("../../msg/FollowerReport.msg")),
        ("std_msgs/Header", include_str!("../../definitions/std_msgs/msg/Header.msg")),
    ];
}
