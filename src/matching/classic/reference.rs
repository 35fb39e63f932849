//! The reference scan for nearest-point matching: the measured rays, and the segments between neighbouring points.

use crate::geometry::{Point, perpendicular};
use crate::scan::Scan;

/// Marks the absence of a ray in index tables.
pub(crate) const NO_RAY: u32 = u32::MAX;

/// A ray with a measurement.
#[derive(Clone, Copy, Debug)]
pub struct Ray {
    /// Unit vector.
    pub direction: Point,
    /// Range, m.
    pub range: f64,
}

/// The line through two neighbouring points of the reference.
#[derive(Clone, Copy, Debug)]
pub struct Segment {
    /// Unit normal.
    pub normal: Point,
    /// Offset of the line, m: `normal . x = offset` for its points x.
    pub offset: f64,
}

/// The measured rays of a reference scan in sweep order. Rays without a measurement are left out, so a ray index is not a beam
/// index.
#[derive(Debug, Default)]
pub struct Reference {
    rays: Vec<Ray>,
    points: Vec<Point>,
    segments: Vec<Segment>,
    beam_of_ray: Vec<u32>,
    angle_min: f64,
    angle_increment: f64,
    gap: f64,
    closed: bool,
}

impl Reference {
    /// Sets the reference scan; reuses the memory of the previous one.
    pub fn set(&mut self, scan: &Scan) {
        let beams = scan.beams();
        self.angle_min = beams.angle(0);
        self.angle_increment = beams.angle_increment();
        self.gap = beams.gap();
        self.closed = beams.is_full_circle();
        self.rays.clear();
        self.points.clear();
        self.beam_of_ray.clear();
        for (beam, direction, range) in scan.rays() {
            self.rays.push(Ray { direction, range });
            self.points.push(direction * range);
            self.beam_of_ray.push(u32::try_from(beam).unwrap_or(NO_RAY));
        }
        self.remove_duplicate_end(scan.len());
        self.connect();
    }

    /// If the last beam points in the same direction as the first, their points are no two ends of a segment: the last ray is
    /// removed.
    fn remove_duplicate_end(&mut self, beams: usize) {
        let ends_coincide = self.closed && self.gap < 0.5 * self.angle_increment.abs();
        let has_both_ends =
            self.beam_of_ray.first() == Some(&0) && self.beam_of_ray.last().is_some_and(|&b| b as usize + 1 == beams);
        if ends_coincide && has_both_ends {
            self.rays.pop();
            self.points.pop();
            self.beam_of_ray.pop();
        }
    }

    fn connect(&mut self) {
        self.segments.clear();
        for (i, &from) in self.points.iter().enumerate() {
            let to = self.points[(i + 1) % self.points.len()];
            let along = to - from;
            let normal = perpendicular(along) / along.norm();
            self.segments.push(Segment { normal, offset: normal.dot(&from) });
        }
    }

    /// Number of rays.
    pub fn len(&self) -> usize {
        self.rays.len()
    }

    /// Whether no scan has been set.
    pub fn is_empty(&self) -> bool {
        self.rays.is_empty()
    }

    /// The rays in sweep order.
    pub fn rays(&self) -> &[Ray] {
        &self.rays
    }

    /// The end points of the rays, m, in the frame of the laser.
    pub fn points(&self) -> &[Point] {
        &self.points
    }

    /// The segment from ray `i` to the next one.
    pub fn segment(&self, i: usize) -> &Segment {
        &self.segments[i]
    }

    /// Angle not covered by the sweep, rad.
    pub fn gap(&self) -> f64 {
        self.gap
    }

    /// +1 if the sweep runs counter-clockwise, -1 otherwise.
    pub fn sweep_sign(&self) -> f64 {
        self.angle_increment.signum()
    }

    /// The neighbours of ray `i` in the sweep: the ray before it and the ray after it.
    pub fn neighbours(&self, i: usize) -> (Option<usize>, Option<usize>) {
        let last = self.len() - 1;
        let before = if i > 0 { Some(i - 1) } else { self.closed.then_some(last) };
        let after = if i < last { Some(i + 1) } else { self.closed.then_some(0) };
        (before, after)
    }

    /// The segment at ray `nearest` on the side of the second nearest neighbour of `point`: the index of its first ray.
    pub fn segment_at(&self, nearest: usize, point: Point) -> Option<usize> {
        let squared_distance = |i: usize| (self.points[i] - point).norm_squared();
        match self.neighbours(nearest) {
            (Some(before), Some(after)) if squared_distance(before) < squared_distance(after) => Some(before),
            (_, Some(_)) => Some(nearest),
            (before, None) => before,
        }
    }

    /// The rays at the two ends of segment `i`.
    pub fn segment_rays(&self, i: usize) -> (usize, usize) {
        (i, (i + 1) % self.len())
    }

    /// The ray that points approximately towards `point`.
    #[allow(clippy::cast_possible_truncation)] // a scan has at most 10 000 rays
    pub fn ray_towards(&self, point: Point) -> u32 {
        let offset = (point.y.atan2(point.x) - self.angle_min) * self.sweep_sign();
        // Beyond the middle of the gap, the first beam is nearer than the last.
        let along_sweep = offset.rem_euclid(std::f64::consts::TAU);
        let sweep = std::f64::consts::TAU - self.gap;
        let beam = if along_sweep > sweep + 0.5 * self.gap { 0.0 } else { along_sweep / self.angle_increment.abs() };
        self.beam_of_ray.partition_point(|&b| f64::from(b) < beam).min(self.len() - 1) as u32
    }
}
