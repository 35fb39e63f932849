//! Built-in worlds that need no map file, with a predefined route.

use std::f64::consts::FRAC_PI_2;

use crate::choices;
use crate::geometry::{Point, Pose2};

use super::shapes::Shapes;

choices! {
    /// The built-in worlds.
    pub enum BuiltIn {
        /// A closed corridor 3 m wide around a block of rooms; a lap is about 65 m.
        Corridor = "corridor",
        /// A furnished room of 10 m by 8 m.
        Room = "room",
    }
}

impl BuiltIn {
    /// The walls, and the corners of the route between them.
    pub fn build(self) -> (Shapes, Vec<Point>) {
        match self {
            Self::Corridor => (corridor(), points(&CORRIDOR_ROUTE)),
            Self::Room => (room(), points(&ROOM_ROUTE)),
        }
    }
}

type Corners = [(f64, f64)];

fn points(corners: &Corners) -> Vec<Point> {
    corners.iter().map(|&(x, y)| Point::new(x, y)).collect()
}

fn pillars(shapes: Shapes, radius: f64, centres: &Corners) -> Shapes {
    points(centres).into_iter().fold(shapes, |shapes, centre| shapes.pillar(centre, radius))
}

/// Adds rectangles of the given length and width at the poses `(x, y, yaw)`.
fn blocks(shapes: Shapes, length: f64, width: f64, poses: &[(f64, f64, f64)]) -> Shapes {
    poses.iter().fold(shapes, |shapes, &(x, y, yaw)| shapes.block(&Pose2::new(x, y, yaw).transform(), length, width))
}

const CORRIDOR_ROUTE: [(f64, f64); 8] =
    [(0.0, -6.1), (6.0, -5.9), (11.5, -6.0), (11.3, 0.0), (11.5, 6.0), (0.0, 6.1), (-11.5, 6.0), (-11.5, -6.0)];

#[rustfmt::skip] // one feature per line
const CORRIDOR_OUTSIDE: &Corners = &[
    (-13.0, -7.5),
    (-8.6, -7.5), (-8.6, -7.8), (-7.6, -7.8), (-7.6, -7.5), // a recessed door
    (3.4, -7.5), (3.4, -7.8), (4.4, -7.8), (4.4, -7.5), // another one
    (9.2, -7.5), (13.0, -6.2), // a slanted wall in the corner
    (13.0, -1.2), (17.5, -1.2), (18.3, 0.9), (13.0, 1.2), // a dead end
    (13.0, 4.0), (13.3, 4.0), (13.3, 5.0), (13.0, 5.0), // a door
    (13.0, 7.5),
    (6.0, 7.5), (6.0, 7.8), (5.0, 7.8), (5.0, 7.5), // a door
    (-9.0, 7.5), (-13.0, 6.4), // a slanted wall in the corner
    (-13.0, 2.0), (-14.2, 1.6), (-14.2, -1.6), (-13.0, -2.0), // a bay
];

#[rustfmt::skip]
const CORRIDOR_INSIDE: &Corners = &[
    (-10.0, -4.5),
    (-3.0, -4.5), (-3.0, -4.2), (-2.0, -4.2), (-2.0, -4.5), // a door
    (6.2, -4.5), (6.2, -4.2), (7.2, -4.2), (7.2, -4.5), // a door
    (10.0, -4.5),
    (10.0, 3.9), (9.4, 4.5), // a cut corner
    (3.0, 4.5), (2.6, 2.7), (-1.6, 2.7), (-2.0, 4.5), // a lobby
    (-10.0, 4.5),
    (-10.0, 1.1), (-9.7, 1.1), (-9.7, 0.1), (-10.0, 0.1), // a door
];

fn corridor() -> Shapes {
    let walls = Shapes::default().outline(&points(CORRIDOR_OUTSIDE)).outline(&points(CORRIDOR_INSIDE));
    let walls = walls.walls(&points(&[(3.4, -7.55), (4.05, -7.2)])); // a door ajar
    let pilasters = [(-5.0, -7.4), (0.5, -7.4), (7.5, -7.4), (-7.5, 7.4), (-3.5, 7.4), (0.5, 7.4), (9.5, 7.4)];
    let walls = blocks(walls, 0.5, 0.2, &pilasters.map(|(x, y)| (x, y, 0.0)));
    let walls = blocks(walls, 1.0, 0.7, &[(-12.6, -4.2, FRAC_PI_2), (15.6, 0.3, 0.4)]); // a vending machine, and a crate
    pillars(walls, 0.18, &[(-5.5, -4.85), (2.0, -4.85), (12.6, 2.6), (10.4, -2.4), (-12.6, 3.6), (-1.6, 4.1), (2.6, 4.1)])
}

const ROOM_ROUTE: [(f64, f64); 6] = [(0.0, -2.35), (3.1, -2.2), (3.2, 1.2), (0.0, 2.1), (-3.2, 1.8), (-3.1, -2.0)];

#[rustfmt::skip]
const ROOM_WALLS: &Corners = &[
    (-5.0, -4.0),
    (1.2, -4.0), (1.2, -4.3), (2.2, -4.3), (2.2, -4.0), // a door
    (5.0, -4.0),
    (5.0, 1.6), (3.2, 4.0), // a slanted wall
    (0.6, 4.0), (0.2, 4.5), (-2.0, 4.5), (-2.4, 4.0), // a bay window
    (-4.2, 4.0), (-4.2, 3.2), (-5.0, 3.2), // a chimney in the corner
];

#[rustfmt::skip]
const ROOM_LEGS: &Corners = &[
    (-0.9, -0.55), (0.9, -0.35), (0.8, 0.55), (-1.0, 0.35), // of a table
    (-0.35, -0.85), (0.05, -0.8), (-0.4, -0.5), (0.0, -0.45), // of a chair
    (0.1, 0.75), (0.5, 0.8), (0.15, 0.4), (0.55, 0.45), // of another one
];

fn room() -> Shapes {
    let walls = Shapes::default().outline(&points(ROOM_WALLS));
    let walls = blocks(walls, 2.0, 0.7, &[(-2.6, -3.5, 0.05)]); // a sofa
    let walls = blocks(walls, 1.6, 0.4, &[(4.75, -2.2, FRAC_PI_2), (-4.7, 0.6, 1.45)]); // shelves, a desk
    let walls = blocks(walls, 0.5, 0.5, &[(-1.6, 0.0, 0.35)]); // an armchair
    let walls = pillars(walls, 0.3, &[(4.3, -3.5), (-4.5, -3.4), (2.6, 3.5)]); // plants
    pillars(walls, 0.03, ROOM_LEGS).pillar(Point::new(1.5, 0.3), 0.2) // and a stool
}
