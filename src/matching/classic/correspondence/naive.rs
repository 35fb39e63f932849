//! Nearest-point search by brute force: every point against every ray. The other searches are tested against it.

use super::{CorrespondenceSearch, Nearest};
use crate::geometry::Point;
use crate::matching::classic::reference::Reference;

#[derive(Debug)]
pub(super) struct Naive;

impl CorrespondenceSearch for Naive {
    fn prepare(&mut self, _reference: &Reference) {}

    fn find(&self, reference: &Reference, points: &[Point], max_distance: f64, nearest: &mut [Nearest]) {
        for (&point, nearest) in points.iter().zip(nearest) {
            *nearest = nearest_of_all(reference, point, max_distance);
        }
    }
}

/// The nearest of all rays; the first one if several are equally near.
#[allow(clippy::cast_possible_truncation)] // a scan has at most 10 000 rays
pub(super) fn nearest_of_all(reference: &Reference, point: Point, max_distance: f64) -> Nearest {
    let mut best = Nearest { squared_distance: max_distance * max_distance, ..Nearest::NONE };
    for (i, candidate) in reference.points().iter().enumerate() {
        let squared_distance = (candidate - point).norm_squared();
        if squared_distance < best.squared_distance {
            best = Nearest { ray: i as u32, squared_distance };
        }
    }
    if best.ray == Nearest::NONE.ray { Nearest::NONE } else { best }
}
