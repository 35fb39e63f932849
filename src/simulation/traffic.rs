//! What moves in a simulated world besides the car: people who walk along and across its route, and rival cars that keep it company.

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
    /// What moves in the simulated world besides the car.
    pub struct TrafficKnobs {
        /// People who walk about the route, spread over all of it, and to and fro across it; they step aside for the car.
        walkers: u32 = 0, in 0 to 1000;
        /// Cars that keep within a few metres of the car, the first ahead, the next behind, and so on.
        rivals: u32 = 0, in 0 to 100;
    }
}

/// Radius of a person, m.
const GIRTH: f64 = 0.2;
/// How far people go from the route, m, where there is room.
const STROLL: f64 = 1.2;
/// Nobody comes nearer to the car's rear axle than this, m.
const KEEP_OFF: f64 = 0.8;
/// Length and width of a rival car, m.
const RIVAL: (f64, f64) = (0.5, 0.3);
/// Distance from the car to the first rival, and from one on the same side to the next, m.
const RIVAL_GAP: f64 = 1.4;

/// All movers, at any time of a drive.
#[derive(Clone, Debug, Default)]
pub struct Traffic {
    walkers: Vec<Walker>,
    rivals: Vec<Rival>,
    lane: Lane,
    /// How far the car is along the lane, m, laps added up, and where it is, at each tick.
    car: Vec<(f64, Point)>,
}

#[derive(Clone, Debug)]
struct Walker {
    /// Place along the lane at the start, m.
    start: f64,
    /// Along the lane, m/s.
    speed: f64,
    crossing: Swing,
}

#[derive(Clone, Debug)]
struct Rival {
    /// Mean distance ahead of the car, m.
    gap: f64,
    /// About the mean distance.
    surge: Swing,
    /// To the side.
    weave: Swing,
}

/// A to and fro.
#[derive(Clone, Debug)]
struct Swing {
    size: f64,
    frequency: f64,
    phase: f64,
}

impl Swing {
    fn new(size: f64, seconds: f64, random: &mut Pcg64) -> Self {
        Self { size, frequency: seconds.recip(), phase: random.random_range(0.0..TAU) }
    }

    fn at(&self, seconds: f64) -> f64 {
        self.size * (TAU * self.frequency * seconds + self.phase).sin()
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
            let seconds = random.random_range(6.0..12.0);
            Walker { start, speed, crossing: Swing::new(STROLL, seconds, &mut random) }
        });
        let walkers = walkers.collect();
        let rivals = (0..knobs.rivals).map(|rival| {
            let gap = RIVAL_GAP * f64::from(rival / 2 + 1);
            let gap = if rival % 2 == 0 { gap } else { -gap };
            let seconds = random.random_range(4.0..10.0);
            let surge = Swing::new(0.2 * RIVAL_GAP, seconds, &mut random);
            Rival { gap, surge, weave: Swing::new(0.3, 0.7 * seconds, &mut random) }
        });
        let rivals = rivals.collect();
        let lane = Lane::new(route, world);
        Self { walkers, rivals, car: lane.follow(motion), lane }
    }

    /// The world as it is `seconds` after the start of the drive.
    pub fn at<'a>(&self, world: &'a dyn World, seconds: f64) -> Moment<'a> {
        let Some((progress, car)) = self.car_at(seconds) else { return Moment { world, movers: Shapes::default() } };
        let movers = self.walkers.iter().fold(Shapes::default(), |movers, walker| {
            let place = self.lane.at(walker.start + walker.speed * seconds, walker.crossing.at(seconds), GIRTH);
            movers.pillar(car + aside(place.translation() - car), GIRTH)
        });
        let movers = self.rivals.iter().fold(movers, |movers, rival| {
            let along = progress + rival.gap + rival.surge.at(seconds);
            let place = self.lane.at(along, rival.weave.at(seconds), RIVAL.1);
            movers.block(&place.transform(), RIVAL.0, RIVAL.1)
        });
        Moment { world, movers }
    }

    /// `None` when there is no traffic.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // clamped to the drive
    fn car_at(&self, seconds: f64) -> Option<(f64, Point)> {
        let tick = ((seconds / TICK) as usize).min(self.car.len().checked_sub(1)?);
        let next = self.car.get(tick + 1).unwrap_or(&self.car[tick]);
        let fraction = seconds / TICK - tick as f64;
        let (progress, place) = self.car[tick];
        Some((progress + fraction * (next.0 - progress), place + fraction * (next.1 - place)))
    }
}

/// The way from the car to someone who steps aside for it.
fn aside(way: Point) -> Point {
    let distance = way.norm();
    if distance < KEEP_OFF && distance > 0.0 { way * (KEEP_OFF / distance) } else { way }
}

/// The walls and the traffic of one moment.
pub struct Moment<'a> {
    world: &'a dyn World,
    movers: Shapes,
}

impl World for Moment<'_> {
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

/// A route as movers see it.
#[derive(Clone, Debug, Default)]
struct Lane {
    /// Points of the route with their headings, the last one followed by the first, and the room to the walls there.
    places: Vec<(Pose2, f64)>,
    spacing: f64,
}

impl Lane {
    fn new(route: &Route, world: &dyn World) -> Self {
        let count = route.points().len();
        let place = |i: usize| {
            let (here, along) = (route.point(i), route.point(i + 1) - route.point(i + count - 1));
            (Pose2::new(here.x, here.y, along.y.atan2(along.x)), world.clearance(here))
        };
        Self { places: (0..count).map(place).collect(), spacing: route.spacing() }
    }

    /// The place so far along the lane, `aside` to its left as far as there is room for something of a radius.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // the remainder is an index
    fn at(&self, along: f64, aside: f64, radius: f64) -> Pose2 {
        let steps = (along / self.spacing).rem_euclid(self.places.len() as f64);
        let (index, fraction) = (steps as usize % self.places.len(), steps.fract());
        let ((here, room), (next, room_there)) = (self.places[index], self.places[(index + 1) % self.places.len()]);
        let middle = here.interpolate(&next, fraction);
        let free = (room + fraction * (room_there - room) - radius).max(0.0);
        middle * Pose2::new(0.0, aside.clamp(-free, free), 0.0)
    }

    /// How far along the lane a drive is, and where, at each tick.
    fn follow(&self, motion: &Motion) -> Vec<(f64, Point)> {
        let point = |index: usize| self.places[index % self.places.len()].0.translation();
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
