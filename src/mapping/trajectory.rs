//! Poses of all scans, interpolated between the optimized keyframes.

use super::keyframe::Keyframe;
use crate::geometry::Pose2;
use crate::time::Stamp;

/// A scan along the path.
#[derive(Clone, Copy, Debug)]
pub(super) struct TrajectoryNode {
    /// When the scan was taken.
    pub(super) stamp: Stamp,
    /// Index of the last keyframe up to the scan.
    pub(super) keyframe: usize,
    /// Pose of the base in the odometry frame.
    pub(super) odom_from_base: Pose2,
    /// Pose of the laser in the odometry frame.
    pub(super) odom_from_laser: Pose2,
    /// Path length since that keyframe, m. A rotation of 1 rad counts as 1 m.
    pub(super) distance: f64,
}

/// Interpolates poses between keyframes: odometry from the keyframe before, with its error at the keyframe after distributed in
/// proportion to the path length.
pub(super) struct TrajectoryInterpolator<'a> {
    pub(super) keyframes: &'a [Keyframe],
    /// Poses of the keyframes' lasers on the map.
    pub(super) poses: &'a [Pose2],
    /// Path length from each keyframe to the next, counted like [`TrajectoryNode::distance`], m.
    pub(super) distances_to_next: &'a [f64],
}

impl TrajectoryInterpolator<'_> {
    /// Transforms a pose from the odometry frame to the map, for a given scan.
    pub(super) fn map_pose(&self, node: &TrajectoryNode, odom_pose: &Pose2) -> Pose2 {
        let (k, next) = (node.keyframe, node.keyframe + 1);
        let forward = self.poses[k] * self.keyframes[k].odom_from_laser.between(odom_pose);
        let is_followed = self.keyframes.get(next).is_some_and(|next| next.run == self.keyframes[k].run);
        let distance = self.distances_to_next.get(k).copied().unwrap_or_default();
        if !is_followed || distance <= 0.0 {
            return forward;
        }
        let backward = self.poses[next] * self.keyframes[next].odom_from_laser.between(odom_pose);
        forward.interpolate(&backward, (node.distance / distance).clamp(0.0, 1.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mapping::edges::EdgeMatcher;
    use crate::matching::MatchingKnobs;
    use crate::matching::classic::rejection::RejectionKnobs;
    use crate::scan::{BeamGeometry, Scan};

    #[test]
    fn scans_are_interpolated_between_their_keyframes() {
        let beams = BeamGeometry::new(0.0, 0.1, 30);
        let scan = Scan::new(Stamp::default(), beams.into(), (0.0, 10.0), vec![1.0; 30]).unwrap();
        let view = EdgeMatcher::new(&MatchingKnobs::default(), &RejectionKnobs::default()).view(scan);
        let keyframe = |x: f64, run: usize| {
            let odom_from_laser = Pose2::new(x, 0.0, 0.0);
            Keyframe { stamp: Stamp::default(), odom_from_laser, view: Some(view.clone()), run, path_length: x }
        };
        let keyframes = [keyframe(0.0, 0), keyframe(1.0, 0), keyframe(0.0, 1)];
        let poses = [Pose2::new(5.0, 0.0, 0.0), Pose2::new(6.2, 0.1, 0.0), Pose2::new(9.0, 0.0, 0.0)];
        let interpolator = TrajectoryInterpolator { keyframes: &keyframes, poses: &poses, distances_to_next: &[1.0, 0.0, 0.0] };
        let map_pose = |keyframe: usize, distance: f64| {
            let odom = Pose2::new(keyframes[keyframe].odom_from_laser.x + distance, 0.0, 0.0);
            let node =
                TrajectoryNode { stamp: Stamp::default(), keyframe, odom_from_base: odom, odom_from_laser: odom, distance };
            interpolator.map_pose(&node, &odom)
        };
        assert_eq!(map_pose(0, 0.0), poses[0]);
        let half = map_pose(0, 0.5);
        assert!((half.x - 5.6).abs() < 1e-12 && (half.y - 0.05).abs() < 1e-12, "{half:?}");
        assert_eq!(map_pose(0, 1.0), poses[1]);
        assert_eq!(map_pose(1, 0.5), Pose2::new(6.7, 0.1, 0.0), "the next keyframe belongs to another run");
    }
}
