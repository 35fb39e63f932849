//! Estimates as ROS messages.

use nalgebra::Matrix3;
use rosrust_msg::anytime_scan_matcher::MatchReport;
use rosrust_msg::geometry_msgs::{
    Point as PointMessage, Pose, PoseStamped, PoseWithCovariance, Quaternion, Transform, TransformStamped, Twist,
    TwistWithCovariance, Vector3,
};
use rosrust_msg::nav_msgs::Odometry;
use rosrust_msg::std_msgs::{ColorRGBA, Header};
use rosrust_msg::visualization_msgs::Marker;

use crate::app::Estimate;
use crate::config::FrameKnobs;
use crate::geometry::{Point, Pose2, PoseCovariance};
use crate::io::profile_file::ExpectedError;
use crate::odometry::{MatchedPoints, OdometryCounters, Outcome, Registration};

/// Variance of what a scan in the plane says nothing about: height, roll and pitch, in m^2 and rad^2.
const UNOBSERVED: f64 = 1e6;
/// Filters refuse a covariance of zero, and no estimate is that good, m^2 and rad^2.
const LEAST_VARIANCE: f64 = 1e-9;

/// One estimate on its way out.
pub(super) struct Answer<'a> {
    pub(super) estimate: &'a Estimate,
    /// Number of the estimate, for the headers.
    pub(super) number: u32,
    pub(super) frames: &'a FrameKnobs,
}

impl Answer<'_> {
    fn header(&self, frame: &str) -> Header {
        let (sec, nsec) = self.estimate.stamp.to_ros();
        Header { seq: self.number, stamp: rosrust::Time { sec, nsec }, frame_id: frame.into() }
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
        let twist = Twist {
            linear: Vector3 { x: answer.twist.vx, y: answer.twist.vy, z: 0.0 },
            angular: Vector3 { x: 0.0, y: 0.0, z: answer.twist.omega },
        };
        Odometry {
            header: self.odom_header(),
            child_frame_id: self.frames.base_frame.clone(),
            pose: PoseWithCovariance { pose: pose(&answer.odom_from_base), covariance: covariance(&answer.covariance) },
            twist: TwistWithCovariance { twist, covariance: covariance(&answer.twist_covariance) },
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
            Outcome::Predicted(problem) => (MatchReport::PREDICTED, problem.clone()),
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

    fn marker(&self, id: i32, kind: u8, size: f64, [r, g, b]: [f32; 3], points: Vec<PointMessage>) -> Marker {
        Marker {
            header: self.map_header(),
            ns: "scan_match".into(),
            id,
            type_: i32::from(kind),
            action: i32::from(Marker::ADD),
            pose: pose(&Pose2::IDENTITY),
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

/// A pose of the plane.
pub(super) fn pose(pose: &Pose2) -> Pose {
    let (z, w) = (0.5 * pose.theta).sin_cos();
    Pose { position: PointMessage { x: pose.x, y: pose.y, z: 0.0 }, orientation: Quaternion { x: 0.0, y: 0.0, z, w } }
}

/// Where `child` is, in the frame of the header.
pub(super) fn transform(header: Header, child: &str, parent_from_child: &Pose2) -> TransformStamped {
    let Pose { position, orientation } = pose(parent_from_child);
    let translation = Vector3 { x: position.x, y: position.y, z: position.z };
    TransformStamped { header, child_frame_id: child.into(), transform: Transform { translation, rotation: orientation } }
}

/// Order x, y, z, roll, pitch, yaw, row by row.
pub(super) fn covariance(planar: &PoseCovariance) -> [f64; 36] {
    const PLACES: [usize; 3] = [0, 1, 5];
    let mut full = [0.0; 36];
    for unobserved in [2, 3, 4] {
        full[7 * unobserved] = UNOBSERVED;
    }
    let planar = if planar.iter().all(|v| v.is_finite()) { *planar } else { Matrix3::from_diagonal_element(UNOBSERVED) };
    for (i, row) in PLACES.into_iter().enumerate() {
        for (j, column) in PLACES.into_iter().enumerate() {
            let least = if i == j { LEAST_VARIANCE } else { f64::NEG_INFINITY };
            full[6 * row + column] = planar[(i, j)].max(least);
        }
    }
    full
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_planar_covariance_takes_its_places_among_six() {
        let planar = Matrix3::new(1.0, 2.0, 3.0, 2.0, 5.0, 6.0, 3.0, 6.0, 0.0);
        let full = covariance(&planar);
        let holds = |places: [usize; 3], values: [f64; 3]| {
            assert_eq!(places.map(|place| full[place].to_bits()), values.map(f64::to_bits), "{places:?}");
        };
        holds([0, 1, 5], [1.0, 2.0, 3.0]);
        holds([6, 7, 11], [2.0, 5.0, 6.0]);
        holds([30, 31, 35], [3.0, 6.0, LEAST_VARIANCE]);
        holds([14, 21, 28], [UNOBSERVED; 3]);
        assert!(covariance(&Matrix3::from_element(f64::NAN)).iter().all(|v| v.is_finite()));
    }

    #[test]
    fn a_heading_becomes_a_unit_quaternion() {
        let q = pose(&Pose2::new(0.0, 0.0, 1.2)).orientation;
        assert!((2.0 * q.z.atan2(q.w) - 1.2).abs() < 1e-12 && (q.z.hypot(q.w) - 1.0).abs() < 1e-12);
    }
}
