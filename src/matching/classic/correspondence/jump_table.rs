//! Nearest-point search with jump tables (Censi 2008, section IV): from a ray, jump to the next one that can be nearer, and skip
//! the rays between.
//!
//! Let a point have range rho, and let a ray of range r lie at the angle delta from it. Their squared distance is
//! `(rho cos delta - r)^2 + (rho sin delta)^2`. `rho cos delta` and `rho sin delta` are the dot and cross product of the point with
//! the unit vector of the ray, so no trigonometry is needed. As the walk moves away from the direction of the point, delta grows:
//! - no ray from here on is nearer than `rho sin delta` (than rho, once delta exceeds 90 degrees): the walk ends when this reaches
//!   the distance of the best match;
//! - if `r >= rho cos delta`, rays with a larger range are farther still: the next candidate is the next *shorter* ray. Otherwise
//!   it is the next *longer* one. (Comparing r with rho instead, as the paper does, is not exact.)
//!
//! The first rule does not hold for points nearer to the laser than `max_distance`: these are handled by brute force.

use super::naive::nearest_of_all;
use super::{CorrespondenceSearch, Nearest};
use crate::geometry::Point;
use crate::matching::classic::reference::{NO_RAY, Ray, Reference};

/// Jump tables of one direction of the sweep, by ray.
#[derive(Debug, Default)]
struct Jumps {
    adjacent: Vec<u32>,
    /// The next longer ray.
    longer: Vec<u32>,
    /// The next shorter ray.
    shorter: Vec<u32>,
}

/// Jump tables in both directions. If the gap of the sweep is less than half a turn, walks continue across it.
#[derive(Debug, Default)]
pub(super) struct JumpTable {
    up: Jumps,
    down: Jumps,
}

/// Fills `next[i]` with the first ray ahead of `i` for which `beats(its range, range of i)`. `indices` start at the far end of
/// the walk. `next` itself links the stack of candidates: the next candidate is the ray that beats the rejected one. Ranges along
/// the links are strictly monotone, so that the second round of a closed scan ends as well.
fn link(rays: &[Ray], indices: impl Iterator<Item = usize>, beats: impl Fn(f64, f64) -> bool, next: &mut [u32]) {
    let mut ahead = NO_RAY;
    for i in indices {
        let mut candidate = ahead;
        while candidate != NO_RAY && !beats(rays[candidate as usize].range, rays[i].range) {
            candidate = next[candidate as usize];
        }
        next[i] = candidate;
        #[allow(clippy::cast_possible_truncation)] // a scan has at most 10 000 rays
        {
            ahead = i as u32;
        }
    }
}

impl Jumps {
    /// `indices`: the rays from the far end of the direction to the near end.
    fn build(&mut self, rays: &[Ray], indices: &(impl Iterator<Item = usize> + Clone), wraps: bool) {
        for table in [&mut self.adjacent, &mut self.longer, &mut self.shorter] {
            table.clear();
            table.resize(rays.len(), NO_RAY);
        }
        let rounds = if wraps { 2 } else { 1 };
        let indices = || std::iter::repeat_n(indices.clone(), rounds).flatten();
        link(rays, indices(), |_, _| true, &mut self.adjacent);
        link(rays, indices(), |candidate, range| candidate > range, &mut self.longer);
        link(rays, indices(), |candidate, range| candidate < range, &mut self.shorter);
    }

    /// Walks from `start` and improves `best`. `ahead_sign` is +1 for a counter-clockwise walk, -1 for a clockwise one.
    #[inline]
    fn walk(&self, rays: &[Ray], point: Point, start: u32, ahead_sign: f64, mut best: Nearest) -> Nearest {
        let (mut past, mut farthest) = (false, 0.0);
        let mut i = start;
        while let Some(Ray { direction, range }) = rays.get(i as usize) {
            let along = point.dot(direction);
            let across = ahead_sign * point.perp(direction);
            // Within 90 degrees `across` grows with every step past the point. If it does not, the walk has gone around a closed
            // scan.
            let in_front = along > 0.0;
            if !in_front || (past && across <= farthest) {
                break;
            }
            past = across >= 0.0;
            if past {
                if across * across >= best.squared_distance {
                    break;
                }
                farthest = across;
            }
            let range_difference = along - range;
            let squared_distance = range_difference * range_difference + across * across;
            if squared_distance < best.squared_distance {
                best = Nearest { ray: i, squared_distance };
            }
            let table = match (past, range_difference > 0.0) {
                (false, _) => &self.adjacent,
                (true, true) => &self.longer,
                (true, false) => &self.shorter,
            };
            i = table[i as usize];
        }
        best
    }
}

impl JumpTable {
    fn nearest(&self, reference: &Reference, point: Point, guess: u32, max_distance: f64) -> Nearest {
        if point.norm_squared() <= max_distance * max_distance {
            return nearest_of_all(reference, point, max_distance);
        }
        let is_near = |ray: &Ray| point.dot(&ray.direction) > 0.0;
        let start = match reference.rays().get(guess as usize) {
            Some(ray) if is_near(ray) => guess,
            _ => reference.ray_towards(point),
        };
        let (rays, up) = (reference.rays(), reference.sweep_sign());
        let none = Nearest { ray: NO_RAY, squared_distance: max_distance * max_distance };
        let best = self.up.walk(rays, point, start, up, none);
        let best = self.down.walk(rays, point, start, -up, best);
        if best.ray == NO_RAY { Nearest { ray: start, ..Nearest::NONE } } else { best }
    }
}

impl CorrespondenceSearch for JumpTable {
    fn prepare(&mut self, reference: &Reference) {
        let wraps = reference.gap() < std::f64::consts::PI;
        let n = reference.len();
        self.up.build(reference.rays(), &(0..n).rev(), wraps);
        self.down.build(reference.rays(), &(0..n), wraps);
    }

    fn find(&self, reference: &Reference, points: &[Point], max_distance: f64, nearest: &mut [Nearest]) {
        let mut last = NO_RAY;
        for (&point, nearest) in points.iter().zip(nearest) {
            let guess = if nearest.ray == NO_RAY { last } else { nearest.ray };
            *nearest = self.nearest(reference, point, guess, max_distance);
            last = nearest.ray;
        }
    }
}
