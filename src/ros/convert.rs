//! Estimates as ROS messages.

use super::markers::{Style, markers, point};
use crate::app::Estimate;
use crate::config::FrameKnobs;
use crate::geometry::{Pose2, PoseCovariance};
use crate::messages::geometry_msgs::{
    Covariance, PoseStamped, PoseWithCovariance, TransformStamped, TwistWithCovariance, full_covariance,
};
use crate::messages::nav_msgs::Odometry;
use crate::messages::own::MatchReport;
use crate::messages::std_msgs::Header;
use crate::messages::visualization_msgs::Marker;
use crate::odometry::{MatchedPoints, OdometryCounters, Registration};

/// Variance of what a planar scan does not observe: height, roll and pitch, m^2 and rad^2.
const UNOBSERVED: f64 = 1e6;
/// Least variance: filters reject a covariance of zero, and no estimate is that good, m^2 and rad^2.
const LEAST_VARIANCE: f64 = 1e-9;

/// What is not known at all has the variance of what is not observed.
pub(super) fn covariance(planar: &PoseCovariance) -> Covariance {
    let known = planar.iter().all(|v| v.is_finite());
    let mut planar = if known { *planar } else { PoseCovariance::from_diagonal_element(UNOBSERVED) };
    (0..3).for_each(|i| planar[(i, i)] = planar[(i, i)].max(LEAST_VARIANCE));
    full_covariance(&planar, UNOBSERVED)
}

/// Where `child` is, in the frame of the header.
pub(super) fn transform(header: Header, child: &str, parent_from_child: Pose2) -> TransformStamped {
    TransformStamped { header, child_frame_id: child.into(), transform: parent_from_child.into() }
}

/// An estimate with what the headers of its messages need.
pub(super) struct Outgoing<'a> {
    pub(super) estimate: &'a Estimate,
    /// Number of the estimate, for the headers.
    pub(super) number: u32,
    pub(super) frames: &'a FrameKnobs,
}

impl Outgoing<'_> {
    fn header(&self, frame: &str) -> Header {
        Header::new(self.number, self.estimate.stamp, frame)
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
        PoseStamped { header: self.map_header(), pose: self.estimate.registration.map_from_base().into() }
    }

    pub(super) fn odometry(&self) -> Odometry {
        let answer = &self.estimate.registration;
        Odometry {
            header: self.odom_header(),
            child_frame_id: self.frames.base_frame.clone(),
            pose: PoseWithCovariance { pose: answer.odom_from_base.into(), covariance: covariance(&answer.covariance) },
            twist: TwistWithCovariance { twist: answer.twist.into(), covariance: covariance(&answer.twist_covariance) },
        }
    }

    /// From the map by way of the odometry to the base.
    pub(super) fn transforms(&self) -> [TransformStamped; 2] {
        let &Registration { map_from_odom, odom_from_base, .. } = &self.estimate.registration;
        [
            transform(self.map_header(), &self.frames.odom_frame, map_from_odom),
            transform(self.odom_header(), &self.frames.base_frame, odom_from_base),
        ]
    }

    /// What there is to say of the estimate.
    pub(super) fn report(&self, counters: &OdometryCounters, dropped: u64) -> MatchReport {
        self.estimate.report(self.odom_header(), counters, dropped)
    }

    /// The reference scan, the sensed points and the pairs between them.
    pub(super) fn markers(&self, matched: &MatchedPoints) -> [Marker; 3] {
        let style = |kind, width, color| Style { kind, width, color };
        let sensed = matched.pairs.iter().map(|(sensed, _)| point(sensed)).collect();
        let ends = matched.pairs.iter().flat_map(|(sensed, partner)| [point(sensed), point(partner)]).collect();
        let shown = [
            (style(Marker::POINTS, 0.04, [0.35, 0.45, 0.65]), matched.reference.iter().map(point).collect()),
            (style(Marker::POINTS, 0.04, [0.95, 0.55, 0.1]), sensed),
            (style(Marker::LINE_LIST, 0.01, [0.3, 0.8, 0.3]), ends),
        ];
        markers(&self.map_header(), "scan_match", shown)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_planar_covariance_takes_its_places_among_six() {
        let planar = PoseCovariance::new(1.0, 2.0, 3.0, 2.0, 5.0, 6.0, 3.0, 6.0, 0.0);
        let full = covariance(&planar);
        let holds = |row: usize, values: [f64; 6]| assert_eq!(full[row].map(f64::to_bits), values.map(f64::to_bits), "{row}");
        holds(0, [1.0, 2.0, 0.0, 0.0, 0.0, 3.0]);
        holds(1, [2.0, 5.0, 0.0, 0.0, 0.0, 6.0]);
        holds(5, [3.0, 6.0, 0.0, 0.0, 0.0, LEAST_VARIANCE]);
        assert!((2..5).all(|i| full[i][i].to_bits() == UNOBSERVED.to_bits()));
        assert!(covariance(&PoseCovariance::from_element(f64::NAN)).as_flattened().iter().all(|v| v.is_finite()));
    }
}
