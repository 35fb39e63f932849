//! Jump tables (Censi 2008, section IV): from a ray that cannot be beaten by its like, leap to the next that could.
//!
//! Let a point have range rho, and let a ray of range r lie at the angle delta from it. The two are
//! `(rho cos delta - r)^2 + (rho sin delta)^2` apart, and with the point's dot and cross product with the ray's unit vector,
//! `rho cos delta` and `rho sin delta` need no trigonometry. Walking away from the point's direction, delta grows:
//! - nothing from here on is nearer than `rho sin delta` (than rho, once delta exceeds 90 degrees): the walk ends when the best
//!   match is;
//! - where `r >= rho cos delta`, rays with a larger range are farther still: the next candidate is the next *shorter* ray; where
//!   `r < rho cos delta` it is the next *longer* one. (Comparing r with rho instead, as the paper does, is not exact.)
//!
//! Points nearer to the laser than `max_distance` break the first rule; brute force answers for them.

use super::naive::nearest_of_all;
use super::{CorrespondenceSearch, Nearest};
use crate::geometry::Point;
use crate::matching::reference::{NO_RAY, Ray, Reference};

/// The next ray along one direction of the sweep that is longer, or shorter, than each ray.
#[derive(Debug, Default)]
struct Jumps {
    longer: Vec<u32>,
    shorter: Vec<u32>,
}

#[derive(Debug, Default)]
pub(super) struct JumpTable {
    up: Jumps,
    down: Jumps,
    /// Whether walks go on from the last ray to the first across the gap of the sweep.
    wraps: bool,
}

/// Fills `next[i]` with the first ray ahead of `i` for which `beats(its range, range of i)`; `indices` come from the far end of the
/// walk. `next` itself links the stack of candidates: what a passed-over candidate loses to is the next candidate. Ranges along the
/// links are strictly monotone, so that a second round in a ring ends as well.
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
    /// `indices`: the rays from the far end of the direction to its near end; twice round where the walk wraps.
    fn build(&mut self, rays: &[Ray], indices: impl Iterator<Item = usize> + Clone) {
        for table in [&mut self.longer, &mut self.shorter] {
            table.clear();
            table.resize(rays.len(), NO_RAY);
        }
        link(rays, indices.clone(), |candidate, range| candidate > range, &mut self.longer);
        link(rays, indices, |candidate, range| candidate < range, &mut self.shorter);
    }
}

impl JumpTable {
    fn step(&self, ray: usize, upwards: bool, len: usize) -> Option<usize> {
        match (upwards, self.wraps) {
            (true, _) if ray + 1 < len => Some(ray + 1),
            (false, _) if ray > 0 => Some(ray - 1),
            (true, true) => Some(0),
            (false, true) => Some(len - 1),
            _ => None,
        }
    }

    /// Walks from `start` in one direction of the sweep and improves `best`.
    #[allow(clippy::cast_possible_truncation)] // a scan has at most 10 000 rays
    #[inline]
    fn walk(&self, reference: &Reference, point: Point, start: usize, upwards: bool, best: &mut Nearest) {
        let rays = reference.rays();
        let jumps = if upwards { &self.up } else { &self.down };
        let ahead_sign = if upwards { reference.sweep_sign() } else { -reference.sweep_sign() };
        let mut past = false;
        let mut next = Some(start);
        // A ring has no end to stop at: once round is enough.
        for _ in 0..rays.len() {
            let Some(i) = next else { return };
            let Ray { direction, range } = rays[i];
            let along = point.dot(&direction);
            let across = ahead_sign * (point.x * direction.y - point.y * direction.x);
            if along <= 0.0 || (past && across < 0.0) {
                return; // more than 90 degrees off, or come round from behind
            }
            past = across >= 0.0;
            if past && across * across >= best.squared_distance {
                return;
            }
            let short_of = along - range;
            let squared_distance = short_of * short_of + across * across;
            if squared_distance < best.squared_distance {
                *best = Nearest { ray: i as u32, squared_distance };
            }
            next = if past {
                let jump = if short_of > 0.0 { jumps.longer[i] } else { jumps.shorter[i] };
                (jump != NO_RAY).then_some(jump as usize)
            } else {
                self.step(i, upwards, rays.len())
            };
        }
    }

    fn nearest(&self, reference: &Reference, point: Point, guess: u32, max_distance: f64) -> Nearest {
        if point.norm_squared() <= max_distance * max_distance {
            return nearest_of_all(reference, point, max_distance);
        }
        let is_near = |ray: &Ray| point.dot(&ray.direction) > 0.0;
        let start = match reference.rays().get(guess as usize) {
            Some(ray) if is_near(ray) => guess as usize,
            _ => reference.ray_towards(point),
        };
        let mut best = Nearest { ray: NO_RAY, squared_distance: max_distance * max_distance };
        self.walk(reference, point, start, true, &mut best);
        self.walk(reference, point, start, false, &mut best);
        if best.ray == NO_RAY {
            #[allow(clippy::cast_possible_truncation)] // a scan has at most 10 000 rays
            return Nearest { ray: start as u32, ..Nearest::NONE };
        }
        best
    }
}

impl CorrespondenceSearch for JumpTable {
    fn prepare(&mut self, reference: &Reference) {
        self.wraps = reference.gap() < std::f64::consts::PI;
        let rays = reference.rays();
        let n = rays.len();
        let rounds = if self.wraps { 2 } else { 1 };
        self.up.build(rays, (0..rounds * n).rev().map(|i| i % n));
        self.down.build(rays, (0..rounds * n).map(|i| i % n));
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
