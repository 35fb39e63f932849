//! Keyframes along the whole path: places that are seen again are recognised because they are still there.

use std::sync::Arc;

use crate::geometry::{Pose2, PoseCovariance, wrap_angle};
use crate::matching::{PlacedView, View};

/// A turn by this much makes two views as different as a metre between them does, rad.
const METRE_OF_TURN: f64 = 1.0;

/// A scan that others are matched to, and where it was taken.
#[derive(Clone, Debug)]
pub(super) struct Keyframe {
    /// Pose of the laser.
    pub(super) odom_from_laser: Pose2,
    /// Covariance of that pose, in the odom frame.
    pub(super) covariance: PoseCovariance,
    /// What the laser saw.
    pub(super) view: Arc<View>,
}

/// The keyframes so far.
#[derive(Clone, Debug, Default)]
pub(super) struct LocalMap {
    keyframes: Vec<Keyframe>,
    /// Differences to a pose and indices; kept for its memory.
    order: Vec<(f64, usize)>,
}

impl LocalMap {
    /// Whether there is no keyframe.
    pub(super) fn is_empty(&self) -> bool {
        self.keyframes.is_empty()
    }

    /// Forgets all keyframes.
    pub(super) fn clear(&mut self) {
        self.keyframes.clear();
    }

    /// Adds a keyframe. Of more than `most`, the oldest goes.
    pub(super) fn add(&mut self, keyframe: Keyframe, most: usize) {
        if self.keyframes.len() >= most.max(1) {
            self.keyframes.remove(0);
        }
        self.keyframes.push(keyframe);
    }


    /// The `count` keyframes that saw most of what is seen from a pose, best first, within `reach` m.
    pub(super) fn around(&mut self, odom_from_laser: &Pose2, count: usize, reach: f64) -> impl Iterator<Item = &Keyframe> {
        self.order.clear();
        for (i, keyframe) in self.keyframes.iter().enumerate() {
            let distance = (keyframe.odom_from_laser.translation() - odom_from_laser.translation()).norm();
            let turn = wrap_angle(keyframe.odom_from_laser.theta - odom_from_laser.theta).abs();
            let difference = distance + turn / METRE_OF_TURN;
            if difference <= reach || i + 1 == self.keyframes.len() {
                self.order.push((difference, i));
            }
        }
        self.order.sort_by(|a, b| a.0.total_cmp(&b.0));
        self.order.iter().take(count).map(|&(_, i)| &self.keyframes[i])
    }
}

/// Keyframes as views of the first one's laser.
pub(super) fn placed<'a>(keyframes: impl IntoIterator<Item = &'a Keyframe>, views: &mut Vec<PlacedView>) {
    views.clear();
    let mut first = None;
    for keyframe in keyframes {
        let origin = *first.get_or_insert(keyframe.odom_from_laser);
        views.push(PlacedView { reference_from_view: origin.between(&keyframe.odom_from_laser), view: Arc::clone(&keyframe.view) });
    }
}
