//! Rays per second of every ray caster on a real map (or a synthetic one, if that is missing), from a cloud of poses like that of a
//! particle filter; start-up time and memory are printed first. Measured in processor time, which excludes other programs, except for the
//! start-up.
#![allow(missing_docs, clippy::unwrap_used, clippy::print_stderr, clippy::cast_possible_truncation, clippy::cast_sign_loss)]

#[path = "../tests/common/mod.rs"]
mod common;

use std::hint::black_box;
use std::time::{Duration, Instant};

use anytime_scan_matcher::anytime::clock::{Clock, ProcessorClock};
use anytime_scan_matcher::geometry::Pose2;
use anytime_scan_matcher::io::map_file;
use anytime_scan_matcher::map::grid::{Cell, OccupancyGrid};
use anytime_scan_matcher::map::indoors::indoor_cells;
use anytime_scan_matcher::raycasting::{Fan, RayCasting, Viewpoint};
use common::{normal, shared, uniform};
use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

/// Viewpoints per call, as in the particle filter.
const CHUNK: usize = 256;
/// Maximum range of the beams, m.
const MAX_RANGE: f64 = 30.0;

fn map() -> OccupancyGrid {
    shared("data/maps/levine.yaml").map_or_else(
        || {
            let wall = |i: usize| {
                if (i % 1000).is_multiple_of(97) || (i / 1000).is_multiple_of(89) { Cell::Occupied } else { Cell::Free }
            };
            OccupancyGrid::new(1000, 0.05, Pose2::IDENTITY, (0..1_000_000).map(wall).collect()).unwrap()
        },
        |path| map_file::read(&path).unwrap(),
    )
}

/// A random pose indoors, in cells.
fn indoor_pose(grid: &OccupancyGrid, indoors: &[usize], rng: &mut Pcg64) -> Pose2 {
    let cell = indoors[rng.random_range(0..indoors.len())];
    let (x, y) = ((cell % grid.width()) as f64 + 0.5, (cell / grid.width()) as f64 + 0.5);
    Pose2::new(x, y, uniform(rng, -3.0, 3.0))
}

/// A cloud of poses with standard deviations of 5 cm and 3 degrees; positions are in cells.
fn cloud(grid: &OccupancyGrid, indoors: &[usize], poses: usize, rng: &mut Pcg64) -> Vec<Viewpoint> {
    let middle = indoor_pose(grid, indoors, rng);
    (0..poses).map(|_| Viewpoint::new(&(middle * Pose2::new(normal(rng), normal(rng), 0.05 * normal(rng))))).collect()
}

fn fan(beams: usize) -> Fan {
    Fan::new((0..beams).map(|i| (i as f64 / (beams - 1) as f64 - 0.5) * 270.0_f64.to_radians()))
}

/// The processor time of repeating `work` this many times.
fn processor_time(times: u64, mut work: impl FnMut()) -> Duration {
    let start = ProcessorClock.now();
    (0..times).for_each(|_| work());
    ProcessorClock.now().saturating_sub(start)
}

fn benches(criterion: &mut Criterion) {
    let grid = map();
    let indoors = indoor_cells(&grid);
    for &method in RayCasting::ALL {
        let start = Instant::now();
        let caster = method.caster(&grid, MAX_RANGE / grid.resolution());
        let megabytes = caster.memory() as f64 * 1e-6;
        eprintln!("{}: start-up {:.0} ms, {megabytes:.1} MB", method.name(), start.elapsed().as_secs_f64() * 1e3);
        let mut rng = Pcg64::seed_from_u64(3);
        for (group, poses, beams) in [("cloud_4000x60", 4000, 60), ("cloud_20x100", 20, 100)] {
            let clouds: Vec<_> = (0..20).map(|_| cloud(&grid, &indoors, poses, &mut rng)).collect();
            let (fan, mut lengths, mut next) = (fan(beams), vec![0.0; poses * beams], 0);
            let mut group = criterion.benchmark_group(group);
            group.throughput(Throughput::Elements((poses * beams) as u64));
            group.bench_function(BenchmarkId::from_parameter(method.name()), |bencher| {
                bencher.iter_custom(|times| {
                    processor_time(times, || {
                        next = (next + 1) % clouds.len();
                        for views in black_box(&clouds[next]).chunks(CHUNK) {
                            caster.cast(views, &fan, &mut lengths);
                        }
                    })
                });
            });
        }
        let everywhere: Vec<_> = (0..4000).map(|_| Viewpoint::new(&indoor_pose(&grid, &indoors, &mut rng))).collect();
        let (fan, mut lengths) = (fan(60), vec![0.0; 4000 * 60]);
        let mut group = criterion.benchmark_group("everywhere_4000x60");
        group.throughput(Throughput::Elements(4000 * 60));
        group.bench_function(BenchmarkId::from_parameter(method.name()), |bencher| {
            bencher.iter_custom(|times| processor_time(times, || caster.cast(black_box(&everywhere), &fan, &mut lengths)));
        });
    }
}

criterion_group! {
    name = all;
    config = Criterion::default().sample_size(20).measurement_time(Duration::from_secs(1)).warm_up_time(Duration::from_millis(300));
    targets = benches
}
criterion_main!(all);
