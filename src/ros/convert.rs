//! Estimates as ROS messages.

use rosrust_msg::anytime_scan_matcher::MatchReport;
use rosrust_msg::geometry_msgs::{
    Point as PointMessage, PoseStamped, PoseWithCovariance, TransformStamped, TwistWithCovariance, Vector3,
};
use rosrust_msg::nav_msgs::Odometry;
use rosrust_msg::std_msgs::{ColorRGBA, Header};
use rosrust_msg::visualization_msgs::Marker;

use super::fields::{covariance, header, pose, transform, twist};
use crate::app::Estimate;
use crate::config::FrameKnobs;
use crate::geometry::{Point, Pose2};
use crate::io::profile_file::ExpectedError;
use crate::odometry::{MatchedPoints, OdometryCounters, Outcome, Registration};

/// Height of one marker above another, m.
const LAYER: f64 = 0.02;

/// One estimate on its way out.
pub(super) struct Answer<'a> {
    pub(super) estimate: &'a Estimate,
    /// Number of the estimate, for the headers.
    pub(super) number: u32,
    pub(super) frames: &'a FrameKnobs,
}

impl Answer<'_> {
    fn header(&self, frame: &str) -> Header {
        header(self.number, self.estimate.stamp, frame)
    }

    /// Of what is on the map.
    pub(super) fn map_header(&self) -> Header {
        self.header(&self.frames.map_frame)
    }

    /// Of what never jumps.
    pub(super) fn odom_header(&self) -> Header {
        self.header(&self.frames.odom_frame)
    }

    /// Where the base is on the map.
    pub(super) fn pose_stamped(&self) -> PoseStamped {
        PoseStamped { header: self.map_header(), pose: pose(&self.estimate.registration.map_from_base()) }
    }

    pub(super) fn odometry(&self) -> Odometry {
        let answer = &self.estimate.registration;
        Odometry {
            header: self.odom_header(),
            child_frame_id: self.frames.base_frame.clone(),
            pose: PoseWithCovariance { pose: pose(&answer.odom_from_base), covariance: covariance(&answer.covariance) },
            twist: TwistWithCovariance { twist: twist(&answer.twist), covariance: covariance(&answer.twist_covariance) },
        }
    }

    /// From the map by way of the odometry to the base.
    pub(super) fn transforms(&self) -> [TransformStamped; 2] {
        let Registration { map_from_odom, odom_from_base, .. } = &self.estimate.registration;
        [
            transform(self.map_header(), &self.frames.odom_frame, map_from_odom),
            transform(self.odom_header(), &self.frames.base_frame, odom_from_base),
        ]
    }

    /// What there is to say of the estimate; numbers of a refinement that was not made are NaN.
    pub(super) fn report(&self, counters: &OdometryCounters, dropped: u64) -> MatchReport {
        let (estimate, answer) = (self.estimate, &self.estimate.registration);
        let refinement = answer.refinement.as_ref();
        let number = |value: fn(&_) -> f64| refinement.map_or(f64::NAN, value);
        let count = |value: fn(&_) -> u32| refinement.map_or(0, value);
        let (rays, rays_used, inliers) = (count(|r| r.rays), count(|r| r.rays_used), count(|r| r.inliers));
        let expected = |value: fn(&ExpectedError) -> f64| estimate.expected_error.as_ref().map_or(f64::NAN, value);
        let (outcome, reason) = match &answer.outcome {
            Outcome::Matched => (MatchReport::MATCHED, String::new()),
            Outcome::First => (MatchReport::FIRST, String::new()),
            Outcome::Predicted(problem) => (MatchReport::PREDICTED, problem.text.clone()),
        };
        MatchReport {
            header: self.odom_header(),
            outcome,
            ok: answer.outcome.is_ok(),
            stop_reason: refinement.map_or_else(String::new, |r| r.stop_reason.name().into()),
            reason,
            time_budget: estimate.contract.time_budget.unwrap_or_default().into(),
            translation_error_bound: estimate.contract.translation_error_bound.unwrap_or_default(),
            rotation_error_bound: estimate.contract.rotation_error_bound.unwrap_or_default(),
            elapsed: estimate.elapsed.into(),
            deadline_met: estimate.deadline_met(),
            overrun: estimate.overrun().into(),
            translation_error_excess: estimate.error_excess().translation,
            rotation_error_excess: estimate.error_excess().rotation,
            expected_translation_error: expected(|e| e.position_mean_m),
            expected_translation_error_p95: expected(|e| e.position_p95_m),
            expected_rotation_error: expected(|e| e.orientation_mean_rad),
            expected_rotation_error_p95: expected(|e| e.orientation_p95_rad),
            outside_profile: estimate.outside_profile.map_or_else(String::new, |outside| outside.to_string()),
            iterations: count(|r| r.iterations),
            rays,
            rays_used,
            correspondences: count(|r| r.correspondences),
            inliers,
            mean_residual: number(|r| r.mean_residual),
            inlier_ratio: f64::from(inliers) / f64::from(rays_used.max(1)),
            predicted_translation_error: answer.predicted_error.translation,
            predicted_rotation_error: answer.predicted_error.rotation,
            translation_error: answer.estimated_error.translation,
            rotation_error: answer.estimated_error.rotation,
            condition_number: number(|r| r.condition_number),
            free_direction: number(|r| r.free_direction.unwrap_or(f64::NAN)),
            disbelieved: answer.disbelieved.names().collect::<Vec<_>>().join(" "),
            new_keyframe: answer.new_keyframe,
            keyframes: u32::try_from(counters.keyframes).unwrap_or(u32::MAX),
            closed_loops: u32::try_from(counters.closed_loops).unwrap_or(u32::MAX),
            dropped: u32::try_from(dropped).unwrap_or(u32::MAX),
        }
    }

    /// The reference scan, the sensed points and the pairs between them.
    pub(super) fn markers(&self, matched: &MatchedPoints) -> [Marker; 3] {
        let sensed = matched.pairs.iter().map(|(sensed, _)| point(sensed)).collect();
        let ends = matched.pairs.iter().flat_map(|(sensed, partner)| [point(sensed), point(partner)]).collect();
        [
            self.marker(0, Marker::POINTS, 0.04, [0.35, 0.45, 0.65], matched.reference.iter().map(point).collect()),
            self.marker(1, Marker::POINTS, 0.04, [0.95, 0.55, 0.1], sensed),
            self.marker(2, Marker::LINE_LIST, 0.01, [0.3, 0.8, 0.3], ends),
        ]
    }

    /// Each lies a little above the one before, or what matches would hide each other by turns.
    fn marker(&self, id: i32, kind: u8, size: f64, [r, g, b]: [f32; 3], points: Vec<PointMessage>) -> Marker {
        let mut place = pose(&Pose2::IDENTITY);
        place.position.z = LAYER * f64::from(id);
        Marker {
            header: self.map_header(),
            ns: "scan_match".into(),
            id,
            type_: i32::from(kind),
            action: i32::from(Marker::ADD),
            pose: place,
            scale: Vector3 { x: size, y: size, z: 0.0 },
            color: ColorRGBA { r, g, b, a: 1.0 },
            points,
            ..Default::default()
        }
    }
}

fn point(p: &Point) -> PointMessage {
    PointMessage { x: p.x, y: p.y, z: 0.0 }
}
