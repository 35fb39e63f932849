//! A path to follow: a polyline with arc length, curvature and projection.

use thiserror::Error;

use crate::geometry::{Point, Pose2, wrap_angle};

/// Points closer to each other than this are merged, m: they define no heading.
const MIN_POINT_DISTANCE: f64 = 1e-3;
/// Length of the two chords whose heading change gives the curvature, m: about the wheelbase of a racecar, which cannot follow
/// finer detail.
const CHORD: f64 = 0.3;

/// A point of the path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Waypoint {
    /// Position, m.
    pub point: Point,
    /// Speed, m/s; `None`: as fast as the curve allows.
    pub speed: Option<f64>,
}

/// Why waypoints form no valid path.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum PathError {
    /// There are no points: the request to stop.
    #[error("the path is empty")]
    Empty,
    /// All points coincide.
    #[error("the path has no length: it needs two distinct points")]
    NoLength,
    /// A coordinate is NaN or infinite.
    #[error("point {index} of the path is not finite")]
    NotFinite {
        /// Index of the point, from 0.
        index: usize,
    },
}

/// A polyline, open or closed.
#[derive(Clone, Debug, PartialEq)]
pub struct Path {
    waypoints: Vec<Waypoint>,
    /// Arc length at each point; for a closed path also the length of a lap at the end.
    arc: Vec<f64>,
    is_closed: bool,
}

/// Projection of a pose onto a path: the nearest point, and the errors of the pose relative to it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Projection {
    /// Arc length of the point, m.
    pub along: f64,
    /// Lateral error, m, positive to the left of the path.
    pub lateral_error: f64,
    /// Heading of the pose relative to that of the path, rad.
    pub heading_error: f64,
    /// Distance of the pose from the point, m: beyond an end of the path it is more than the lateral error.
    pub distance: f64,
}

impl Path {
    /// The path through these points in order, open or closed. Points that repeat the previous one are dropped.
    pub fn new(waypoints: &[Waypoint], is_closed: bool) -> Result<Self, PathError> {
        if waypoints.is_empty() {
            return Err(PathError::Empty);
        }
        if let Some(index) = waypoints.iter().position(|w| !(w.point.x.is_finite() && w.point.y.is_finite())) {
            return Err(PathError::NotFinite { index });
        }
        let mut kept: Vec<Waypoint> = Vec::with_capacity(waypoints.len());
        for waypoint in waypoints {
            if kept.last().is_none_or(|last| (last.point - waypoint.point).norm() > MIN_POINT_DISTANCE) {
                kept.push(*waypoint);
            }
        }
        if is_closed && kept.len() > 1 && (kept[kept.len() - 1].point - kept[0].point).norm() <= MIN_POINT_DISTANCE {
            kept.pop();
        }
        if kept.len() < 2 {
            return Err(PathError::NoLength);
        }
        let mut path = Self { waypoints: kept, arc: Vec::new(), is_closed };
        path.fill_in_speeds();
        path.compute_arc();
        Ok(path)
    }

    /// The path through these points. It is closed if its ends are about as close as neighbouring points and it is long enough
    /// for a lap.
    pub fn closed_if_loop(waypoints: &[Waypoint]) -> Result<Self, PathError> {
        let open = Self::new(waypoints, false)?;
        let steps = open.arc.windows(2).map(|ends| ends[1] - ends[0]);
        let longest = steps.fold(0.0, f64::max);
        let gap = (open.waypoints[0].point - open.waypoints[open.waypoints.len() - 1].point).norm();
        if open.waypoints.len() > 3 && gap <= 2.0 * longest && open.length() > 4.0 * longest + gap {
            return Self::new(waypoints, true);
        }
        Ok(open)
    }

    /// Replaces unusable speeds, such as 0, by the next usable one: a recorded raceline begins at rest, and planners without
    /// speeds leave them 0. A 0 at the end means to stop, which the end of an open path implies anyway.
    fn fill_in_speeds(&mut self) {
        let usable = |speed: &f64| speed.is_finite() && *speed > 0.0;
        let mut next = None;
        for waypoint in self.waypoints.iter_mut().rev() {
            waypoint.speed = waypoint.speed.filter(usable).or(next);
            next = waypoint.speed;
        }
    }

    fn compute_arc(&mut self) {
        let mut along = 0.0;
        self.arc = vec![0.0];
        for segment in 0..self.segments() {
            along += self.step(segment).norm();
            self.arc.push(along);
        }
    }

    fn segments(&self) -> usize {
        if self.is_closed { self.waypoints.len() } else { self.waypoints.len() - 1 }
    }

    fn step(&self, segment: usize) -> Point {
        self.waypoints[(segment + 1) % self.waypoints.len()].point - self.waypoints[segment].point
    }

    /// Whether the path is closed: the last point is followed by the first.
    pub fn is_closed(&self) -> bool {
        self.is_closed
    }

    /// Length, m; of one lap if the path is closed.
    pub fn length(&self) -> f64 {
        self.arc[self.arc.len() - 1]
    }

    /// The points, at least two.
    pub fn waypoints(&self) -> &[Waypoint] {
        &self.waypoints
    }

    /// Arc length at each point, m.
    pub fn arc(&self) -> &[f64] {
        &self.arc[..self.waypoints.len()]
    }

    /// Distance along the path from `along` to its end, m; infinite if the path is closed.
    pub fn remaining(&self, along: f64) -> f64 {
        if self.is_closed { f64::INFINITY } else { self.length() - along }
    }

    /// The segment at an arc length, and the distance from its start. Outside of an open path it is the first or the last
    /// segment.
    fn segment_at(&self, along: f64) -> (usize, f64) {
        let along = if self.is_closed { along.rem_euclid(self.length()) } else { along };
        let segment = self.arc.partition_point(|&arc| arc <= along).clamp(1, self.segments()) - 1;
        (segment, along - self.arc[segment])
    }

    /// The point at an arc length. An open path continues straight beyond its ends.
    pub fn point(&self, along: f64) -> Point {
        let (segment, rest) = self.segment_at(along);
        self.waypoints[segment].point + self.step(segment).normalize() * rest
    }

    /// Heading at an arc length, rad.
    pub fn heading(&self, along: f64) -> f64 {
        let step = self.step(self.segment_at(along).0);
        step.y.atan2(step.x)
    }

    /// Curvature at an arc length, 1/m, positive to the left.
    pub fn curvature(&self, along: f64) -> f64 {
        let chord = CHORD.min(self.length() / 4.0);
        let here = self.point(along);
        let (arriving, leaving) = (here - self.point(along - chord), self.point(along + chord) - here);
        arriving.perp(&leaving).atan2(arriving.dot(&leaving)) / chord
    }

    /// Speed that the path requests at an arc length, m/s: that of the segment's first point.
    pub fn speed(&self, along: f64) -> Option<f64> {
        self.waypoints[self.segment_at(along).0].speed
    }

    /// The pose on the path at an arc length.
    pub fn pose(&self, along: f64) -> Pose2 {
        let point = self.point(along);
        Pose2::new(point.x, point.y, self.heading(along))
    }

    /// Projects a pose onto the nearest segment between two arc lengths; those of a closed path may exceed one lap. Only segments
    /// whose heading differs from that of the pose by less than 90 degrees count; `None` if there are none.
    pub fn project(&self, pose: &Pose2, from: f64, to: f64) -> Option<Projection> {
        self.candidates(pose, from, to).min_by(|a, b| a.distance.total_cmp(&b.distance))
    }

    /// The projections onto each segment between two arc lengths whose heading differs from that of the pose by less than 90
    /// degrees.
    pub fn candidates<'a>(&'a self, pose: &'a Pose2, from: f64, to: f64) -> impl Iterator<Item = Projection> + 'a {
        let laps = if self.is_closed { (from / self.length()).floor() } else { 0.0 };
        let start = if self.is_closed { from.rem_euclid(self.length()) } else { from };
        let (first, _) = self.segment_at(start);
        let count = self.segments();
        (first..)
            .map_while(move |index| {
                let (lap, segment) = (index / count, index % count);
                let base = (laps + lap as f64) * self.length();
                let is_past = base + self.arc[segment] > to || (lap > 0 && !self.is_closed);
                (!is_past).then_some((base, segment))
            })
            .map(move |(base, segment)| self.nearest_in(segment, base, pose, (from, to)))
            .filter(|projection| projection.heading_error.cos() > 0.0)
    }

    fn nearest_in(&self, segment: usize, base: f64, pose: &Pose2, (from, to): (f64, f64)) -> Projection {
        let (start, step) = (self.waypoints[segment].point, self.step(segment));
        let (length, direction) = (step.norm(), step.normalize());
        let offset = pose.translation() - start;
        let begin = base + self.arc[segment];
        let rest = (begin + offset.dot(&direction).clamp(0.0, length)).clamp(from, to) - begin;
        let difference = offset - direction * rest;
        Projection {
            along: begin + rest,
            lateral_error: direction.perp(&offset),
            heading_error: wrap_angle(pose.theta - direction.y.atan2(direction.x)),
            distance: difference.norm(),
        }
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// Points without speeds.
    pub(in crate::control) fn waypoints(points: &[(f64, f64)]) -> Vec<Waypoint> {
        points.iter().map(|&(x, y)| Waypoint { point: Point::new(x, y), speed: None }).collect()
    }

    /// A counterclockwise circle.
    pub(in crate::control) fn circle(radius: f64, count: u32) -> Path {
        let angle = |i: u32| f64::from(i) / f64::from(count) * std::f64::consts::TAU;
        let points: Vec<_> = (0..count).map(|i| (radius * angle(i).cos(), radius * angle(i).sin())).collect();
        Path::closed_if_loop(&waypoints(&points)).unwrap()
    }

    #[test]
    fn a_circle_is_closed_and_has_its_curvature() {
        let path = circle(4.0, 200);
        assert!(path.is_closed() && (path.length() - 8.0 * std::f64::consts::PI).abs() < 0.01);
        assert!((0..250).all(|i| (path.curvature(f64::from(i) * 0.1) - 0.25).abs() < 0.02));
        assert!((path.point(path.length() + 1.0) - path.point(1.0)).norm() < 1e-9 && path.remaining(3.0).is_infinite());
        let found = path.project(&Pose2::new(0.0, 4.5, std::f64::consts::PI), 3.0, 9.0).unwrap();
        assert!((found.along - 2.0 * std::f64::consts::PI).abs() < 0.01 && (found.lateral_error + 0.5).abs() < 0.01, "{found:?}");
        let later = path.project(&Pose2::new(0.0, 4.5, std::f64::consts::PI), path.length(), 2.0 * path.length()).unwrap();
        assert!((later.along - found.along - path.length()).abs() < 1e-9);
    }

    #[test]
    fn invalid_paths_are_rejected_with_a_reason() {
        assert_eq!(Path::new(&[], false), Err(PathError::Empty));
        assert_eq!(Path::new(&waypoints(&[(1.0, 1.0), (1.0, 1.0)]), false), Err(PathError::NoLength));
        assert_eq!(Path::new(&waypoints(&[(1.0, 1.0), (f64::NAN, 1.0)]), false), Err(PathError::NotFinite { index: 1 }));
    }

    #[test]
    fn an_open_path_continues_straight_beyond_its_ends() {
        let path = Path::closed_if_loop(&waypoints(&[(0.0, 0.0), (1.0, 0.0), (1.0, 0.0), (2.0, 0.0)])).unwrap();
        assert!(!path.is_closed() && path.waypoints().len() == 3);
        assert_eq!((path.point(-1.0), path.point(5.0)), (Point::new(-1.0, 0.0), Point::new(5.0, 0.0)));
        assert_eq!(path.project(&Pose2::new(1.0, 0.0, 3.0), 0.0, 2.0), None, "the path has the opposite heading");
        let there_and_back = waypoints(&[(0.0, 0.0), (1.0, 0.0), (2.0, 0.0), (3.0, 0.0), (2.0, 0.2), (1.0, 0.2)]);
        assert!(!Path::closed_if_loop(&there_and_back[..3]).unwrap().is_closed());
    }

    #[test]
    fn a_speed_of_zero_counts_as_unset() {
        let speeds = [0.0, 0.0, 2.0, f64::NAN, 3.0, 0.0];
        let points: Vec<_> = (0_u32..)
            .zip(speeds)
            .map(|(i, speed)| Waypoint { point: Point::new(f64::from(i), 0.0), speed: Some(speed) })
            .collect();
        let read: Vec<_> = Path::new(&points, false).unwrap().waypoints().iter().map(|w| w.speed).collect();
        assert_eq!(read, [Some(2.0), Some(2.0), Some(2.0), Some(3.0), Some(3.0), None]);
    }
}
