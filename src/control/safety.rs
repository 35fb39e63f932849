//! Reasons to stop the car, and the collision check.

use std::fmt;

use crate::geometry::Point;

/// Minimum number of rays that must hit an obstacle: fewer are noise.
const MIN_RAYS: usize = 3;
/// Arcs of a smaller curvature count as straight, 1/m.
const MIN_CURVATURE: f64 = 1e-4;

/// Why the car stands or brakes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum StopReason {
    /// There is no path to follow.
    NoPath,
    /// No pose has been received yet.
    NoPose,
    /// The pose is too old; its age, s. Negative: it is in the future.
    PoseAge(f64),
    /// The standard deviation of the position is too large, m.
    PoseUncertain(f64),
    /// The car is too far from the path; the distance, m.
    PathFar(f64),
    /// The path does not lead in the direction of the car's heading.
    WrongWay,
    /// The clock jumped, and no pose was received since.
    ClockJumped,
    /// Scans were received before, but the last one is too old; its age, s.
    ScanAge(f64),
    /// There is an obstacle ahead; the time to collision, s. Latched: the car stays until it is resumed.
    Collision(f64),
    /// The car has reached the end of the path.
    Arrived,
}

impl StopReason {
    /// Machine-readable code.
    pub fn code(&self) -> &'static str {
        match self {
            Self::NoPath => "no_path",
            Self::NoPose => "no_pose",
            Self::PoseAge(_) => "pose_age",
            Self::PoseUncertain(_) => "pose_uncertain",
            Self::PathFar(_) => "path_far",
            Self::WrongWay => "wrong_way",
            Self::ClockJumped => "clock_jumped",
            Self::ScanAge(_) => "scan_age",
            Self::Collision(_) => "collision",
            Self::Arrived => "arrived",
        }
    }

    /// Whether the stop lasts after its cause is gone.
    pub fn is_latched(&self) -> bool {
        matches!(self, Self::Collision(_))
    }
}

impl fmt::Display for StopReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoPath => write!(f, "no path: none was received, or the last one was empty"),
            Self::NoPose => write!(f, "no pose was received"),
            Self::PoseAge(age) if *age < 0.0 => {
                write!(f, "the pose is {:.2} s in the future: are the clocks synchronized?", -age)
            }
            Self::PoseAge(age) => write!(f, "the pose is {age:.2} s old"),
            Self::PoseUncertain(deviation) => write!(f, "the standard deviation of the position is {deviation:.2} m"),
            Self::PathFar(distance) => write!(f, "the path is {distance:.2} m away"),
            Self::WrongWay => write!(f, "the path leads in another direction than the car's heading"),
            Self::ClockJumped => write!(f, "the clock jumped, and no pose was received since"),
            Self::ScanAge(age) => write!(f, "the last scan is {age:.2} s old"),
            Self::Collision(time) => write!(f, "an obstacle {time:.2} s ahead; call ~resume to continue"),
            Self::Arrived => write!(f, "arrived"),
        }
    }
}

/// The outline of a car relative to its rear axle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Footprint {
    /// Distance from the rear axle to the front bumper, m.
    pub front: f64,
    /// Width, m.
    pub width: f64,
}

impl Footprint {
    /// Distance that the car can drive on an arc of this curvature before it hits a point of the scan, m. The points are in the
    /// frame of the rear axle.
    pub fn free_distance(&self, points: &[Point], curvature: f64) -> f64 {
        let mut distances: Vec<f64> = points.iter().filter_map(|point| self.distance_to(*point, curvature)).collect();
        if distances.len() < MIN_RAYS {
            return f64::INFINITY;
        }
        let (_, distance, _) = distances.select_nth_unstable_by(MIN_RAYS - 1, f64::total_cmp);
        *distance
    }

    /// Distance to a point along the arc, m; `None` if the car passes it or it is behind.
    fn distance_to(&self, point: Point, curvature: f64) -> Option<f64> {
        let (along, aside) = if curvature.abs() < MIN_CURVATURE {
            (point.x, point.y)
        } else {
            // Mirrored, so that the arc always turns left.
            let (radius, y) = (curvature.abs().recip(), point.y * curvature.signum());
            (point.x.atan2(radius - y) * radius, point.x.hypot(radius - y) - radius)
        };
        (along > 0.0 && aside.abs() <= 0.5 * self.width).then_some((along - self.front).max(0.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CAR: Footprint = Footprint { front: 0.45, width: 0.3 };

    fn free_distance(point: (f64, f64), curvature: f64) -> f64 {
        CAR.free_distance(&[Point::new(point.0, point.1); 3], curvature)
    }

    #[test]
    fn obstacles_on_the_arc_are_found() {
        assert!((free_distance((2.0, 0.1), 0.0) - 1.55).abs() < 1e-9 && free_distance((2.0, 0.2), 0.0).is_infinite());
        assert!(free_distance((-1.0, 0.0), 0.0).is_infinite(), "behind");
        // A quarter of a circle of radius 2 to either side.
        for side in [1.0, -1.0] {
            assert!((free_distance((2.0, 2.0 * side), 0.5 * side) - (std::f64::consts::PI - 0.45)).abs() < 1e-9);
            assert!(free_distance((2.0, 0.0), 0.5 * side).is_infinite());
        }
        assert!(CAR.free_distance(&[Point::new(1.0, 0.0); 2], 0.0).is_infinite(), "two rays are noise");
    }
}
