//! Random surroundings, each with a laser pose in them.

use std::f64::consts::{PI, TAU};

use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;

use crate::choices;
use crate::geometry::{Point, Pose2, perpendicular};

use super::shapes::Shapes;
use super::world::World;

choices! {
    /// The kinds of random surroundings.
    pub enum RandomWorld {
        /// Rooms of 9 to 20 m, right-angled or not, with furniture and pillars.
        Room = "room",
        /// An empty corridor 3 m wide whose ends are out of range.
        FeaturelessCorridor = "featureless_corridor",
        /// A corridor 3 m wide with recessed doors, pillars or closed ends.
        Corridor = "corridor",
        /// Rooms with a single curved wall, with furniture.
        CurvedRoom = "curved_room",
        /// Rooms with walls that are rough by some centimetres, with furniture.
        RoughRoom = "rough_room",
    }
}

/// Walls, and a laser pose between them.
#[derive(Clone, Debug)]
pub struct Surroundings {
    /// The walls.
    pub walls: Shapes,
    /// Pose of the laser, with no wall within [`CLEARANCE`].
    pub map_from_laser: Pose2,
}

/// Minimum distance of the laser from walls, m.
pub const CLEARANCE: f64 = 0.5;
/// Radius in the middle of a room without furniture, m, so that there is room for the laser.
const FREE_RADIUS: f64 = 1.5;
/// Half the width of a corridor, m.
const HALF_WIDTH: f64 = 1.5;
/// Half the length of a corridor without ends, m: beyond the range of the laser.
const ENDLESS: f64 = 100.0;
/// Standard deviation of the corners of a rough wall from a straight one, m.
const ROUGHNESS: f64 = 0.02;
/// Corners of a curved wall: enough to approximate the curve to a fraction of a millimetre.
const CURVE_CORNERS: u32 = 360;
/// Maximum attempts to find a free position.
const MAX_TRIES: usize = 100;

impl RandomWorld {
    /// Samples surroundings of this kind.
    pub fn sample(self, random: &mut Pcg64) -> Surroundings {
        match self {
            Self::Room => furnished(&room_outline(random), random),
            Self::CurvedRoom => furnished(&curved_outline(random), random),
            Self::RoughRoom => furnished(&roughened(&room_outline(random), random), random),
            Self::FeaturelessCorridor => in_corridor(long_walls(), random),
            Self::Corridor => in_corridor(corridor(random), random),
        }
    }
}

/// A uniformly distributed number.
fn uniform(random: &mut Pcg64, low: f64, high: f64) -> f64 {
    random.random_range(low..high)
}

fn direction(angle: f64) -> Point {
    let (sin, cos) = angle.sin_cos();
    Point::new(cos, sin)
}

/// Outline of a room. All of it is visible from its middle, the origin.
fn room_outline(random: &mut Pcg64) -> Vec<Point> {
    if random.random() { right_angled_outline(random) } else { slanted_outline(random) }
}

/// A rectangle with some rectangular cut-outs at its corners.
fn right_angled_outline(random: &mut Pcg64) -> Vec<Point> {
    let (half_length, half_width) = (uniform(random, 5.0, 10.0), uniform(random, 4.5, 7.5));
    let mut corners = Vec::new();
    for (quadrant, (sx, sy)) in [(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)].into_iter().enumerate() {
        let at = |x: f64, y: f64| Point::new(sx * (half_length - x), sy * (half_width - y));
        if random.random() {
            let (x, y) = (uniform(random, 0.3, 1.4), uniform(random, 0.3, 1.4));
            let mut cut = [at(0.0, y), at(x, y), at(x, 0.0)];
            if quadrant % 2 == 1 {
                cut.reverse();
            }
            corners.extend(cut);
        } else {
            corners.push(at(0.0, 0.0));
        }
    }
    corners
}

/// A random polygon, convex or not.
fn slanted_outline(random: &mut Pcg64) -> Vec<Point> {
    let corners = random.random_range(4..10);
    let step = TAU / f64::from(corners);
    (0..corners)
        .map(|corner| {
            let angle = (f64::from(corner) + uniform(random, -0.25, 0.25)) * step;
            direction(angle) * uniform(random, 6.0, 12.0)
        })
        .collect()
}

/// A closed wall whose distance from the middle varies in a few waves.
fn curved_outline(random: &mut Pcg64) -> Vec<Point> {
    let radius = uniform(random, 3.5, 6.5);
    let waves = [2.0, 3.0, 4.0, 5.0].map(|wave| (wave, uniform(random, 0.0, 0.3) / wave, uniform(random, 0.0, TAU)));
    (0..CURVE_CORNERS)
        .map(|corner| {
            let angle = TAU * f64::from(corner) / f64::from(CURVE_CORNERS);
            let swing: f64 = waves.iter().map(|(wave, height, phase)| height * (wave * angle + phase).cos()).sum();
            direction(angle) * (radius * (1.0 + swing))
        })
        .collect()
}

/// The same outline, from short segments with small lateral errors.
fn roughened(corners: &[Point], random: &mut Pcg64) -> Vec<Point> {
    let mut rough = Vec::new();
    for (&from, &to) in corners.iter().zip(corners.iter().cycle().skip(1)) {
        let length = (to - from).norm();
        let (along, across) = ((to - from) / length, perpendicular(to - from) / length);
        let mut passed = 0.0;
        while passed < length {
            let off: f64 = StandardNormal.sample(random);
            rough.push(from + along * passed + across * (ROUGHNESS * off));
            passed += uniform(random, 0.04, 0.15);
        }
    }
    rough
}

/// A room with random furniture and a random laser pose.
fn furnished(outline: &[Point], random: &mut Pcg64) -> Surroundings {
    let bare = Shapes::default().outline(outline);
    let anywhere = |random: &mut Pcg64| Point::new(uniform(random, -9.0, 9.0), uniform(random, -9.0, 9.0));
    let inside = |point: &Point| bare.range(Point::zeros(), point.normalize(), point.norm()).is_none();
    let mut walls = bare.clone();
    for _ in 0..random.random_range(1..5) {
        let yaw = if random.random() { 0.0 } else { uniform(random, 0.0, PI) };
        let (length, width, radius) = (uniform(random, 0.4, 1.6), uniform(random, 0.3, 0.7), uniform(random, 0.05, 0.3));
        let round: bool = random.random();
        let free = |point: &Point| inside(point) && point.norm() > FREE_RADIUS;
        let Some(position) = (0..MAX_TRIES).map(|_| anywhere(random)).find(free) else { continue };
        walls = if round {
            walls.pillar(position, radius)
        } else {
            walls.block(&Pose2::new(position.x, position.y, yaw).transform(), length, width)
        };
    }
    let clear = |point: &Point| inside(point) && walls.clearance(*point) > CLEARANCE;
    let position = (0..MAX_TRIES).map(|_| anywhere(random)).find(clear).unwrap_or_default();
    let map_from_laser = Pose2::new(position.x, position.y, uniform(random, -PI, PI));
    Surroundings { walls, map_from_laser }
}

/// A corridor along the x axis with a random laser pose, heading roughly along it.
fn in_corridor(walls: Shapes, random: &mut Pcg64) -> Surroundings {
    let free = HALF_WIDTH - 2.0 * CLEARANCE;
    let near_origin = |random: &mut Pcg64| Point::new(uniform(random, -2.0, 2.0), uniform(random, -free, free));
    let position =
        (0..MAX_TRIES).map(|_| near_origin(random)).find(|point| walls.clearance(*point) > CLEARANCE).unwrap_or_default();
    let back = if random.random() { PI } else { 0.0 };
    let map_from_laser = Pose2::new(position.x, position.y, back + uniform(random, -0.4, 0.4));
    Surroundings { walls, map_from_laser }
}

fn long_walls() -> Shapes {
    let side = |y: f64| [Point::new(-ENDLESS, y), Point::new(ENDLESS, y)];
    Shapes::default().walls(&side(-HALF_WIDTH)).walls(&side(HALF_WIDTH))
}

/// A corridor with at least one kind of feature.
fn corridor(random: &mut Pcg64) -> Shapes {
    let [mut doors, mut pillars, mut ends]: [bool; 3] = std::array::from_fn(|_| random.random());
    if !(doors || pillars || ends) {
        [doors, pillars, ends] = [[true, false, false], [false, true, false], [false, false, true]][random.random_range(0..3)];
    }
    let reach = |random: &mut Pcg64| if ends { uniform(random, 5.0, 14.0) } else { ENDLESS };
    let (behind, ahead) = (-reach(random), reach(random));
    let mut shapes = Shapes::default();
    for side in [-HALF_WIDTH, HALF_WIDTH] {
        let mut wall = vec![Point::new(behind, side)];
        if doors {
            wall.extend(doors_along(side, behind.max(-15.0), ahead.min(15.0), random));
        }
        wall.push(Point::new(ahead, side));
        shapes = shapes.walls(&wall);
    }
    for end in [behind, ahead].into_iter().filter(|end| end.abs() < ENDLESS) {
        shapes = shapes.walls(&[Point::new(end, -HALF_WIDTH), Point::new(end, HALF_WIDTH)]);
    }
    let count = if pillars { random.random_range(2..8) } else { 0 };
    (0..count).fold(shapes, |shapes, _| {
        let (x, radius) = (uniform(random, behind.max(-8.0), ahead.min(8.0)), uniform(random, 0.08, 0.25));
        let side = if random.random() { HALF_WIDTH } else { -HALF_WIDTH };
        shapes.pillar(Point::new(x, side), radius)
    })
}

/// Recessed doors in the wall at y = `side`, every few metres.
fn doors_along(side: f64, from: f64, to: f64, random: &mut Pcg64) -> Vec<Point> {
    let mut corners = Vec::new();
    let mut x = from + uniform(random, 0.5, 3.0);
    while x + 1.5 < to {
        let (width, depth) = (uniform(random, 0.8, 1.2), uniform(random, 0.1, 0.35).copysign(side));
        corners
            .extend([(x, side), (x, side + depth), (x + width, side + depth), (x + width, side)].map(|(x, y)| Point::new(x, y)));
        x += width + uniform(random, 1.0, 4.0);
    }
    corners
}
