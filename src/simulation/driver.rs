//! Follows a route: pure pursuit (Coulter, 1992), at a speed that the curves ahead allow.

use crate::geometry::{Point, Pose2};

use super::route::Route;
use super::vehicle::{Command, VehicleKnobs};

/// The driver aims at a point of the route this far ahead when standing, m,
const LOOKAHEAD: f64 = 0.4;
/// and this much farther for every m/s, s.
const LOOKAHEAD_TIME: f64 = 0.15;
/// Part of the car's braking that is planned with, so that speed is never behind the plan.
const BRAKING_RESERVE: f64 = 0.8;

/// Someone at the wheel.
#[derive(Clone, Debug)]
pub struct Driver<'a> {
    route: &'a Route,
    /// Speed allowed at each point of the route, m/s.
    speeds: Vec<f64>,
    /// The point of the route nearest to the car, counted on from lap to lap.
    progress: usize,
}

impl<'a> Driver<'a> {
    /// A driver at the start of a route.
    pub fn new(route: &'a Route, knobs: &VehicleKnobs) -> Self {
        let n = route.points().len();
        let in_curve = |i| (knobs.lateral_acceleration / route.curvature(i).abs()).sqrt().min(knobs.speed);
        let mut speeds: Vec<f64> = (0..n).map(in_curve).collect();
        let gain = 2.0 * BRAKING_RESERVE * knobs.acceleration * route.spacing();
        for i in (0..2 * n).rev() {
            let next = speeds[(i + 1) % n];
            speeds[i % n] = speeds[i % n].min((next * next + gain).sqrt());
        }
        Self { route, speeds, progress: 0 }
    }

    /// The pose to start from: on the route's first point, towards the second.
    pub fn start(&self) -> Pose2 {
        let (here, next) = (self.route.point(0), self.route.point(1));
        Pose2::new(here.x, here.y, (next.y - here.y).atan2(next.x - here.x))
    }

    /// The car was carried off: goes on from the point of the route nearest to `place`.
    pub fn find(&mut self, place: Point) {
        let distance = |&i: &usize| (self.route.point(i) - place).norm_squared();
        self.progress = (0..self.speeds.len()).min_by(|a, b| distance(a).total_cmp(&distance(b))).unwrap_or(0);
    }

    /// What to do at `pose` and `speed`.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a few dozen points
    pub fn command(&mut self, pose: &Pose2, speed: f64) -> Command {
        let distance = |index| (self.route.point(index) - pose.translation()).norm();
        while distance(self.progress + 1) < distance(self.progress) {
            self.progress += 1;
        }
        let ahead = ((LOOKAHEAD + LOOKAHEAD_TIME * speed) / self.route.spacing()).ceil() as usize;
        let target = self.route.point(self.progress + ahead);
        let seen = pose.between(&Pose2::new(target.x, target.y, 0.0));
        // The circle through the car, tangent to its heading, that meets the target.
        let curvature = 2.0 * seen.y / seen.translation().norm_squared();
        Command { speed: self.speeds[self.progress % self.speeds.len()], curvature }
    }
}
