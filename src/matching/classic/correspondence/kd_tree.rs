//! Nearest-point search with a k-d tree.

use kiddo::{ImmutableKdTree, SquaredEuclidean};

use super::{CorrespondenceSearch, Nearest};
use crate::geometry::Point;
use crate::matching::classic::reference::Reference;

#[derive(Default)]
pub(super) struct KdTreeSearch {
    tree: Option<ImmutableKdTree<f64, 2>>,
}

impl CorrespondenceSearch for KdTreeSearch {
    fn prepare(&mut self, reference: &Reference) {
        let points: Vec<[f64; 2]> = reference.points().iter().map(|p| [p.x, p.y]).collect();
        self.tree = ImmutableKdTree::new_from_slice(&points).ok();
    }

    fn find(&self, _reference: &Reference, points: &[Point], max_distance: f64, nearest: &mut [Nearest]) {
        let max_squared_distance = max_distance * max_distance;
        for (point, nearest) in points.iter().zip(nearest) {
            let found =
                self.tree.as_ref().map(|tree| tree.query(&[point.x, point.y]).nearest_one::<SquaredEuclidean<f64>>().execute());
            *nearest = match found {
                Some(found) if found.distance < max_squared_distance => {
                    Nearest { ray: found.item, squared_distance: found.distance }
                }
                _ => Nearest::NONE,
            };
        }
    }
}
