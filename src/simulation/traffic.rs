//! Moving obstacles of a simulated drive: people walking along and across the route, and opponent cars near the car.

use std::f64::consts::TAU;

use rand::RngExt;
use rand_pcg::Pcg64;

use crate::geometry::{Point, Pose2};
use crate::knobs;

use super::motion::{Motion, TICK};
use super::rays::Rays;
use super::route::Route;
use super::shapes::Shapes;
use super::world::World;

knobs! {
    /// Moving obstacles of the simulated world.
    pub struct TrafficKnobs {
        /// Number of people, spread over the route, who walk along and across it; they step aside for the car.
        walkers: u32 = 0, in 0 to 1000;
        /// Number of opponent cars that stay within a few metres of the car: the first ahead, the second behind, and so on.
        rivals: u32 = 0, in 0 to 100;
    }
}

/// Radius of a person, m.
const PERSON_RADIUS: f64 = 0.2;
/// Maximum distance of people from the route, m, where there is room.
const MAX_PERSON_OFFSET: f64 = 1.2;
/// Minimum distance of people from the car's rear axle, m.
const MIN_CAR_DISTANCE: f64 = 0.8;
/// Length and width of an opponent car, m.
const OPPONENT_SIZE: (f64, f64) = (0.5, 0.3);
/// Distance from the car to the first opponent, and between opponents on the same side, m.
const OPPONENT_GAP: f64 = 1.4;

/// All moving obstacles of a drive.
#[derive(Clone, Debug, Default)]
pub struct Traffic {
    walkers: Vec<Walker>,
    opponents: Vec<Opponent>,
    lane: Lane,
    /// Distance of the car along the lane over all laps, m, and its position, at each tick.
    car: Vec<(f64, Point)>,
}

#[derive(Clone, Debug)]
struct Walker {
    /// Arc length on the lane at the start, m.
    start: f64,
    /// Speed along the lane, m/s.
    speed: f64,
    /// Lateral motion across the lane.
    crossing: Oscillation,
}

#[derive(Clone, Debug)]
struct Opponent {
    /// Mean distance ahead of the car, m.
    gap: f64,
    /// Variation of the distance.
    surge: Oscillation,
    /// Lateral motion.
    weave: Oscillation,
}

/// A sinusoidal motion.
#[derive(Clone, Debug)]
struct Oscillation {
    amplitude: f64,
    frequency: f64,
    phase: f64,
}

impl Oscillation {
    fn new(amplitude: f64, period: f64, random: &mut Pcg64) -> Self {
        Self { amplitude, frequency: period.recip(), phase: random.random_range(0.0..TAU) }
    }

    fn at(&self, seconds: f64) -> f64 {
        self.amplitude * (TAU * self.frequency * seconds + self.phase).sin()
    }
}

impl Traffic {
    /// Traffic around a car that drives `motion` along `route`.
    pub fn new(knobs: &TrafficKnobs, route: &Route, world: &dyn World, motion: &Motion, mut random: Pcg64) -> Self {
        if knobs.walkers + knobs.rivals == 0 {
            return Self::default();
        }
        let walkers = (0..knobs.walkers).map(|_| {
            let start = random.random_range(0.0..route.length());
            let speed = random.random_range(0.5..1.6) * if random.random() { 1.0 } else { -1.0 };
            let period = random.random_range(6.0..12.0);
            Walker { start, speed, crossing: Oscillation::new(MAX_PERSON_OFFSET, period, &mut random) }
        });
        let walkers = walkers.collect();
        let opponents = (0..knobs.rivals).map(|opponent| {
            let gap = OPPONENT_GAP * f64::from(opponent / 2 + 1);
            let gap = if opponent % 2 == 0 { gap } else { -gap };
            let period = random.random_range(4.0..10.0);
            let surge = Oscillation::new(0.2 * OPPONENT_GAP, period, &mut random);
            Opponent { gap, surge, weave: Oscillation::new(0.3, 0.7 * period, &mut random) }
        });
        let opponents = opponents.collect();
        let lane = Lane::new(route, world);
        Self { walkers, opponents, car: lane.follow(motion), lane }
    }

    /// The world with the traffic `seconds` after the start of the drive.
    pub fn at<'a>(&self, world: &'a dyn World, seconds: f64) -> Snapshot<'a> {
        let Some((progress, car)) = self.car_at(seconds) else { return Snapshot { world, movers: Shapes::default() } };
        let movers = self.walkers.iter().fold(Shapes::default(), |movers, walker| {
            let pose = self.lane.at(walker.start + walker.speed * seconds, walker.crossing.at(seconds), PERSON_RADIUS);
            movers.pillar(car + step_aside(pose.translation() - car), PERSON_RADIUS)
        });
        let movers = self.opponents.iter().fold(movers, |movers, opponent| {
            let along = progress + opponent.gap + opponent.surge.at(seconds);
            let pose = self.lane.at(along, opponent.weave.at(seconds), OPPONENT_SIZE.1);
            movers.block(&pose.transform(), OPPONENT_SIZE.0, OPPONENT_SIZE.1)
        });
        Snapshot { world, movers }
    }

    /// Distance of the car along the lane and its position at a time; `None` without traffic.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // clamped to the drive
    fn car_at(&self, seconds: f64) -> Option<(f64, Point)> {
        let tick = ((seconds / TICK) as usize).min(self.car.len().checked_sub(1)?);
        let next = self.car.get(tick + 1).unwrap_or(&self.car[tick]);
        let fraction = seconds / TICK - tick as f64;
        let (progress, position) = self.car[tick];
        Some((progress + fraction * (next.0 - progress), position + fraction * (next.1 - position)))
    }
}

/// Keeps a person away from the car: limits the vector from the car to the person to at least [`MIN_CAR_DISTANCE`].
fn step_aside(offset: Point) -> Point {
    let distance = offset.norm();
    if distance < MIN_CAR_DISTANCE && distance > 0.0 { offset * (MIN_CAR_DISTANCE / distance) } else { offset }
}

/// The walls and the traffic at one time.
pub struct Snapshot<'a> {
    world: &'a dyn World,
    movers: Shapes,
}

impl World for Snapshot<'_> {
    fn range(&self, origin: Point, direction: Point, max: f64) -> Option<f64> {
        let ranges = [self.movers.range(origin, direction, max), self.world.range(origin, direction, max)];
        ranges.into_iter().flatten().min_by(f64::total_cmp)
    }

    fn ranges(&self, rays: &Rays, max: f64) -> Vec<Option<f64>> {
        let pairs = self.movers.ranges(rays, max).into_iter().zip(self.world.ranges(rays, max));
        pairs.map(|(mover, wall)| mover.into_iter().chain(wall).min_by(f64::total_cmp)).collect()
    }

    fn clearance(&self, point: Point) -> f64 {
        self.world.clearance(point)
    }
}

/// The route with headings and clearances, along which people and cars move.
#[derive(Clone, Debug, Default)]
struct Lane {
    /// Poses on the closed route, and the clearance at each, m.
    samples: Vec<(Pose2, f64)>,
    spacing: f64,
}

impl Lane {
    fn new(route: &Route, world: &dyn World) -> Self {
        let count = route.points().len();
        let sample = |i: usize| {
            let (here, along) = (route.point(i), route.point(i + 1) - route.point(i + count - 1));
            (Pose2::new(here.x, here.y, along.y.atan2(along.x)), world.clearance(here))
        };
        Self { samples: (0..count).map(sample).collect(), spacing: route.spacing() }
    }

    /// The pose at an arc length on the lane, shifted to the left by `lateral` as far as an obstacle of this radius fits.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // the remainder is an index
    fn at(&self, along: f64, lateral: f64, radius: f64) -> Pose2 {
        let steps = (along / self.spacing).rem_euclid(self.samples.len() as f64);
        let (index, fraction) = (steps as usize % self.samples.len(), steps.fract());
        let ((here, clearance), (next, next_clearance)) = (self.samples[index], self.samples[(index + 1) % self.samples.len()]);
        let middle = here.interpolate(&next, fraction);
        let free = (clearance + fraction * (next_clearance - clearance) - radius).max(0.0);
        middle * Pose2::new(0.0, lateral.clamp(-free, free), 0.0)
    }

    /// Distance along the lane and position at each tick of a drive.
    fn follow(&self, motion: &Motion) -> Vec<(f64, Point)> {
        let point = |index: usize| self.samples[index % self.samples.len()].0.translation();
        let mut index = 0;
        motion
            .ticks()
            .map(|pose| {
                let car = pose.translation();
                while (point(index + 1) - car).norm() < (point(index) - car).norm() {
                    index += 1;
                }
                let ahead = (car - point(index)).dot(&(point(index + 1) - point(index))) / self.spacing;
                (index as f64 * self.spacing + ahead, car)
            })
            .collect()
    }
}
