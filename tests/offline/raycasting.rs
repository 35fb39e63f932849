//! Compares every ray caster with the exact walk through the grid.

use crate::common::{shared, uniform};
use anytime_scan_matcher::geometry::{Point, Pose2};
use anytime_scan_matcher::io::map_file;
use anytime_scan_matcher::map::grid::{Cell, OccupancyGrid};
use anytime_scan_matcher::raycasting::{Fan, RayCaster, RayCasting, Viewpoint};
use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

const MAX_RANGE: f64 = 600.0;
const BEAMS: usize = 60;

/// The length of the beam by the exact walk, in cells.
fn exact(grid: &OccupancyGrid, cell_pose: Pose2) -> f64 {
    let pose = grid.pose_in_map(&cell_pose);
    let direction = pose.transform().rotate(Point::x());
    let range = grid.range(pose.translation(), direction, MAX_RANGE * grid.resolution());
    range.map_or(f64::INFINITY, |range| range / grid.resolution())
}

/// Tolerance of a method's beams: to the side, cells, and in direction, rad.
fn tolerance(method: RayCasting) -> (f64, f64) {
    match method {
        RayCasting::Bresenham | RayCasting::RayMarching => (2e-3, 1e-5),
        RayCasting::Cddt => (0.51, 0.26_f64.to_radians()),
        // Half a cell's diagonal, and half a strip.
        RayCasting::Table => (0.71 + 0.26, 0.51_f64.to_radians()),
    }
}

/// Whether `length` is between the lengths of the exact beams around the requested one. These are only samples of the neighbouring beams: in
/// a cluttered map an inexact method can still find a gap between them.
fn is_right(grid: &OccupancyGrid, pose: Pose2, length: f64, method: RayCasting) -> bool {
    let (aside, angle) = tolerance(method);
    let forth = if method == RayCasting::Table { 0.71 } else { 0.02 };
    let steps = if aside < 0.1 { 1 } else { 4 };
    let mut around = (f64::INFINITY, 0.0_f64);
    for i in -steps..=steps {
        for j in -steps..=steps {
            let (i, j) = (f64::from(i) / f64::from(steps), f64::from(j) / f64::from(steps));
            let beam = exact(grid, pose * Pose2::new(0.0, i * aside, j * angle));
            around = (around.0.min(beam), around.1.max(beam));
        }
    }
    // A wall that is just out of range for one is within range for the other.
    let reached = |length: f64| length.min(MAX_RANGE - 1.0);
    reached(length) >= reached(around.0) - forth && reached(length) <= reached(around.1) + forth
}

fn random_pose(grid: &OccupancyGrid, rng: &mut Pcg64) -> Pose2 {
    loop {
        let (x, y) = (uniform(rng, 0.0, grid.width() as f64), uniform(rng, 0.0, grid.height() as f64));
        if grid.cell(x as i64, y as i64) == Some(Cell::Free) {
            return Pose2::new(x, y, uniform(rng, -4.0, 4.0));
        }
    }
}

/// The fraction of correct lengths, of beams in all directions from random free cells.
fn share_right(grid: &OccupancyGrid, method: RayCasting, caster: &dyn RayCaster, poses: usize, rng: &mut Pcg64) -> f64 {
    let angles = |i: usize| i as f64 * std::f64::consts::TAU / BEAMS as f64;
    let fan = Fan::new((0..BEAMS).map(angles));
    let mut lengths = vec![0.0; BEAMS];
    let mut right = 0;
    for _ in 0..poses {
        let pose = random_pose(grid, rng);
        caster.cast(&[Viewpoint::new(&pose)], &fan, &mut lengths);
        right += lengths
            .iter()
            .enumerate()
            .filter(|&(i, &length)| is_right(grid, pose * Pose2::new(0.0, 0.0, angles(i)), length.into(), method))
            .count();
    }
    right as f64 / (poses * BEAMS) as f64
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    #[test]
    fn every_method_agrees_with_the_exact_walk(width in 1_usize..60, height in 1_usize..60, share in 0.0..0.2, yaw in -3.0..3.0, seed in 0_u64..10_000) {
        let mut rng = Pcg64::seed_from_u64(seed);
        let mut cell = |_| match rng.random::<f64>() {
            x if x < share => Cell::Occupied,
            x if x < share + 0.05 => Cell::Unknown,
            _ => Cell::Free,
        };
        let mut cells: Vec<Cell> = (0..width * height).map(&mut cell).collect();
        cells[0] = Cell::Free;
        let grid = OccupancyGrid::new(width, 0.05, Pose2::new(-3.0, 7.0, yaw), cells).unwrap();
        for &method in RayCasting::ALL {
            let caster = method.caster(&grid, MAX_RANGE);
            let share = share_right(&grid, method, &*caster, 4, &mut rng);
            // In clutter of single cells a beam shifted by half a cell may end anywhere; the exact methods must be correct.
            let least = if tolerance(method).0 < 0.1 { 0.99 } else { 0.7 };
            prop_assert!(share >= least, "{}: {share} of the lengths are correct", method.name());
        }
    }
}

#[test]
fn every_method_agrees_with_the_exact_walk_on_real_maps() {
    let mut rng = Pcg64::seed_from_u64(5);
    for name in ["levine", "columbia"] {
        let Some(path) = shared(&format!("data/maps/{name}.yaml")) else { return };
        let grid = map_file::read(&path).unwrap();
        for &method in RayCasting::ALL {
            let share = share_right(&grid, method, &*method.caster(&grid, MAX_RANGE), 10, &mut rng);
            let least = if method == RayCasting::Table { 0.98 } else { 0.99 };
            assert!(share > least, "{name}, {}: {share} of the lengths are correct", method.name());
        }
    }
}

#[test]
fn viewpoints_in_walls_and_outside_the_map_are_handled() {
    let mut cells = vec![Cell::Free; 100];
    cells[55] = Cell::Occupied;
    let grid = OccupancyGrid::new(10, 0.05, Pose2::IDENTITY, cells).unwrap();
    let fan = Fan::new([0.0, 1.0]);
    for &method in RayCasting::ALL {
        let caster = method.caster(&grid, MAX_RANGE);
        let views = [(5.5, 5.5), (-0.5, 5.0), (5.0, 10.5), (f64::NAN, 1.0), (1e9, -1e9), (2.5, 5.5), (7.5, 5.5)];
        let views = views.map(|(x, y)| Viewpoint::new(&Pose2 { x, y, theta: 0.0 }));
        let mut lengths = vec![0.0; 14];
        caster.cast(&views, &fan, &mut lengths);
        for beam in lengths.chunks_exact(views.len()) {
            assert_eq!(beam[0], 0.0, "{}: in a wall", method.name());
            assert!(beam[1..5].iter().all(|length| length.is_infinite()), "{}: outside", method.name());
        }
        assert!((lengths[5] - 2.5).abs() < 0.01 && lengths[6].is_infinite(), "{}", method.name());
        assert!(caster.memory() > 0);
    }
}
