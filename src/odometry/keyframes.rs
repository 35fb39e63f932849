//! Which keyframes a scan is matched to, and which scans become keyframes.

use super::attempt::{Attempt, Last};
use super::placement::Placement;
use super::{LaserOdometry, ReferenceChoice};
use crate::geometry::Pose2;
use crate::scan::Scan;
use crate::time::Stamp;

/// Two places of a laser on the base, m and rad, are one when they differ by less: tf jitters.
const SAME_MOUNT: f64 = 0.05;

/// Since when scans have been matched to the present keyframe before all others, and where the base was then, seen from it.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Approach {
    pub(super) stamp: Stamp,
    pub(super) keyframe_from_base: Pose2,
}

/// A scan that is to become a keyframe.
pub(super) struct UpcomingKeyframe {
    pub(super) scan: Scan,
    pub(super) place: Placement,
    /// How the robot came here from the last keyframe is not known.
    pub(super) is_lost: bool,
}

impl LaserOdometry {
    /// Work that can wait until an answer is out: prepares the reference of the next scans. [`Self::register_within`] does it otherwise.
    pub fn maintain(&mut self) {
        self.unfinished = None;
        let keeps_map = self.knobs.reference == ReferenceChoice::LocalMap;
        let upcoming = self.upcoming_keyframe.take();
        let changes = upcoming.is_some() || keeps_map;
        if let Some(UpcomingKeyframe { scan, place, is_lost }) = upcoming {
            let most = if keeps_map { self.knobs.max_keyframes } else { 1 };
            self.map.add(place, self.matcher.view(scan), is_lost, most as usize);
            self.map.forget_moved();
            self.to_be_recognised = keeps_map && self.knobs.close_loops;
        }
        if changes {
            self.choose_views();
        }
    }

    /// The next scan is matched to the keyframes around the last one.
    pub(super) fn choose_views(&mut self) {
        if let Some(last) = self.last {
            self.choose_views_around(&last, &last.map_from_laser, None);
        }
    }

    /// The keyframe to match a scan to: the one chosen around the last scan, unless this one is of a laser elsewhere on the base, as when two
    /// take turns. `None`: none has looked where it does.
    pub(super) fn keyframe_seen_by(&mut self, scan: &Scan, attempt: &Attempt) -> Option<Placement> {
        let predicted = attempt.predicted_laser();
        if !is_same_mount(&attempt.last.base_from_laser(), &attempt.base_from_laser) {
            self.choose_views_around(&attempt.last, &predicted, Some(scan));
        }
        let turn = self.keyframe?.heading_from(&predicted);
        let is_seen = self.views.first().is_some_and(|placed| scan.shares_view_with(placed.view.scan(), turn));
        self.keyframe.filter(|_| is_seen)
    }

    pub(super) fn choose_views_around(&mut self, last: &Last, map_from_laser: &Pose2, scan: Option<&Scan>) {
        let count = if self.knobs.reference == ReferenceChoice::LocalMap { self.knobs.views } else { 1 };
        let before = self.keyframe.map(|keyframe| keyframe.stamp);
        self.keyframe = self.map.views_around(map_from_laser, scan, count as usize, &mut self.views);
        if let Some(keyframe) = self.keyframe.filter(|keyframe| Some(keyframe.stamp) != before) {
            let keyframe_from_base = keyframe.map_from_laser.between(&last.map_from_base);
            self.approach = Approach { stamp: last.stamp, keyframe_from_base };
        }
        self.matcher.set_views(&self.views);
    }

    pub(super) fn wants_keyframe(&self, keyframe_from_laser: &Pose2) -> bool {
        match self.knobs.reference {
            ReferenceChoice::Previous => true,
            ReferenceChoice::LocalMap | ReferenceChoice::Keyframe => {
                keyframe_from_laser.distance() > self.knobs.keyframe_distance
                    || keyframe_from_laser.theta.abs() > self.knobs.keyframe_angle
            }
        }
    }
}

/// Whether two places on the base are those of one laser.
pub(super) fn is_same_mount(one: &Pose2, other: &Pose2) -> bool {
    let moved = one.between(other);
    moved.distance() + moved.theta.abs() <= SAME_MOUNT
}
