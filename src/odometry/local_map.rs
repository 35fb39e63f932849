//! Keyframes along the whole path: places that are seen again are recognised because they are still there.

use std::collections::VecDeque;
use std::sync::Arc;

use crate::geometry::{Pose2, PoseCovariance};
use crate::matching::{PlacedView, View};

/// A turn by this much makes two views as different as a metre between them does, rad.
const METRE_OF_TURN: f64 = 1.0;

/// Keyframes farther than this from a pose (m, and turns as metres) see other things.
const REACH: f64 = 3.0;

/// Where a scan was taken.
#[derive(Clone, Copy, Debug)]
pub(super) struct Placement {
    /// Pose of the laser.
    pub(super) odom_from_laser: Pose2,
    /// Covariance of that pose, in the odom frame.
    pub(super) covariance: PoseCovariance,
}

/// A scan that others are matched to.
#[derive(Clone, Debug)]
pub(super) struct Keyframe {
    pub(super) place: Placement,
    pub(super) view: Arc<View>,
}

/// The keyframes so far.
#[derive(Clone, Debug, Default)]
pub(super) struct LocalMap {
    keyframes: VecDeque<Keyframe>,
    /// How different the views near a pose are, and their indices; kept for its memory.
    near: Vec<(f64, usize)>,
}

impl LocalMap {
    /// Forgets all keyframes.
    pub(super) fn clear(&mut self) {
        self.keyframes.clear();
    }

    /// Adds a keyframe. Of more than `most`, the oldest goes.
    pub(super) fn add(&mut self, keyframe: Keyframe, most: usize) {
        while self.keyframes.len() >= most.max(1) {
            self.keyframes.pop_front();
        }
        self.keyframes.push_back(keyframe);
    }

    /// The `count` keyframes that saw most of what is seen from a pose, as views of the first one's laser; where that was. The last
    /// keyframe is always near enough.
    pub(super) fn views_around(
        &mut self,
        odom_from_laser: &Pose2,
        count: usize,
        views: &mut Vec<PlacedView>,
    ) -> Option<Placement> {
        self.near.clear();
        for (i, Keyframe { place, .. }) in self.keyframes.iter().enumerate() {
            let motion = odom_from_laser.between(&place.odom_from_laser);
            let difference = motion.distance() + motion.theta.abs() / METRE_OF_TURN;
            if difference <= REACH || i + 1 == self.keyframes.len() {
                self.near.push((difference, i));
            }
        }
        self.near.sort_by(|a, b| a.0.total_cmp(&b.0));
        views.clear();
        let first = self.keyframes[self.near.first()?.1].place;
        let placed = |&(_, i): &(f64, usize)| {
            let Keyframe { place, view } = &self.keyframes[i];
            PlacedView { reference_from_view: first.odom_from_laser.between(&place.odom_from_laser), view: Arc::clone(view) }
        };
        views.extend(self.near.iter().take(count).map(placed));
        Some(first)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::matching::rejection::RejectionKnobs;
    use crate::matching::{Matcher, MatchingKnobs};
    use crate::scan::{BeamGeometry, Scan};
    use crate::time::Stamp;

    fn map(places: &[f64], most: usize) -> LocalMap {
        let beams = BeamGeometry::new(0.0, 0.1, 30);
        let scan = Scan::new(Stamp::default(), beams.into(), (0.0, 10.0), vec![1.0; 30]).unwrap();
        let view = Matcher::new(&MatchingKnobs::default(), &RejectionKnobs::default()).view(scan);
        let mut map = LocalMap::default();
        for &x in places {
            let place = Placement { odom_from_laser: Pose2::new(x, 0.0, 0.0), covariance: PoseCovariance::zeros() };
            map.add(Keyframe { place, view: Arc::clone(&view) }, most);
        }
        map
    }

    fn around(map: &mut LocalMap, x: f64, count: usize) -> Vec<f64> {
        let mut views = Vec::new();
        let first = map.views_around(&Pose2::new(x, 0.0, 0.0), count, &mut views).unwrap().odom_from_laser.x;
        views.iter().map(|placed| first + placed.reference_from_view.x).collect()
    }

    #[test]
    fn the_nearest_keyframes_are_chosen_however_old() {
        let mut map = map(&[0.0, 1.0, 2.0, 50.0], 10);
        assert_eq!(around(&mut map, 0.9, 2), [1.0, 0.0]);
        assert_eq!(around(&mut map, 51.0, 2), [50.0], "others are out of reach");
        assert_eq!(around(&mut map, 20.0, 2), [50.0], "the last one always");
    }

    #[test]
    fn the_oldest_goes_when_there_are_too_many() {
        assert_eq!(around(&mut map(&[0.0, 1.0, 2.0], 2), 0.0, 5), [1.0, 2.0]);
    }
}
