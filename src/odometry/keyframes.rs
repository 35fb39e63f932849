//! Selects the keyframes that a scan is matched to, and the scans that become keyframes.

use super::keyframe_pose::KeyframePose;
use super::match_problem::MatchProblem;
use super::{LaserOdometry, ReferenceChoice};
use crate::geometry::Pose2;
use crate::scan::Scan;

/// Maximum difference between mounting poses of the same laser, m and rad: tf jitters.
const MAX_MOUNT_DIFFERENCE: f64 = 0.05;

/// A scan that is to become a keyframe.
pub(super) struct PendingKeyframe {
    pub(super) scan: Scan,
    pub(super) pose: KeyframePose,
    /// The motion from the previous keyframe is unknown.
    pub(super) is_lost: bool,
}

impl LaserOdometry {
    /// Prepares the reference for the next scan. Call it after an answer has been published; otherwise [`Self::register_within`]
    /// does it.
    pub fn maintain(&mut self) {
        self.unfinished = None;
        let keeps_map = self.knobs.reference == ReferenceChoice::LocalMap;
        let pending = self.pending_keyframe.take();
        let changes = pending.is_some() || keeps_map;
        if let Some(PendingKeyframe { scan, pose, is_lost }) = pending {
            let max_keyframes = if keeps_map { self.knobs.max_keyframes } else { 1 };
            self.map.add(pose, self.matcher.view(scan), is_lost, max_keyframes as usize);
            self.map.remove_moved_surfaces();
            self.loop_check_pending = keeps_map && self.knobs.close_loops;
        }
        if changes {
            self.select_views();
        }
    }

    /// Selects the keyframes near the previous scan for the next one.
    pub(super) fn select_views(&mut self) {
        if let Some(previous) = self.previous {
            self.select_views_around(&previous.map_from_laser, None);
        }
    }

    /// The reference keyframe for a scan: the one selected near the previous scan, or a new selection if another laser took this
    /// scan, as when two lasers alternate. `None` if no keyframe overlaps with the scan.
    pub(super) fn reference_for(&mut self, scan: &Scan, problem: &MatchProblem) -> Option<KeyframePose> {
        let predicted = problem.predicted_laser();
        if !is_same_mount(&problem.previous.base_from_laser(), &problem.base_from_laser) {
            self.select_views_around(&predicted, Some(scan));
        }
        let rotation = self.keyframe?.heading_from(&predicted);
        let is_seen = self.views.first().is_some_and(|placed| scan.shares_view_with(placed.view.scan(), rotation));
        self.keyframe.filter(|_| is_seen)
    }

    /// Selects the keyframes near a pose, only those that overlap with `scan` if it is given.
    pub(super) fn select_views_around(&mut self, map_from_laser: &Pose2, scan: Option<&Scan>) {
        let count = if self.knobs.reference == ReferenceChoice::LocalMap { self.knobs.views } else { 1 };
        self.keyframe = self.map.select_views(map_from_laser, scan, count as usize, &mut self.views);
        self.matcher.set_views(&self.views);
    }

    /// Whether a scan at this pose relative to the keyframe becomes a new one.
    pub(super) fn needs_keyframe(&self, keyframe_from_laser: &Pose2) -> bool {
        match self.knobs.reference {
            ReferenceChoice::Previous => true,
            ReferenceChoice::LocalMap | ReferenceChoice::Keyframe => {
                keyframe_from_laser.distance() > self.knobs.keyframe_distance
                    || keyframe_from_laser.theta.abs() > self.knobs.keyframe_angle
            }
        }
    }
}

/// Whether two mounting poses are those of the same laser.
pub(super) fn is_same_mount(one: &Pose2, other: &Pose2) -> bool {
    one.between(other).magnitude() <= MAX_MOUNT_DIFFERENCE
}
