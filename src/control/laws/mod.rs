//! Laws of control: from where the car is on its path to the curvature it is to drive.

mod proportional;
mod pure_pursuit;
mod stanley;

use super::path::{Path, Projection};
use crate::choices;
use crate::geometry::Pose2;

choices! {
    /// How the car is steered.
    pub enum Law {
        /// In proportion to lateral and heading error, about the path's curvature.
        Proportional = "proportional",
        /// On the circle to a point of the path ahead.
        PurePursuit = "pure_pursuit",
        /// By the lateral error of the front axle.
        Stanley = "stanley",
    }
}

/// What a law knows.
#[derive(Clone, Copy, Debug)]
pub struct View<'a> {
    /// The path.
    pub path: &'a Path,
    /// Where the car is on it.
    pub place: Projection,
    /// Where the car's rear axle will be when the command acts.
    pub pose: Pose2,
    /// How fast it is, m/s.
    pub speed: f64,
    /// The distance ahead to look at this speed, m.
    pub lookahead: f64,
    /// Distance between the axles, m.
    pub wheelbase: f64,
}

impl Law {
    /// The curvature to drive, 1/m, positive to the left.
    pub fn curvature(self, view: &View) -> f64 {
        match self {
            Self::Proportional => proportional::curvature(view),
            Self::PurePursuit => pure_pursuit::curvature(view),
            Self::Stanley => stanley::curvature(view),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::path::tests::{circle, waypoints};
    use crate::geometry::Twist2;

    /// Errors, m, after each step of a car on the path that begins beside it.
    fn errors(law: Law, path: &Path, speed: f64) -> Vec<f64> {
        let mut pose = path.pose(0.0) * Pose2::new(0.0, 0.3, 0.2);
        let mut along = 0.0;
        (0..1500)
            .map(|_| {
                let place = path.project(&pose, along, along + 2.0).unwrap();
                along = place.along;
                let lookahead = 0.5 + 0.2 * speed;
                let curvature = law.curvature(&View { path, place, pose, speed, lookahead, wheelbase: 0.33 }).clamp(-1.3, 1.3);
                pose = pose * Twist2 { vx: speed, vy: 0.0, omega: speed * curvature }.motion(0.01);
                place.lateral_error
            })
            .collect()
    }

    #[test]
    fn every_law_comes_to_a_line_and_a_circle_and_stays() {
        let line = Path::new(&waypoints(&[(0.0, 0.0), (200.0, 0.0)]), false).unwrap();
        for &law in Law::ALL {
            for (path, allowed) in [(&line, 0.01), (&circle(5.0, 300), 0.05)] {
                for speed in [1.0, 4.0, 7.0] {
                    let errors = errors(law, path, speed);
                    let worst = errors[1000..].iter().fold(0.0_f64, |worst, e| worst.max(e.abs()));
                    assert!(worst < allowed, "{law:?} at {speed} m/s: {worst}");
                }
            }
        }
    }
}
