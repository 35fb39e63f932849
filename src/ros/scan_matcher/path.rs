//! The path so far, for display.

use std::collections::VecDeque;
use std::time::Duration;

use crate::geometry::Pose2;
use crate::messages::geometry_msgs::PoseStamped;

/// Maximum number of poses: 500 m at the spacing below.
const MAX_POSES: usize = 10_000;
/// Distance after which a pose is added, m.
const SPACING: f64 = 0.05;
/// Rotation after which a pose is added, rad.
const ROTATION: f64 = 0.1;
/// Minimum time between two messages, since the path is long.
const PERIOD: Duration = Duration::from_millis(500);

/// Poses along the path.
#[derive(Default)]
pub(super) struct PathHistory {
    poses: VecDeque<PoseStamped>,
    last: Option<Pose2>,
    sent: Option<Duration>,
}

impl PathHistory {
    pub(super) fn clear(&mut self) {
        self.poses.clear();
        self.last = None;
    }

    /// Adds a pose if it is far enough from the last one.
    pub(super) fn add(&mut self, pose: &Pose2, message: impl FnOnce() -> PoseStamped) {
        let far = |last: Pose2| {
            let motion = last.between(pose);
            motion.distance() >= SPACING || motion.theta.abs() >= ROTATION
        };
        if self.last.is_none_or(far) {
            self.last = Some(*pose);
            if self.poses.len() == MAX_POSES {
                self.poses.pop_front();
            }
            self.poses.push_back(message());
        }
    }

    /// Returns the poses if it is time to publish them again.
    pub(super) fn due(&mut self, now: Duration) -> Option<Vec<PoseStamped>> {
        let due = self.sent.is_none_or(|sent| now.saturating_sub(sent) >= PERIOD);
        due.then(|| {
            self.sent = Some(now);
            self.poses.iter().cloned().collect()
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_path_is_thinned_and_bounded_and_published_at_a_limited_rate() {
        let mut path = PathHistory::default();
        for step in 0..(2 * MAX_POSES + 100) {
            path.add(&Pose2::new(0.03 * step as f64, 0.0, 0.0), PoseStamped::default);
        }
        assert_eq!(path.due(Duration::ZERO).unwrap().len(), MAX_POSES);
        assert!(path.due(PERIOD / 2).is_none() && path.due(PERIOD).is_some());
        path.clear();
        assert!(path.due(2 * PERIOD).unwrap().is_empty());
    }
}
