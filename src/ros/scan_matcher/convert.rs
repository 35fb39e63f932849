//! Conversion of estimates to ROS messages.

use crate::app::Estimate;
use crate::config::FrameKnobs;
use crate::messages::geometry_msgs::{PoseStamped, PoseWithCovariance, TransformStamped, TwistWithCovariance};
use crate::messages::nav_msgs::Odometry;
use crate::messages::own::MatchReport;
use crate::messages::std_msgs::Header;
use crate::messages::visualization_msgs::Marker;
use crate::odometry::{MatchedPoints, OdometryCounters, Registration};
use crate::ros::convert::{covariance, transform};
use crate::ros::markers::{Style, markers, point};

/// An estimate to be published, with the data for the headers of its messages.
pub(super) struct Outgoing<'a> {
    pub(super) estimate: &'a Estimate,
    /// Sequence number for the headers.
    pub(super) number: u32,
    pub(super) frames: &'a FrameKnobs,
}

impl Outgoing<'_> {
    fn header(&self, frame: &str) -> Header {
        Header::new(self.number, self.estimate.stamp, frame)
    }

    /// Header of messages in the map frame.
    pub(super) fn map_header(&self) -> Header {
        self.header(&self.frames.map_frame)
    }

    /// Header of messages in the odometry frame, in which the pose never jumps.
    pub(super) fn odom_header(&self) -> Header {
        self.header(&self.frames.odom_frame)
    }

    /// The pose of the base in the map frame.
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

    /// The transforms from the map to the odometry frame, and from there to the base.
    pub(super) fn transforms(&self) -> [TransformStamped; 2] {
        let &Registration { map_from_odom, odom_from_base, .. } = &self.estimate.registration;
        [
            transform(self.map_header(), &self.frames.odom_frame, map_from_odom),
            transform(self.odom_header(), &self.frames.base_frame, odom_from_base),
        ]
    }

    /// The report on the estimate.
    pub(super) fn report(&self, counters: &OdometryCounters, dropped: u64) -> MatchReport {
        self.estimate.report(self.odom_header(), counters, dropped)
    }

    /// The reference points, the matched points of the scan, and lines between the pairs.
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
