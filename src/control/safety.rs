//! When the car must stop, and when it may go on.

use std::fmt;

use crate::geometry::Point;

/// So many rays must see an obstacle: one that sees one alone is noise.
const RAYS: usize = 3;
/// A circle of a smaller curvature is a straight line, 1/m.
const STRAIGHT: f64 = 1e-4;

/// Why the car stands or brakes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum StopReason {
    /// There is no path to follow.
    NoPath,
    /// There is no pose yet.
    NoPose,
    /// The pose is of too long ago, s; less than zero: of the future.
    PoseAge(f64),
    /// The position has too large a standard deviation, m.
    PoseUncertain(f64),
    /// The car is too far from the path, m.
    PathFar(f64),
    /// The path goes another way than the car looks.
    WrongWay,
    /// The clock has jumped, and there was no pose since.
    ClockJumped,
    /// Scans have come, and come no more, s.
    ScanAge(f64),
    /// There is something in the way, s away. Latched: somebody has to say that the car may go on.
    Collision(f64),
    /// The end of the path is reached.
    Arrived,
}

impl StopReason {
    /// Its code, for programs.
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

    /// Whether the car stays even when the cause is gone.
    pub fn is_latched(&self) -> bool {
        matches!(self, Self::Collision(_))
    }
}

impl fmt::Display for StopReason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoPath => write!(f, "no path: none has come, or an empty one"),
            Self::NoPose => write!(f, "no pose has come"),
            Self::PoseAge(age) if *age < 0.0 => write!(f, "the pose is {:.2} s in the future: do the clocks agree?", -age),
            Self::PoseAge(age) => write!(f, "the pose is {age:.2} s old"),
            Self::PoseUncertain(deviation) => write!(f, "the position is uncertain by {deviation:.2} m"),
            Self::PathFar(distance) => write!(f, "the path is {distance:.2} m away"),
            Self::WrongWay => write!(f, "the path goes the other way here"),
            Self::ClockJumped => write!(f, "the clock has jumped, and no pose has come since"),
            Self::ScanAge(age) => write!(f, "the scan is {age:.2} s old"),
            Self::Collision(time) => write!(f, "an obstacle {time:.2} s ahead; call ~resume to go on"),
            Self::Arrived => write!(f, "arrived"),
        }
    }
}

/// The outline of a car about its rear axle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Footprint {
    /// From the rear axle to the front bumper, m.
    pub front: f64,
    /// m.
    pub width: f64,
}

impl Footprint {
    /// Way that the car can go on an arc of this curvature until it meets what the scan sees, m; points are seen from the rear axle.
    pub fn free_way(&self, points: &[Point], curvature: f64) -> f64 {
        let mut ways: Vec<f64> = points.iter().filter_map(|point| self.way_to(*point, curvature)).collect();
        if ways.len() < RAYS {
            return f64::INFINITY;
        }
        let (_, way, _) = ways.select_nth_unstable_by(RAYS - 1, f64::total_cmp);
        *way
    }

    /// `None`: the car passes it by, or it is behind.
    fn way_to(&self, point: Point, curvature: f64) -> Option<f64> {
        let (along, aside) = if curvature.abs() < STRAIGHT {
            (point.x, point.y)
        } else {
            // As to the left.
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

    fn way(point: (f64, f64), curvature: f64) -> f64 {
        CAR.free_way(&[Point::new(point.0, point.1); 3], curvature)
    }

    #[test]
    fn what_is_in_the_way_is_found_on_the_arc() {
        assert!((way((2.0, 0.1), 0.0) - 1.55).abs() < 1e-9 && way((2.0, 0.2), 0.0).is_infinite());
        assert!(way((-1.0, 0.0), 0.0).is_infinite(), "behind");
        // A quarter of a circle of radius 2 to either side.
        for side in [1.0, -1.0] {
            assert!((way((2.0, 2.0 * side), 0.5 * side) - (std::f64::consts::PI - 0.45)).abs() < 1e-9);
            assert!(way((2.0, 0.0), 0.5 * side).is_infinite());
        }
        assert!(CAR.free_way(&[Point::new(1.0, 0.0); 2], 0.0).is_infinite(), "two rays are noise");
    }
}
