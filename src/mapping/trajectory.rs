//! Where every scan was taken, by the keyframes before and after it.

use super::keyframe::Keyframe;
use crate::geometry::Pose2;
use crate::time::Stamp;

/// A scan's place along the path.
#[derive(Clone, Copy, Debug)]
pub struct Step {
    /// When the scan was taken.
    pub stamp: Stamp,
    /// The last keyframe up to it.
    pub keyframe: usize,
    /// Pose of the base by odometry.
    pub odom_from_base: Pose2,
    /// Pose of the laser by odometry.
    pub odom_from_laser: Pose2,
    /// Way since that keyframe, with turns as ways, m.
    pub way: f64,
}

/// Poses between keyframes: odometry from the one before, and what it has erred by at the one after, by the share of the way.
pub(super) struct Placer<'a> {
    pub(super) keyframes: &'a [Keyframe],
    /// Of the keyframes' lasers.
    pub(super) poses: &'a [Pose2],
    /// Way from each keyframe to the next, as [`Step::way`] counts it, m.
    pub(super) ways: &'a [f64],
}

impl Placer<'_> {
    /// A pose of the odometry's frame, at a step, on the map.
    pub(super) fn place(&self, step: &Step, odom_pose: &Pose2) -> Pose2 {
        let (k, next) = (step.keyframe, step.keyframe + 1);
        let forwards = self.poses[k] * self.keyframes[k].odom_from_laser.between(odom_pose);
        let follows = self.keyframes.get(next).is_some_and(|next| next.run == self.keyframes[k].run);
        let way = self.ways.get(k).copied().unwrap_or_default();
        if !follows || way <= 0.0 {
            return forwards;
        }
        let backwards = self.poses[next] * self.keyframes[next].odom_from_laser.between(odom_pose);
        forwards.interpolate(&backwards, (step.way / way).clamp(0.0, 1.0))
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
    fn scans_are_where_the_keyframes_around_them_say() {
        let beams = BeamGeometry::new(0.0, 0.1, 30);
        let scan = Scan::new(Stamp::default(), beams.into(), (0.0, 10.0), vec![1.0; 30]).unwrap();
        let view = EdgeMatcher::new(&MatchingKnobs::default(), &RejectionKnobs::default()).view(scan);
        let keyframe = |x: f64, run: usize| {
            let odom_from_laser = Pose2::new(x, 0.0, 0.0);
            Keyframe { stamp: Stamp::default(), odom_from_laser, view: Some(view.clone()), run, way: x }
        };
        let keyframes = [keyframe(0.0, 0), keyframe(1.0, 0), keyframe(0.0, 1)];
        let poses = [Pose2::new(5.0, 0.0, 0.0), Pose2::new(6.2, 0.1, 0.0), Pose2::new(9.0, 0.0, 0.0)];
        let placer = Placer { keyframes: &keyframes, poses: &poses, ways: &[1.0, 0.0, 0.0] };
        let place = |keyframe: usize, way: f64| {
            let odom = Pose2::new(keyframes[keyframe].odom_from_laser.x + way, 0.0, 0.0);
            let step = Step { stamp: Stamp::default(), keyframe, odom_from_base: odom, odom_from_laser: odom, way };
            placer.place(&step, &odom)
        };
        assert_eq!(place(0, 0.0), poses[0]);
        let half = place(0, 0.5);
        assert!((half.x - 5.6).abs() < 1e-12 && (half.y - 0.05).abs() < 1e-12, "{half:?}");
        assert_eq!(place(0, 1.0), poses[1]);
        assert_eq!(place(1, 0.5), Pose2::new(6.7, 0.1, 0.0), "what follows is of another run");
    }
}
