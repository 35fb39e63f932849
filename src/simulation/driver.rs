//! Autopilot: follows a route with pure pursuit (Coulter, 1992), at the speed that the curves ahead allow.

use crate::geometry::{Point, Pose2};

use super::route::Route;
use super::vehicle::{Command, VehicleKnobs};

/// Lookahead distance at rest, m.
const LOOKAHEAD: f64 = 0.4;
/// Increase of the lookahead distance per m/s of speed, s.
const LOOKAHEAD_TIME: f64 = 0.15;
/// Fraction of the car's deceleration used for planning, so that the car can always follow the planned speed.
const BRAKING_FRACTION: f64 = 0.8;

/// Follows a route.
#[derive(Clone, Debug)]
pub struct Driver<'a> {
    route: &'a Route,
    /// Maximum speed at each point of the route, m/s.
    speeds: Vec<f64>,
    /// Index of the route point nearest to the car; it keeps growing from lap to lap.
    progress: usize,
}

impl<'a> Driver<'a> {
    /// A driver at the start of a route.
    pub fn new(route: &'a Route, knobs: &VehicleKnobs) -> Self {
        let n = route.points().len();
        let in_curve = |i| (knobs.lateral_acceleration / route.curvature(i).abs()).sqrt().min(knobs.speed);
        let mut speeds: Vec<f64> = (0..n).map(in_curve).collect();
        let gain = 2.0 * BRAKING_FRACTION * knobs.acceleration * route.spacing();
        for i in (0..2 * n).rev() {
            let next = speeds[(i + 1) % n];
            speeds[i % n] = speeds[i % n].min((next * next + gain).sqrt());
        }
        Self { route, speeds, progress: 0 }
    }

    /// The start pose: at the first point of the route, heading to the second.
    pub fn start(&self) -> Pose2 {
        let (here, next) = (self.route.point(0), self.route.point(1));
        Pose2::new(here.x, here.y, (next.y - here.y).atan2(next.x - here.x))
    }

    /// Continues from the route point nearest to `position`, after the car was moved.
    pub fn find(&mut self, position: Point) {
        let distance = |&i: &usize| (self.route.point(i) - position).norm_squared();
        self.progress = (0..self.speeds.len()).min_by(|a, b| distance(a).total_cmp(&distance(b))).unwrap_or(0);
    }

    /// The command at `pose` and `speed`.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a few dozen points
    pub fn command(&mut self, pose: &Pose2, speed: f64) -> Command {
        let distance = |index| (self.route.point(index) - pose.translation()).norm();
        while distance(self.progress + 1) < distance(self.progress) {
            self.progress += 1;
        }
        let ahead = ((LOOKAHEAD + LOOKAHEAD_TIME * speed) / self.route.spacing()).ceil() as usize;
        let target = self.route.point(self.progress + ahead);
        let target_in_base = pose.between(&Pose2::new(target.x, target.y, 0.0));
        // The circle through the car, tangent to its heading, that meets the target.
        let curvature = 2.0 * target_in_base.y / target_in_base.translation().norm_squared();
        Command { speed: self.speeds[self.progress % self.speeds.len()], curvature }
    }
}
