//! Control laws: compute the commanded curvature from the car's pose relative to the path.

mod proportional;
mod pure_pursuit;
mod stanley;

use super::path::{Path, Projection};
use crate::choices;
use crate::geometry::Pose2;

choices! {
    /// Control law for the steering.
    pub enum Law {
        /// Proportional feedback of lateral and heading error, with the path's curvature as feedforward.
        Proportional = "proportional",
        /// Pure pursuit: on a circle to the path point at the lookahead distance.
        PurePursuit = "pure_pursuit",
        /// Stanley: by the heading error and the lateral error of the front axle.
        Stanley = "stanley",
    }
}

/// Inputs of a control law.
#[derive(Clone, Copy, Debug)]
pub struct LawInput<'a> {
    /// The path.
    pub path: &'a Path,
    /// Projection of the car onto the path.
    pub projection: Projection,
    /// Predicted pose of the rear axle when the command takes effect.
    pub pose: Pose2,
    /// Speed, m/s.
    pub speed: f64,
    /// Lookahead distance at this speed, m.
    pub lookahead: f64,
    /// Distance between the axles, m.
    pub wheelbase: f64,
}

impl Law {
    /// Commanded curvature, 1/m, positive to the left.
    pub fn curvature(self, input: &LawInput) -> f64 {
        match self {
            Self::Proportional => proportional::curvature(input),
            Self::PurePursuit => pure_pursuit::curvature(input),
            Self::Stanley => stanley::curvature(input),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::path::tests::{circle, waypoints};
    use crate::geometry::Twist2;

    /// Lateral errors, m, at each step of a car that starts beside the path.
    fn errors(law: Law, path: &Path, speed: f64) -> Vec<f64> {
        let mut pose = path.pose(0.0) * Pose2::new(0.0, 0.3, 0.2);
        let mut along = 0.0;
        (0..1500)
            .map(|_| {
                let projection = path.project(&pose, along, along + 2.0).unwrap();
                along = projection.along;
                let lookahead = 0.5 + 0.2 * speed;
                let curvature =
                    law.curvature(&LawInput { path, projection, pose, speed, lookahead, wheelbase: 0.33 }).clamp(-1.3, 1.3);
                pose = pose * Twist2 { vx: speed, vy: 0.0, omega: speed * curvature }.motion(0.01);
                projection.lateral_error
            })
            .collect()
    }

    #[test]
    fn every_law_converges_to_a_line_and_a_circle() {
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
