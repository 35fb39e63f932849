//! A custom correspondence search, compared with brute force: `cargo run --release --example own_search --no-default-features`.
//!
//! To make it a value of `matching.correspondence`, move it into the crate: ARCHITECTURE.md, "Where to add what".
#![allow(clippy::print_stdout)] // an example prints its results

use anytime_scan_matcher::geometry::Point;
use anytime_scan_matcher::matching::classic::correspondence::{CorrespondenceKind, CorrespondenceSearch, Nearest};
use anytime_scan_matcher::matching::classic::reference::Reference;
use anytime_scan_matcher::simulation::pairs::Pairs;
use anytime_scan_matcher::simulation::random_world::RandomWorld;

/// Searches only a few rays around the direction of the point. Simple, but not exact: at grazing walls the nearest ray may be farther away.
struct Window {
    rays: usize,
}

impl CorrespondenceSearch for Window {
    /// Called once for every reference scan: a search with tables would build them here.
    fn prepare(&mut self, _reference: &Reference) {}

    fn find(&self, reference: &Reference, points: &[Point], max_distance: f64, nearest: &mut [Nearest]) {
        for (&point, nearest) in points.iter().zip(nearest) {
            let middle = reference.ray_towards(point) as usize;
            let rays = middle.saturating_sub(self.rays)..(middle + self.rays + 1).min(reference.len());
            *nearest = Nearest { squared_distance: max_distance * max_distance, ..Nearest::NONE };
            for (ray, other) in rays.clone().zip(&reference.points()[rays]) {
                let squared_distance = (other - point).norm_squared();
                if squared_distance < nearest.squared_distance {
                    *nearest = Nearest { ray: u32::try_from(ray).unwrap_or(u32::MAX), squared_distance };
                }
            }
            if nearest.ray == Nearest::NONE.ray {
                *nearest = Nearest::NONE;
            }
        }
    }
}

fn main() {
    let Some(mut exact) = CorrespondenceKind::Naive.search() else { return };
    let mut own = Window { rays: 3 };
    let mut reference = Reference::default();
    for pair in Pairs::new(RandomWorld::Corridor, 1081, 1).take(3) {
        reference.set(&pair.reference);
        let moved = pair.first_guess.transform();
        let points: Vec<Point> = pair.sensed.rays().map(|(_, direction, range)| moved.apply(direction * range)).collect();
        let mut answers = [(); 2].map(|()| vec![Nearest::NONE; points.len()]);
        for (search, answers) in [&mut *exact, &mut own as &mut dyn CorrespondenceSearch].into_iter().zip(&mut answers) {
            search.prepare(&reference);
            search.find(&reference, &points, 0.5, answers);
        }
        let same = answers[0].iter().zip(&answers[1]).filter(|(exact, own)| exact.ray == own.ray).count();
        println!("{same} of {} correspondences are the nearest points", points.len());
    }
}
