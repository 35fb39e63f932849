//! Keyframes along the whole path: a place is recognised because its keyframes are kept.
//!
//! Places that are close on the map may be farther apart in reality, because the path has drifted between two visits. So
//! keyframes are used together for a scan only if the path between them is short, or if a loop closure has linked the two visits
//! ([`LocalMap::link`]).

use std::collections::VecDeque;
use std::ops::RangeInclusive;
use std::sync::Arc;

use super::keyframe_pose::KeyframePose;
use super::{drift, uncertainty};
use crate::geometry::{Pose2, PoseCovariance};
use crate::matching::{COARSE_VIEWS, PlacedView, View};
use crate::scan::Scan;

/// Maximum difference between the views from a keyframe and from a pose (see [`Pose2::magnitude`]), m: farther ones see other things.
const MAX_VIEW_DISTANCE: f64 = 6.0;

/// Number of nearest keyframes used for a scan: they see most of what it sees.
const NEAREST_VIEWS: usize = COARSE_VIEWS;

/// Minimum increase in distance for each further keyframe, m: it sees less of the scan, but its errors are more independent, so
/// that errors from keyframe to keyframe add up less.
const MIN_SPACING: f64 = 1.0;

/// Maximum path length between keyframes that are used together, m: the path drifts little over it.
const MAX_CONNECTED_LENGTH: f64 = 20.0;

/// Path length assigned to a step whose motion is unknown, m.
const LOST_LENGTH: f64 = 2.0 * MAX_CONNECTED_LENGTH;

/// A scan that others are matched to.
#[derive(Clone, Debug)]
pub(super) struct Keyframe {
    pub(super) pose: KeyframePose,
    pub(super) view: Arc<View>,
    /// Path length from the first keyframe to this one, m.
    path_length: f64,
}

/// The keyframes of the path.
#[derive(Clone, Debug, Default)]
pub(super) struct LocalMap {
    keyframes: VecDeque<Keyframe>,
    /// Loop closures: two path lengths that belong to the same place.
    links: Vec<[f64; 2]>,
    /// Path lengths of the keyframes that scans are matched to.
    matched: Vec<f64>,
    /// Path length up to which earlier keyframes kept the path from drifting, m.
    anchored_until: f64,
}

impl LocalMap {
    /// Forgets everything.
    pub(super) fn clear(&mut self) {
        *self = Self::default();
    }

    /// Adds a keyframe, and drops others if there are more than `max_keyframes`. `is_lost`: the motion from the previous keyframe
    /// is unknown, so that earlier keyframes are not used until a loop closure links them.
    pub(super) fn add(&mut self, mut pose: KeyframePose, view: Arc<View>, is_lost: bool, max_keyframes: usize) {
        let path_length = self
            .keyframes
            .back()
            .map_or(0.0, |last| last.path_length + last.pose.map_from_base().between(&pose.map_from_base()).distance());
        while self.keyframes.len() >= max_keyframes.max(1) {
            self.drop_one(path_length);
        }
        let path_length = if is_lost { path_length + LOST_LENGTH } else { path_length };
        if is_lost {
            self.matched.clear();
            pose.step_covariance += uncertainty::unknown_motion();
        }
        self.keyframes.push_back(Keyframe { pose, view, path_length });
    }

    /// Drops the keyframe whose neighbours on the path are nearest to one another, so that a long path is remembered in less
    /// detail, but from its start. Scans are matched to the latest ones, up to `now` on the path, so these are kept if possible.
    fn drop_one(&mut self, now: f64) {
        let is_recent = |keyframe: &Keyframe| now - keyframe.path_length <= MAX_CONNECTED_LENGTH;
        let pose = |i: usize| self.keyframes[i].pose.map_from_laser;
        let gap = |i: usize| pose(i - 1).between(&pose(i + 1)).magnitude();
        let older = (1..self.keyframes.len().saturating_sub(1)).take_while(|&i| !is_recent(&self.keyframes[i]));
        let dropped = older.min_by(|&a, &b| gap(a).total_cmp(&gap(b))).unwrap_or(0);
        if dropped > 0 {
            let steps = [dropped, dropped + 1].map(|i| self.keyframes[i].pose);
            self.keyframes[dropped + 1].pose.step_covariance = drift::end_covariance(steps.iter());
        }
        self.keyframes.remove(dropped);
        let keyframes = &self.keyframes;
        let is_remembered = |place: f64| {
            let next = keyframes.partition_point(|keyframe| keyframe.path_length < place - MAX_CONNECTED_LENGTH);
            keyframes.get(next).is_some_and(|keyframe| keyframe.path_length <= place + MAX_CONNECTED_LENGTH)
        };
        self.links.retain(|link| link.iter().all(|&place| is_remembered(place)));
    }

    /// Removes surfaces that have moved since: surfaces of the matched keyframes that the latest keyframe saw through, and vice
    /// versa.
    pub(super) fn remove_moved_surfaces(&mut self) {
        let Some(last) = self.keyframes.len().checked_sub(1) else { return };
        let (earlier, last) = self.keyframes.make_contiguous().split_at_mut(last);
        for earlier in earlier.iter_mut().filter(|earlier| self.matched.contains(&earlier.path_length)) {
            let motion = earlier.pose.map_from_laser.between(&last[0].pose.map_from_laser);
            View::remove_moved(&mut earlier.view, &mut last[0].view, &motion);
        }
    }

    /// The latest keyframe.
    pub(super) fn last(&self) -> Option<&Keyframe> {
        self.keyframes.back()
    }

    /// Selects up to `count` keyframes that overlap with what is seen from a pose, the nearest ones and some farther away, and
    /// writes them to `views` in the frame of the first one, whose pose it returns. Only keyframes connected with those matched
    /// before qualify, and only those that overlap with `scan`, if it is given. If none qualifies, the latest keyframe is used.
    pub(super) fn select_views(
        &mut self,
        map_from_laser: &Pose2,
        scan: Option<&Scan>,
        count: usize,
        views: &mut Vec<PlacedView>,
    ) -> Option<KeyframePose> {
        let (last, now) = (self.last()?, self.path_length());
        let mut near = self.near(map_from_laser, |keyframe, is_connected| {
            let heading = keyframe.pose.heading_from(map_from_laser);
            let is_seen = scan.is_none_or(|scan| scan.shares_view_with(keyframe.view.scan(), heading));
            is_seen && (keyframe.path_length >= now || is_connected)
        });
        if near.is_empty() {
            near.push((MAX_VIEW_DISTANCE, last));
        }
        thin_out(&mut near, count);
        write_views(&near, views);
        let reference = near.first().map(|(_, first)| first.pose);
        self.matched = near.iter().map(|(_, keyframe)| keyframe.path_length).collect();
        if !self.is_exploring() {
            self.anchored_until = now;
        }
        reference
    }

    /// Selects up to `count` keyframes near a pose that are not connected with the matched ones, because the drift between them
    /// is unknown, and writes them to `views` in the frame of the first one, which it returns: a candidate for a loop closure.
    pub(super) fn loop_candidate(&self, map_from_laser: &Pose2, count: usize, views: &mut Vec<PlacedView>) -> Option<Keyframe> {
        let mut near = self.near(map_from_laser, |_, is_connected| !is_connected);
        let (_, first) = *near.first()?;
        near.retain(|(_, keyframe)| is_within(self.connected_stretches(first.path_length), keyframe.path_length));
        near.truncate(count);
        write_views(&near, views);
        Some(first.clone())
    }

    /// Whether scans are matched only to recent keyframes, so that the path drifts.
    pub(super) fn is_exploring(&self) -> bool {
        let now = self.path_length();
        self.matched.iter().all(|path_length| now - path_length <= MAX_CONNECTED_LENGTH)
    }

    /// Links the latest keyframe with the candidate.
    pub(super) fn link(&mut self, candidate: &Keyframe) {
        self.links.push([self.path_length(), candidate.path_length]);
    }

    /// Length of the path that has drifted: since the candidate, or since earlier keyframes last anchored the path, m.
    fn drift_length(&self, candidate: &Keyframe) -> f64 {
        self.path_length() - candidate.path_length.max(self.anchored_until)
    }

    /// Path length at which the drift began, m.
    fn drift_start(&self, candidate: &Keyframe) -> f64 {
        self.path_length() - self.drift_length(candidate)
    }

    /// Covariance of the drift, in the map frame.
    pub(super) fn drift_covariance(&self, candidate: &Keyframe) -> PoseCovariance {
        let start = self.drift_start(candidate);
        drift::end_covariance(
            self.keyframes.iter().filter(|keyframe| keyframe.path_length > start).map(|keyframe| &keyframe.pose),
        )
    }

    /// Corrects the part of the path that has drifted: the latest keyframe was taken at `map_from_laser`, and the correction is
    /// distributed over the steps by their uncertainty.
    pub(super) fn correct(&mut self, candidate: &Keyframe, map_from_laser: &Pose2) {
        let start = self.drift_start(candidate);
        let drifted = self.keyframes.iter_mut().filter(|keyframe| keyframe.path_length > start);
        drift::correct(drifted.map(|keyframe| &mut keyframe.pose), map_from_laser);
    }

    /// Path length of the latest keyframe, m.
    fn path_length(&self) -> f64 {
        self.keyframes.back().map_or(0.0, |keyframe| keyframe.path_length)
    }

    /// Path length ranges within [`MAX_CONNECTED_LENGTH`] of a place on the path, along the path or across a link.
    fn connected_stretches(&self, path_length: f64) -> impl Iterator<Item = RangeInclusive<f64>> {
        let around = |path_length: f64, reach: f64| (path_length - reach)..=(path_length + reach);
        let linked = self.links.iter().flat_map(|&[later, earlier]| [(later, earlier), (earlier, later)]);
        let linked = linked.filter_map(move |(near, far)| {
            let rest = MAX_CONNECTED_LENGTH - (path_length - near).abs();
            (rest >= 0.0).then(|| around(far, rest))
        });
        std::iter::once(around(path_length, MAX_CONNECTED_LENGTH)).chain(linked)
    }

    /// The keyframes near a pose that `admits` accepts, by increasing view distance, with that distance, m. `admits` is told whether
    /// a keyframe is connected with the matched ones.
    fn near(&self, map_from_laser: &Pose2, admits: impl Fn(&Keyframe, bool) -> bool) -> Vec<(f64, &Keyframe)> {
        let connected: Vec<_> = self.matched.iter().flat_map(|&matched| self.connected_stretches(matched)).collect();
        let position = map_from_laser.translation();
        // Excludes most keyframes without any trigonometry.
        let is_around = |keyframe: &&Keyframe| {
            let offset = keyframe.pose.map_from_laser.translation() - position;
            offset.norm_squared() <= MAX_VIEW_DISTANCE * MAX_VIEW_DISTANCE
        };
        let around = self.keyframes.iter().filter(is_around);
        let mut near: Vec<_> =
            around.map(|keyframe| (map_from_laser.between(&keyframe.pose.map_from_laser).magnitude(), keyframe)).collect();
        near.retain(|(difference, keyframe)| {
            *difference <= MAX_VIEW_DISTANCE && admits(keyframe, is_within(connected.iter().cloned(), keyframe.path_length))
        });
        near.sort_by(|a, b| a.0.total_cmp(&b.0));
        near
    }
}

/// Whether a place on the path is within some of these stretches of it.
fn is_within(mut stretches: impl Iterator<Item = RangeInclusive<f64>>, path_length: f64) -> bool {
    stretches.any(|stretch| stretch.contains(&path_length))
}

/// Keeps `count` of the keyframes: the nearest ones, then others of the same visit at increasing distances.
fn thin_out(near: &mut Vec<(f64, &Keyframe)>, count: usize) {
    let Some(&(_, first)) = near.first() else { return };
    let (mut kept, mut farthest) = (0, 0.0);
    near.retain(|&(difference, keyframe)| {
        let is_of_visit = (keyframe.path_length - first.path_length).abs() <= MAX_CONNECTED_LENGTH;
        let is_chosen = kept < NEAREST_VIEWS || (difference >= farthest + MIN_SPACING && is_of_visit);
        let is_kept = kept < count && is_chosen;
        if is_kept {
            (kept, farthest) = (kept + 1, difference);
        }
        is_kept
    });
}

/// Writes keyframes as views in the frame of the first one's laser.
fn write_views(near: &[(f64, &Keyframe)], views: &mut Vec<PlacedView>) {
    views.clear();
    views.extend(near.iter().map(|(_, Keyframe { pose, view, .. })| {
        let reference_from_view = near[0].1.pose.map_from_laser.between(&pose.map_from_laser);
        PlacedView { reference_from_view, view: Arc::clone(view) }
    }));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::matching::classic::rejection::RejectionKnobs;
    use crate::matching::{Matcher, MatchingKnobs};
    use crate::odometry::scale_error::ScaleJacobian;
    use crate::scan::BeamGeometry;
    use crate::time::Stamp;

    /// A map with keyframes at these poses, each matched to before the next one was added.
    fn map(poses: &[(f64, f64)], max_keyframes: usize) -> LocalMap {
        let beams = BeamGeometry::new(0.0, 0.1, 30);
        let scan = Scan::new(Stamp::default(), beams.into(), (0.0, 10.0), vec![1.0; 30]).unwrap();
        let view = Matcher::new(&MatchingKnobs::default(), &RejectionKnobs::default()).view(scan);
        let mut map = LocalMap::default();
        for &(x, y) in poses {
            let (covariance, step_covariance) = (PoseCovariance::zeros(), uncertainty::diagonal(0.01, 1e-6));
            let (map_from_laser, base_from_laser) = (Pose2::new(x, y, 0.0), Pose2::IDENTITY);
            let by_scale = ScaleJacobian::NONE;
            let pose = KeyframePose { map_from_laser, base_from_laser, covariance, by_scale, step_covariance };
            map.add(pose, Arc::clone(&view), false, max_keyframes);
            around(&mut map, (x, y), 1);
        }
        map
    }

    fn around(map: &mut LocalMap, (x, y): (f64, f64), count: usize) -> Vec<(f64, f64)> {
        let mut views = Vec::new();
        let first = map.select_views(&Pose2::new(x, y, 0.0), None, count, &mut views).unwrap().map_from_laser;
        views.iter().map(|placed| first * placed.reference_from_view).map(|pose| (pose.x, pose.y)).collect()
    }

    /// Out and back along a line, with an offset of half a metre.
    fn there_and_back() -> LocalMap {
        let out = (0..=20).map(|x| (f64::from(x), 0.0));
        let back = (0..=20).rev().map(|x| (f64::from(x), 0.5));
        map(&out.chain(back).collect::<Vec<_>>(), 100)
    }

    #[test]
    fn the_nearest_keyframes_are_chosen() {
        let mut map = map(&[(0.0, 0.0), (1.0, 0.0), (2.0, 0.0)], 10);
        assert_eq!(around(&mut map, (0.9, 0.0), 2), [(1.0, 0.0), (0.0, 0.0)]);
        assert_eq!(around(&mut map, (20.0, 0.0), 2), [(2.0, 0.0)], "only the latest keyframe is used at any distance");
    }

    #[test]
    fn farther_ones_are_spread_out() {
        let line: Vec<_> = (0..=50).map(|i| (0.1 * f64::from(i), 0.0)).collect();
        let xs: Vec<f64> = around(&mut map(&line, 100), (5.0, 0.0), 5).iter().map(|&(x, _)| x).collect();
        for (x, expected) in xs.iter().zip([5.0, 4.9, 4.8, 3.8, 2.8]) {
            assert!((x - expected).abs() < 0.11, "{xs:?}");
        }
    }

    #[test]
    fn the_oldest_of_the_latest_metres_is_dropped_when_there_are_too_many() {
        assert_eq!(around(&mut map(&[(0.0, 0.0), (1.0, 0.0), (2.0, 0.0)], 2), (0.0, 0.0), 5), [(1.0, 0.0), (2.0, 0.0)]);
    }

    #[test]
    fn a_long_path_is_remembered_from_its_start_in_less_detail() {
        let line: Vec<_> = (0..=200).map(|x| (f64::from(x), 0.0)).collect();
        let (all, few) = (map(&line, 1000), map(&line, 60));
        let x = |keyframe: &Keyframe| keyframe.pose.map_from_laser.x;
        let kept: Vec<f64> = few.keyframes.iter().map(x).collect();
        assert_eq!((kept.len(), kept[0]), (60, 0.0));
        assert!(kept.windows(2).all(|pair| pair[1] - pair[0] <= 8.0), "{kept:?}");
        assert!((180..=200).all(|x| kept.contains(&f64::from(x))), "{kept:?}");
        let drift = |map: &LocalMap| drift::end_covariance(map.keyframes.iter().skip(1).map(|keyframe| &keyframe.pose));
        assert!((drift(&few) - drift(&all)).norm() < 1e-9 * drift(&all).norm(), "what is forgotten is no less uncertain");
        assert!(few.loop_candidate(&Pose2::new(0.5, 0.0, 0.0), 2, &mut Vec::new()).is_some());
    }

    #[test]
    fn earlier_keyframes_are_used_once_they_are_linked() {
        let mut map = there_and_back();
        assert!(map.is_exploring());
        assert_eq!(around(&mut map, (0.9, 0.3), 2), [(1.0, 0.5), (0.0, 0.5)]);
        let mut views = Vec::new();
        let candidate = map.loop_candidate(&Pose2::new(0.9, 0.2, 0.0), 2, &mut views).unwrap();
        assert_eq!((candidate.pose.map_from_laser, views.len()), (Pose2::new(1.0, 0.0, 0.0), 2));
        map.link(&candidate);
        assert_eq!(around(&mut map, (0.9, 0.2), 2), [(1.0, 0.0), (1.0, 0.5)]);
        assert!(!map.is_exploring());
        assert_eq!(around(&mut map, (8.0, 0.0), 1), [(8.0, 0.0)], "and those a short path away from them");
    }

    #[test]
    fn a_correction_is_distributed_over_the_path_that_has_drifted() {
        let mut map = there_and_back();
        let candidate = map.loop_candidate(&Pose2::new(0.0, 0.5, 0.0), 1, &mut Vec::new()).unwrap();
        map.correct(&candidate, &Pose2::IDENTITY);
        let y = |i: usize| map.keyframes[i].pose.map_from_laser.y;
        assert_eq!((y(0), y(41)), (0.0, 0.0), "the candidate stays, the last keyframe moves onto it");
        assert!(
            (y(20) + 0.25).abs() < 0.01 && (y(21) - 0.25).abs() < 0.01,
            "half of the correction half way: {} {}",
            y(20),
            y(21)
        );
    }
}
