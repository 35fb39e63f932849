//! What messages say of the base, for all that listen: laser odometry and the particle filter.

use nalgebra::{Isometry3, Vector3};

use super::{InputError, planar_pose, planar_twist};
use crate::config::FrameKnobs;
use crate::geometry::Pose2;
use crate::messages::geometry_msgs::{self, Twist};
use crate::messages::nav_msgs::Odometry;
use crate::odometry::wheel::WheelSample;
use crate::transforms::{TransformTree, frame_name, rigid_motion};

/// What odometry says of the base. That of another frame, such as a tracking camera's, is turned into the base's by the transforms, in
/// space; the two frames must be fixed to one another. An empty `child_frame_id` is taken for the base's.
pub(super) fn wheel_sample(
    message: &Odometry,
    transforms: &TransformTree,
    frames: &FrameKnobs,
) -> Result<WheelSample, InputError> {
    let stamp = message.header.stamp.into();
    let (pose, twist) = (planar_pose(&message.pose.pose)?, &message.twist.twist);
    let (child, base) = (frame_name(&message.child_frame_id), frame_name(&frames.base_frame));
    if child.is_empty() || child == base {
        return Ok(WheelSample { stamp, pose, twist: planar_twist(twist) });
    }
    // Through the frames that it moves in, a transform would only say what was estimated.
    let moving = [&*message.header.frame_id, &*frames.odom_frame, &*frames.map_frame].map(frame_name);
    let child_from_base = transforms
        .fixed(child, base, &moving)
        .ok_or_else(|| InputError::OdometryOfAnotherFrame { child: child.into(), base: base.into() })?;
    let geometry_msgs::Pose { position: p, orientation } = &message.pose.pose;
    let odom_from_child = rigid_motion([p.x, p.y, p.z], orientation).ok_or(InputError::PoseNotFinite)?;
    let odom_from_base = odom_from_child * child_from_base;
    let (place, forward) = (odom_from_base.translation.vector, odom_from_base.rotation * Vector3::x());
    let pose = Pose2::new(place.x, place.y, forward.y.atan2(forward.x));
    Ok(WheelSample { stamp, pose, twist: planar_twist(&twist_of_base(twist, &child_from_base)) })
}

/// The velocity of a base that is fixed to a child whose velocity this is, each in its own frame.
fn twist_of_base(of_child: &Twist, child_from_base: &Isometry3<f64>) -> Twist {
    let vector = |v: &geometry_msgs::Vector3| Vector3::new(v.x, v.y, v.z);
    let turned = |v: Vector3<f64>| {
        let turned = child_from_base.rotation.inverse() * v;
        geometry_msgs::Vector3 { x: turned.x, y: turned.y, z: turned.z }
    };
    let (linear, angular) = (vector(&of_child.linear), vector(&of_child.angular));
    Twist { linear: turned(linear + angular.cross(&child_from_base.translation.vector)), angular: turned(angular) }
}
