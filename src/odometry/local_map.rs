//! Keyframes along the whole path: places that are seen again are recognised because they are still there.
//!
//! What lies close together on the map need not have been seen from places close together: between two visits the path has drifted.
//! So keyframes serve a scan together only where the way between them along the path is short, or where a place of the one visit has
//! been recognised as one of the other ([`LocalMap::link`]).

use std::collections::VecDeque;
use std::ops::RangeInclusive;
use std::sync::Arc;

use super::placement::Placement;
use super::{drift, uncertainty};
use crate::geometry::{Pose2, PoseCovariance};
use crate::matching::{COARSE_VIEWS, PlacedView, View};
use crate::scan::Scan;

/// A turn by this much makes two views as different as a metre between them does, rad.
const METRE_OF_TURN: f64 = 1.0;

/// Keyframes farther than this from a pose (m, and turns as metres) see other things.
const REACH: f64 = 6.0;

/// Of the keyframes that serve a scan so many are the nearest, which see most of what it sees.
const NEAREST: usize = COARSE_VIEWS;

/// Each further one is so much farther from the scan, m: it sees less of the same, but errs otherwise than the ones before, so that the
/// errors from keyframe to keyframe add up less.
const SPACING: f64 = 1.0;

/// Over this way a path does not drift by much, m.
const SHORT_WAY: f64 = 20.0;

/// As far apart are keyframes along the path that the robot came between in a way that is not known, m, ...
const LOST_WAY: f64 = 2.0 * SHORT_WAY;
/// ... and such a step errs by this, m ...
const LOST_ERROR: f64 = 1.0;
/// ... and this, rad.
const LOST_TURN: f64 = 0.3;

/// A scan that others are matched to.
#[derive(Clone, Debug)]
struct Keyframe {
    place: Placement,
    view: Arc<View>,
    /// Way along the path from the first keyframe to this one, m.
    way: f64,
}

/// Two places of the path, by the ways to them, that are one.
#[derive(Clone, Copy, Debug)]
struct Link {
    later: f64,
    earlier: f64,
}

/// Earlier keyframes that have not been recognised yet.
#[derive(Clone, Copy, Debug)]
pub(super) struct Unrecognised {
    /// Pose of the laser at the first one.
    pub(super) map_from_laser: Pose2,
    /// Covariance of that pose, in the map frame.
    pub(super) covariance: PoseCovariance,
    way: f64,
}

/// The keyframes so far.
#[derive(Clone, Debug, Default)]
pub(super) struct LocalMap {
    keyframes: VecDeque<Keyframe>,
    links: Vec<Link>,
    /// Ways to the keyframes that scans are matched to.
    matched: Vec<f64>,
    /// Stretches of the path that are connected with those, by the ways to their ends; kept for its memory.
    known: Vec<RangeInclusive<f64>>,
    /// To here along the path earlier keyframes have kept it from drifting, m.
    held_until: f64,
    /// How different the views near a pose are, and their indices; kept for its memory.
    near: Vec<(f64, usize)>,
}

impl LocalMap {
    /// Forgets everything.
    pub(super) fn clear(&mut self) {
        *self = Self { near: std::mem::take(&mut self.near), ..Self::default() };
    }

    /// Adds a keyframe. Of more than `most`, the oldest goes. `is_lost`: how the robot came here from the last one is not known, so that
    /// none of those so far serve any more until they are recognised.
    pub(super) fn add(&mut self, mut place: Placement, view: Arc<View>, is_lost: bool, most: usize) {
        let way = self
            .keyframes
            .back()
            .map_or(0.0, |last| last.way + last.place.map_from_base().between(&place.map_from_base()).distance());
        while self.keyframes.len() >= most.max(1) {
            self.keyframes.pop_front();
        }
        let way = if is_lost { way + LOST_WAY } else { way };
        if is_lost {
            self.matched.clear();
            place.step_covariance += uncertainty::diagonal(LOST_ERROR, LOST_TURN);
        }
        self.keyframes.push_back(Keyframe { place, view, way });
        let oldest = self.keyframes[0].way;
        self.links.retain(|link| link.earlier + SHORT_WAY >= oldest);
    }

    /// Forgets what has moved since: where the last keyframe looked through surfaces of those that scans were matched to, and where they
    /// had looked through its own.
    pub(super) fn forget_moved(&mut self) {
        let Some(last) = self.keyframes.len().checked_sub(1) else { return };
        let (earlier, last) = self.keyframes.make_contiguous().split_at_mut(last);
        for earlier in earlier.iter_mut().filter(|earlier| self.matched.contains(&earlier.way)) {
            let motion = earlier.place.map_from_laser.between(&last[0].place.map_from_laser);
            View::forget_moved(&mut earlier.view, &mut last[0].view, &motion);
        }
    }

    /// The last keyframe: where it was taken, and what was seen there.
    pub(super) fn last(&self) -> Option<(Pose2, &Arc<View>)> {
        self.keyframes.back().map(|keyframe| (keyframe.place.map_from_laser, &keyframe.view))
    }

    /// `count` keyframes that saw some of what is seen from a pose, the nearest ones and some around, as views of the first one's laser;
    /// where that was. Only those that are connected with the ones that scans were matched to before, and that look where `scan` does, if
    /// it is known. The last keyframe is always near enough.
    pub(super) fn views_around(
        &mut self,
        map_from_laser: &Pose2,
        scan: Option<&Scan>,
        count: usize,
        views: &mut Vec<PlacedView>,
    ) -> Option<Placement> {
        let last = self.keyframes.len().checked_sub(1)?;
        let now = self.way();
        self.find_near(map_from_laser, |map, keyframe| {
            let is_seen =
                scan.is_none_or(|scan| scan.shares_view_with(keyframe.view.scan(), keyframe.place.heading_from(map_from_laser)));
            is_seen && (keyframe.way >= now || map.is_known(keyframe.way))
        });
        if self.near.is_empty() {
            self.near.push((REACH, last));
        }
        self.spread(count);
        self.matched.clear();
        self.matched.extend(self.near.iter().map(|&(_, i)| self.keyframes[i].way));
        if !self.is_exploring() {
            self.held_until = now;
        }
        self.place_views(views);
        Some(self.keyframes[self.near.first()?.1].place)
    }

    /// The `count` keyframes around a pose that scans are not matched to, as nobody knows whether they are where they seem to be.
    pub(super) fn unrecognised_around(
        &mut self,
        map_from_laser: &Pose2,
        count: usize,
        views: &mut Vec<PlacedView>,
    ) -> Option<Unrecognised> {
        self.find_near(map_from_laser, |map, keyframe| !map.is_known(keyframe.way));
        let &Keyframe { place: Placement { map_from_laser, covariance, .. }, way, .. } = &self.keyframes[self.near.first()?.1];
        let mut near = std::mem::take(&mut self.near);
        near.retain(|&(_, i)| self.connected(way).any(|stretch| stretch.contains(&self.keyframes[i].way)));
        near.truncate(count);
        self.near = near;
        self.place_views(views);
        Some(Unrecognised { map_from_laser, covariance, way })
    }

    /// Whether no scan is matched to keyframes of long ago: then the path drifts.
    pub(super) fn is_exploring(&self) -> bool {
        let now = self.way();
        self.matched.iter().all(|way| now - way <= SHORT_WAY)
    }

    /// The last keyframe is where these are.
    pub(super) fn link(&mut self, recognised: &Unrecognised) {
        self.links.push(Link { later: self.way(), earlier: recognised.way });
    }

    /// Way to the last keyframe since it was at the one recognised, or since others of long ago last held the path, m.
    pub(super) fn free_way(&self, recognised: &Unrecognised) -> f64 {
        self.way() - recognised.way.max(self.held_until)
    }

    /// Way to where that began, m.
    fn free_since(&self, recognised: &Unrecognised) -> f64 {
        self.way() - self.free_way(recognised)
    }

    /// Covariance of where the path has drifted to on the free way, in the map frame.
    pub(super) fn drift_covariance(&self, recognised: &Unrecognised) -> PoseCovariance {
        let start = self.free_since(recognised);
        drift::covariance(self.keyframes.iter().filter(|keyframe| keyframe.way > start).map(|keyframe| &keyframe.place))
    }

    /// The path has drifted on the free way, and is put right: the last keyframe was taken at `map_from_laser`; for those before it
    /// follows from how sure their steps are.
    pub(super) fn correct(&mut self, recognised: &Unrecognised, map_from_laser: &Pose2) {
        let start = self.free_since(recognised);
        let drifted = self.keyframes.iter_mut().filter(|keyframe| keyframe.way > start);
        drift::put_right(drifted.map(|keyframe| &mut keyframe.place), map_from_laser);
    }

    /// Way to the last keyframe, m.
    fn way(&self) -> f64 {
        self.keyframes.back().map_or(0.0, |keyframe| keyframe.way)
    }

    fn is_known(&self, way: f64) -> bool {
        self.known.iter().any(|known| known.contains(&way))
    }

    /// Finds what is connected with the keyframes that scans are matched to.
    fn find_known(&mut self) {
        let mut known = std::mem::take(&mut self.known);
        known.clear();
        known.extend(self.matched.iter().flat_map(|&way| self.connected(way)));
        self.known = known;
    }

    /// The stretches of the path that are a short way from a place on it, along the path or by a link.
    fn connected(&self, way: f64) -> impl Iterator<Item = RangeInclusive<f64>> {
        let around = |way: f64, reach: f64| (way - reach)..=(way + reach);
        let by_links = self.links.iter().flat_map(|&Link { later, earlier }| [(later, earlier), (earlier, later)]);
        let by_links = by_links.filter_map(move |(near, far)| {
            let rest = SHORT_WAY - (way - near).abs();
            (rest >= 0.0).then(|| around(far, rest))
        });
        std::iter::once(around(way, SHORT_WAY)).chain(by_links)
    }

    /// Notes the keyframes within reach that are admitted, the ones that saw most first.
    fn find_near(&mut self, map_from_laser: &Pose2, admits: impl Fn(&Self, &Keyframe) -> bool) {
        self.find_known();
        let mut near = std::mem::take(&mut self.near);
        near.clear();
        for (i, keyframe) in self.keyframes.iter().enumerate() {
            let difference = difference(map_from_laser, keyframe);
            if difference <= REACH && admits(self, keyframe) {
                near.push((difference, i));
            }
        }
        near.sort_by(|a, b| a.0.total_cmp(&b.0));
        self.near = near;
    }

    /// Leaves `count` of the keyframes noted: the nearest, and of the same visit some farther and farther out.
    fn spread(&mut self, count: usize) {
        let Some(&(_, first)) = self.near.first() else { return };
        let (keyframes, way) = (&self.keyframes, self.keyframes[first].way);
        let (mut kept, mut farthest) = (0, 0.0);
        self.near.retain(|&(difference, i)| {
            let is_of_visit = (keyframes[i].way - way).abs() <= SHORT_WAY;
            let is_chosen = kept < NEAREST || (difference >= farthest + SPACING && is_of_visit);
            let is_kept = kept < count && is_chosen;
            if is_kept {
                (kept, farthest) = (kept + 1, difference);
            }
            is_kept
        });
    }

    /// The keyframes noted, as views of the first one's laser.
    fn place_views(&self, views: &mut Vec<PlacedView>) {
        views.clear();
        let Some(&(_, first)) = self.near.first() else { return };
        let first = self.keyframes[first].place.map_from_laser;
        views.extend(self.near.iter().map(|&(_, i)| {
            let Keyframe { place, view, .. } = &self.keyframes[i];
            PlacedView { reference_from_view: first.between(&place.map_from_laser), view: Arc::clone(view) }
        }));
    }
}

fn difference(map_from_laser: &Pose2, keyframe: &Keyframe) -> f64 {
    let motion = map_from_laser.between(&keyframe.place.map_from_laser);
    motion.distance() + motion.theta.abs() / METRE_OF_TURN
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::PoseCovariance;
    use crate::matching::classic::rejection::RejectionKnobs;
    use crate::matching::{Matcher, MatchingKnobs};
    use crate::scan::{BeamGeometry, Scan};
    use crate::time::Stamp;

    /// Keyframes at these places, each of which scans were matched to before they went on.
    fn map(places: &[(f64, f64)], most: usize) -> LocalMap {
        let beams = BeamGeometry::new(0.0, 0.1, 30);
        let scan = Scan::new(Stamp::default(), beams.into(), (0.0, 10.0), vec![1.0; 30]).unwrap();
        let view = Matcher::new(&MatchingKnobs::default(), &RejectionKnobs::default()).view(scan);
        let mut map = LocalMap::default();
        for &(x, y) in places {
            let (covariance, step_covariance) = (PoseCovariance::zeros(), uncertainty::diagonal(0.01, 1e-6));
            let (stamp, map_from_laser, base_from_laser) = (Stamp::default(), Pose2::new(x, y, 0.0), Pose2::IDENTITY);
            let place = Placement { stamp, map_from_laser, base_from_laser, covariance, step_covariance };
            map.add(place, Arc::clone(&view), false, most);
            around(&mut map, (x, y), 1);
        }
        map
    }

    fn around(map: &mut LocalMap, (x, y): (f64, f64), count: usize) -> Vec<(f64, f64)> {
        let mut views = Vec::new();
        let first = map.views_around(&Pose2::new(x, y, 0.0), None, count, &mut views).unwrap().map_from_laser;
        views.iter().map(|placed| first * placed.reference_from_view).map(|pose| (pose.x, pose.y)).collect()
    }

    /// Out and back along a line, half a metre beside it.
    fn there_and_back() -> LocalMap {
        let out = (0..=20).map(|x| (f64::from(x), 0.0));
        let back = (0..=20).rev().map(|x| (f64::from(x), 0.5));
        map(&out.chain(back).collect::<Vec<_>>(), 100)
    }

    #[test]
    fn the_nearest_keyframes_are_chosen() {
        let mut map = map(&[(0.0, 0.0), (1.0, 0.0), (2.0, 0.0)], 10);
        assert_eq!(around(&mut map, (0.9, 0.0), 2), [(1.0, 0.0), (0.0, 0.0)]);
        assert_eq!(around(&mut map, (20.0, 0.0), 2), [(2.0, 0.0)], "others are out of reach, the last one never");
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
    fn the_oldest_goes_when_there_are_too_many() {
        assert_eq!(around(&mut map(&[(0.0, 0.0), (1.0, 0.0), (2.0, 0.0)], 2), (0.0, 0.0), 5), [(1.0, 0.0), (2.0, 0.0)]);
    }

    #[test]
    fn keyframes_of_long_ago_are_used_once_they_are_recognised() {
        let mut map = there_and_back();
        assert!(map.is_exploring());
        assert_eq!(around(&mut map, (0.9, 0.3), 2), [(1.0, 0.5), (0.0, 0.5)]);
        let mut views = Vec::new();
        let recognised = map.unrecognised_around(&Pose2::new(0.9, 0.2, 0.0), 2, &mut views).unwrap();
        assert_eq!((recognised.map_from_laser, views.len()), (Pose2::new(1.0, 0.0, 0.0), 2));
        map.link(&recognised);
        assert_eq!(around(&mut map, (0.9, 0.2), 2), [(1.0, 0.0), (1.0, 0.5)]);
        assert!(!map.is_exploring());
        assert_eq!(around(&mut map, (8.0, 0.0), 1), [(8.0, 0.0)], "and those a short way from them");
    }

    #[test]
    fn a_correction_is_spread_over_the_way_that_has_drifted() {
        let mut map = there_and_back();
        let recognised = map.unrecognised_around(&Pose2::new(0.0, 0.5, 0.0), 1, &mut Vec::new()).unwrap();
        map.correct(&recognised, &Pose2::IDENTITY);
        let y = |i: usize| map.keyframes[i].place.map_from_laser.y;
        assert_eq!((y(0), y(41)), (0.0, 0.0), "the place recognised stays, the last keyframe comes to lie on it");
        assert!((y(20) + 0.25).abs() < 0.01 && (y(21) - 0.25).abs() < 0.01, "half of it half way: {} {}", y(20), y(21));
    }
}
