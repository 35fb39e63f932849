//! `anytime_scan_matcher`: the message types that this project defines.

use super::Duration;
use super::definition::messages;
use super::std_msgs::Header;

messages! { "anytime_scan_matcher":
    Contract { header: Header, time_budget: Duration, translation_error_bound: f64, rotation_error_bound: f64 }
    MatchReport {
        header: Header,
        outcome: u8,
        ok: bool,
        stop_reason: String,
        failure: String,
        reason: String,
        time_budget: Duration,
        translation_error_bound: f64,
        rotation_error_bound: f64,
        elapsed: Duration,
        deadline_met: bool,
        overrun: Duration,
        translation_error_excess: f64,
        rotation_error_excess: f64,
        expected_translation_error: f64,
        expected_translation_error_p95: f64,
        expected_rotation_error: f64,
        expected_rotation_error_p95: f64,
        outside_profile: String,
        iterations: u32,
        rays: u32,
        rays_used: u32,
        correspondences: u32,
        inliers: u32,
        mean_residual: f64,
        inlier_ratio: f64,
        predicted_translation_error: f64,
        predicted_rotation_error: f64,
        translation_error: f64,
        rotation_error: f64,
        condition_number: f64,
        free_direction: f64,
        disbelieved: String,
        new_keyframe: bool,
        keyframes: u32,
        closed_loops: u32,
        dropped: u32,
    }
    FilterReport {
        header: Header,
        ok: bool,
        failure: String,
        reason: String,
        stop_reason: String,
        time_budget: Duration,
        translation_error_bound: f64,
        rotation_error_bound: f64,
        elapsed: Duration,
        deadline_met: bool,
        overrun: Duration,
        localized: bool,
        particles: u32,
        effective: f64,
        beams: u32,
        fit: f64,
        explained: f64,
        share: f64,
        translation_error: f64,
        rotation_error: f64,
        dropped: u32,
    }
    FollowerReport {
        header: Header,
        driving: bool,
        stop_reason: String,
        reason: String,
        lateral_error: f64,
        heading_error: f64,
        progress: f64,
        remaining: f64,
        speed: f64,
        steering_angle: f64,
        lookahead: f64,
        pose_age: f64,
        path_age: f64,
    }
}

#[allow(missing_docs)] // values of `outcome`, named as in the definition
impl MatchReport {
    pub const MATCHED: u8 = 0;
    pub const PREDICTED: u8 = 1;
    pub const FIRST: u8 = 2;
}
