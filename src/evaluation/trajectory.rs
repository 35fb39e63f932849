//! Trajectories: poses in the order of their stamps.

use thiserror::Error;

use crate::geometry::Pose2;
use crate::time::Stamp;

/// A pose with its stamp.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StampedPose {
    /// Time of the pose.
    pub stamp: Stamp,
    /// The pose.
    pub pose: Pose2,
}

/// Why poses are no valid trajectory.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum TrajectoryError {
    /// There is no pose.
    #[error("there is no pose")]
    Empty,
    /// A pose contains NaN or an infinite number.
    #[error("the pose at {stamp} s is not finite")]
    NotFinite {
        /// Stamp of the pose.
        stamp: Stamp,
    },
}

/// A trajectory: at least one pose, all finite, with strictly increasing stamps.
#[derive(Clone, Debug, PartialEq)]
pub struct Trajectory {
    poses: Vec<StampedPose>,
    steps_back: usize,
    duplicates: usize,
}

impl Trajectory {
    /// Sorts the poses by stamp, and keeps the first pose of each stamp. Unsorted and duplicate stamps occur in good logs (a scan sent
    /// twice, merged logs), so neither is an error. Both are counted, because a bag played in a loop looks the same.
    pub fn new(mut poses: Vec<StampedPose>) -> Result<Self, TrajectoryError> {
        if let Some(bad) = poses.iter().find(|p| !p.pose.is_finite()) {
            return Err(TrajectoryError::NotFinite { stamp: bad.stamp });
        }
        if poses.is_empty() {
            return Err(TrajectoryError::Empty);
        }
        let given = poses.len();
        let steps_back = poses.windows(2).filter(|pair| pair[1].stamp < pair[0].stamp).count();
        poses.sort_by_key(|p| p.stamp);
        poses.dedup_by_key(|p| p.stamp);
        let duplicates = given - poses.len();
        Ok(Self { poses, steps_back, duplicates })
    }

    /// The poses; never empty.
    pub fn poses(&self) -> &[StampedPose] {
        &self.poses
    }

    /// Number of input poses with an earlier stamp than the pose before.
    pub fn steps_back(&self) -> usize {
        self.steps_back
    }

    /// Number of poses dropped because an earlier one has the same stamp.
    pub fn duplicates(&self) -> usize {
        self.duplicates
    }

    /// The first and the last pose.
    pub fn ends(&self) -> (&StampedPose, &StampedPose) {
        (&self.poses[0], &self.poses[self.poses.len() - 1])
    }

    /// The pose nearest in time to `stamp`; the earlier one of two equally near ones.
    pub fn nearest(&self, stamp: Stamp) -> &StampedPose {
        let next = self.poses.partition_point(|p| p.stamp < stamp);
        let neighbours = self.poses[next.saturating_sub(1)..].iter().take(2);
        let nearest = neighbours.min_by_key(|p| p.stamp.nanoseconds().abs_diff(stamp.nanoseconds()));
        nearest.unwrap_or(&self.poses[0])
    }

    /// The pose interpolated to `stamp`; `None` outside the trajectory.
    pub fn interpolated(&self, stamp: Stamp) -> Option<Pose2> {
        let next = self.poses.partition_point(|p| p.stamp < stamp);
        let after = self.poses.get(next)?;
        if after.stamp == stamp {
            return Some(after.pose);
        }
        let before = self.poses.get(next.checked_sub(1)?)?;
        let fraction = stamp.seconds_since(before.stamp) / after.stamp.seconds_since(before.stamp);
        Some(before.pose.interpolate(&after.pose, fraction))
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn along_x(stamps: &[i64]) -> Vec<StampedPose> {
        stamps
            .iter()
            .map(|&ns| StampedPose { stamp: Stamp::from_nanoseconds(ns), pose: Pose2::new(ns as f64, 0.0, 0.0) })
            .collect()
    }

    #[test]
    fn sorts_and_keeps_the_first_of_equal_stamps() {
        let mut poses = along_x(&[30, 10, 20, 10]);
        poses[3].pose.y = 9.0;
        let trajectory = Trajectory::new(poses).unwrap();
        assert_eq!(trajectory.poses(), along_x(&[10, 20, 30]));
        assert_eq!((trajectory.steps_back(), trajectory.duplicates()), (2, 1));
    }

    #[test]
    fn rejects_empty_trajectories_and_nan() {
        assert_eq!(Trajectory::new(vec![]), Err(TrajectoryError::Empty));
        let mut poses = along_x(&[1, 2]);
        poses[1].pose.theta = f64::NAN;
        assert_eq!(Trajectory::new(poses), Err(TrajectoryError::NotFinite { stamp: Stamp::from_nanoseconds(2) }));
    }

    #[test]
    fn nearest_prefers_the_earlier_of_two_equally_near_poses() {
        let trajectory = Trajectory::new(along_x(&[10, 20, 30])).unwrap();
        let nearest = |ns| trajectory.nearest(Stamp::from_nanoseconds(ns)).stamp.nanoseconds();
        assert_eq!([-5, 10, 14, 15, 16, 30, 99].map(nearest), [10, 10, 10, 10, 20, 30, 30]);
        assert_eq!(Trajectory::new(along_x(&[7])).unwrap().nearest(Stamp::from_nanoseconds(99)).stamp.nanoseconds(), 7);
    }

    #[test]
    fn interpolates_but_does_not_extrapolate() {
        let trajectory = Trajectory::new(along_x(&[10, 20])).unwrap();
        let x = |ns| trajectory.interpolated(Stamp::from_nanoseconds(ns)).map(|p| p.x);
        assert_eq!([9, 10, 15, 20, 21].map(x), [None, Some(10.0), Some(15.0), Some(20.0), None]);
    }
}
