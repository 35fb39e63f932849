//! Code shared by several test programs.
#![allow(dead_code, unreachable_pub, clippy::unwrap_used, clippy::panic)]

#[cfg(feature = "ros")]
pub mod drive;
#[cfg(feature = "ros")]
pub mod graph;
#[cfg(feature = "ros")]
pub mod player;
#[cfg(feature = "cli")]
pub mod program;
pub mod skipped;
#[cfg(feature = "ros")]
pub mod wire;

use std::path::PathBuf;
use std::sync::Arc;

use anytime_scan_matcher::geometry::{Point, Pose2};
use anytime_scan_matcher::map::grid::{Cell, OccupancyGrid};
use anytime_scan_matcher::messages::sensor_msgs::LaserScan;
use anytime_scan_matcher::scan::{BeamGeometry, Scan};
use anytime_scan_matcher::time::Stamp;
use rand::RngExt;
use rand_pcg::Pcg64;

/// A file of the real data beside the checkout. Reports the test as skipped if it is missing.
pub fn shared(path: &str) -> Option<PathBuf> {
    let place = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../shared").join(path);
    if place.exists() {
        return Some(place);
    }
    skipped::skip(&format!("../shared/{path} is not there"));
    None
}

/// A rectangular corridor with some niches, so that its four sides differ.
pub fn corridor() -> OccupancyGrid {
    let wall = |x: usize, y: usize| {
        let outside = x == 0 || y == 0 || x == 399 || y == 299;
        let block = (60..340).contains(&x) && (60..240).contains(&y);
        let niche = (100..130).contains(&x) && (60..80).contains(&y) || (320..340).contains(&x) && (150..200).contains(&y);
        let crate_ = (200..212).contains(&x) && (285..299).contains(&y) || x < 12 && (90..100).contains(&y);
        outside || block && !niche || crate_
    };
    let cells = (0..400 * 300).map(|i| if wall(i % 400, i / 400) { Cell::Occupied } else { Cell::Free }).collect();
    OccupancyGrid::new(400, 0.05, Pose2::new(-4.0, 2.0, 0.0), cells).unwrap()
}

/// Corners of a room with slanted walls and a pillar, m.
const ROOM: [(f64, f64); 8] =
    [(-4.0, -3.0), (5.0, -3.5), (6.0, 1.0), (3.5, 1.2), (3.0, 4.0), (-1.0, 4.5), (-1.5, 2.5), (-5.0, 2.0)];
const PILLAR: [(f64, f64); 4] = [(1.5, -1.5), (2.0, -1.5), (2.0, -1.0), (1.5, -1.0)];

/// Distance to the nearest wall of the room.
pub fn room_range(origin: Point, direction: Point) -> f64 {
    let walls = |corners: &[(f64, f64)]| {
        let next = corners.iter().cycle().skip(1);
        corners.iter().zip(next).map(|(a, b)| (Point::new(a.0, a.1), Point::new(b.0, b.1))).collect::<Vec<_>>()
    };
    let hit = |(a, b): (Point, Point)| {
        let along = b - a;
        let determinant = direction.perp(&along);
        let range = (a - origin).perp(&along) / determinant;
        let fraction = (a - origin).perp(&direction) / determinant;
        (range > 0.0 && (0.0..=1.0).contains(&fraction)).then_some(range)
    };
    walls(&ROOM).into_iter().chain(walls(&PILLAR)).filter_map(hit).fold(f64::INFINITY, f64::min)
}

/// A laser: first angle and angle between beams, rad, and number of beams.
#[derive(Clone, Copy, Debug)]
pub struct Laser {
    pub angle_min: f64,
    pub increment: f64,
    pub beams: usize,
}

impl Laser {
    /// A laser with a field of view of `degrees`, facing forward.
    pub fn with_field_of_view(degrees: f64, beams: usize) -> Self {
        let width = degrees.to_radians();
        Self { angle_min: -0.5 * width, increment: width / (beams as f64 - 1.0), beams }
    }

    pub fn geometry(&self) -> Arc<BeamGeometry> {
        Arc::new(BeamGeometry::new(self.angle_min, self.increment, self.beams))
    }

    /// A scan of the room from `pose`, without noise, as a message in the frame `laser`.
    #[allow(clippy::cast_possible_truncation)] // the message carries 32 bits
    pub fn message(&self, stamp: Stamp, pose: Pose2) -> LaserScan {
        let range = |&direction: &Point| room_range(pose.translation(), pose.transform().rotate(direction)) as f32;
        let mut message = LaserScan {
            angle_min: self.angle_min as f32,
            angle_max: (self.angle_min + (self.beams - 1) as f64 * self.increment) as f32,
            angle_increment: self.increment as f32,
            range_min: 0.05,
            range_max: 30.0,
            ranges: self.geometry().directions().iter().map(range).collect(),
            ..LaserScan::default()
        };
        message.header.frame_id = "laser".into();
        message.header.stamp = stamp.into();
        message
    }

    /// A scan of the room from `pose`, with Gaussian range noise (m) and a fraction of the rays lost.
    pub fn scan(&self, pose: Pose2, noise: f64, lost: f64, rng: &mut Pcg64) -> Scan {
        let geometry = self.geometry();
        let ranges: Vec<f64> = geometry
            .directions()
            .iter()
            .map(|&direction| {
                let range = room_range(pose.translation(), pose.transform().rotate(direction)) + noise * normal(rng);
                if rng.random::<f64>() < lost { f64::INFINITY } else { range }
            })
            .collect();
        Scan::new(Stamp::default(), geometry, (0.01, 30.0), ranges).unwrap()
    }
}

pub fn normal(rng: &mut Pcg64) -> f64 {
    rand_distr::Distribution::sample(&rand_distr::StandardNormal, rng)
}

pub fn uniform(rng: &mut Pcg64, low: f64, high: f64) -> f64 {
    low + (high - low) * rng.random::<f64>()
}
