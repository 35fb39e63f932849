//! The reference scan as the searches and solvers use it: measured rays only, with the segments between them.

use crate::geometry::{Point, perpendicular};
use crate::scan::Scan;

/// Marks the absence of a ray in tables of indices.
pub(crate) const NO_RAY: u32 = u32::MAX;

/// A ray that carries a measurement.
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
    /// The line is where `normal . x` has this value, m.
    pub offset: f64,
}

/// The measured rays of a reference scan in sweep order. Rays without a measurement are left out; indices into it are "ray"
/// indices, not beam indices.
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
    /// Takes over a scan; memory of the last one is reused.
    pub fn set(&mut self, scan: &Scan) {
        let beams = scan.beams();
        self.angle_min = beams.angle(0);
        self.angle_increment = beams.angle_increment();
        self.gap = beams.gap();
        self.closed = beams.closes();
        self.rays.clear();
        self.points.clear();
        self.beam_of_ray.clear();
        for (beam, direction, range) in scan.rays() {
            self.rays.push(Ray { direction, range });
            self.points.push(direction * range);
            self.beam_of_ray.push(u32::try_from(beam).unwrap_or(NO_RAY));
        }
        self.drop_doubled_end(scan.len());
        self.connect();
    }

    /// Where the last beam looks the way of the first, their points are no two ends of a segment: one of them goes.
    fn drop_doubled_end(&mut self, beams: usize) {
        let doubled = self.closed && self.gap < 0.5 * self.angle_increment.abs();
        let has_both_ends =
            self.beam_of_ray.first() == Some(&0) && self.beam_of_ray.last().is_some_and(|&b| b as usize + 1 == beams);
        if doubled && has_both_ends {
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

    /// Rays in sweep order.
    pub fn rays(&self) -> &[Ray] {
        &self.rays
    }

    /// Their end points, m, in the laser's frame.
    pub fn points(&self) -> &[Point] {
        &self.points
    }

    /// The segment from ray `i` to the next one.
    pub fn segment(&self, i: usize) -> &Segment {
        &self.segments[i]
    }

    /// Whether the ray after the last one is the first.
    pub fn closed(&self) -> bool {
        self.closed
    }

    /// Angle that the sweep leaves out, rad.
    pub fn gap(&self) -> f64 {
        self.gap
    }

    /// +1 when the sweep runs counter-clockwise, -1 otherwise.
    pub fn sweep_sign(&self) -> f64 {
        self.angle_increment.signum()
    }

    /// The rays before and after ray `i` in the sweep.
    pub fn neighbours(&self, i: usize) -> (Option<usize>, Option<usize>) {
        let last = self.len() - 1;
        let before = if i > 0 { Some(i - 1) } else { self.closed.then_some(last) };
        let after = if i < last { Some(i + 1) } else { self.closed.then_some(0) };
        (before, after)
    }

    /// The segment at ray `nearest` on the side where `point` has its second nearest neighbour: the index of its first ray.
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

    /// The ray whose direction is about that of `point`.
    #[allow(clippy::cast_possible_truncation)] // a scan has at most 10 000 rays
    pub fn ray_towards(&self, point: Point) -> u32 {
        let offset = (point.y.atan2(point.x) - self.angle_min) * self.sweep_sign();
        // Past the sweep's middle of the gap, the first beam is nearer than the last.
        let turned = offset.rem_euclid(std::f64::consts::TAU);
        let sweep = std::f64::consts::TAU - self.gap;
        let beam = if turned > sweep + 0.5 * self.gap { 0.0 } else { turned / self.angle_increment.abs() };
        self.beam_of_ray.partition_point(|&b| f64::from(b) < beam).min(self.len() - 1) as u32
    }
}
