//! Maps of places that look alike: no loop may be closed that is none.

use std::process::Command;

use anytime_scan_matcher::geometry::Pose2;
use anytime_scan_matcher::io::bag::{BagWriter, Compression};
use anytime_scan_matcher::io::simulated_bag::record;
use anytime_scan_matcher::io::tum::TumWriter;
use anytime_scan_matcher::knobs::Seconds;
use anytime_scan_matcher::map::grid::{Cell, OccupancyGrid};
use anytime_scan_matcher::simulation::drive::Settings;
use anytime_scan_matcher::simulation::scene::Scene;
use serde_json::Value;

const RESOLUTION: f64 = 0.05;

/// Corridors 2.4 m wide around a block, 36 m x 14 m; every 4 m a niche, so that both long ones look alike in many places, and each like the
/// other one turned round.
#[allow(clippy::cast_sign_loss)] // sizes
fn alike() -> OccupancyGrid {
    let (width, height) = (40.0, 18.0);
    let is_free = |x: f64, y: f64| {
        let outside = (2.0..width - 2.0).contains(&x) && (2.0..height - 2.0).contains(&y);
        let block = (4.4..width - 4.4).contains(&x) && (4.4..height - 4.4).contains(&y);
        let in_niches = x.rem_euclid(4.0) > 1.25 && x.rem_euclid(4.0) < 2.75 && (4.0..width - 4.0).contains(&x);
        let niche = in_niches && ((1.4..2.0).contains(&y) || (height - 2.0..height - 1.4).contains(&y));
        (outside && !block) || niche
    };
    let columns = (width / RESOLUTION) as usize;
    let rows = (height / RESOLUTION) as usize;
    let centre = |i: usize| RESOLUTION * (i as f64 + 0.5);
    let cell = |i: usize| if is_free(centre(i % columns), centre(i / columns)) { Cell::Free } else { Cell::Occupied };
    OccupancyGrid::new(columns, RESOLUTION, Pose2::IDENTITY, (0..columns * rows).map(cell).collect()).unwrap()
}

fn json(arguments: &[&str]) -> Value {
    let output = Command::new(env!("CARGO_BIN_EXE_anytime")).args(arguments).output().unwrap();
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

/// `SEEDS=100 cargo test --release --test soak alike -- --nocapture` drives a hundred times.
#[test]
fn corridors_that_look_alike_are_not_taken_for_each_other() {
    let seeds = std::env::var("SEEDS").ok().and_then(|seeds| seeds.parse().ok()).unwrap_or(8);
    let (mut worst, mut farthest): (f64, f64) = (0.0, 0.0);
    for seed in 1..=seeds {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
        let mut settings = Settings::default();
        (settings.drive.seed, settings.drive.duration) = (seed, Seconds(90.0));
        (settings.lidar.beams, settings.lidar.rate, settings.lidar.noise, settings.lidar.range_max) = (181, 5.0, 0.02, 8.0);
        settings.vehicle.speed = 1.5;
        let mut poses = Vec::new();
        let writer = BagWriter::create_whole(path("x.bag"), Compression::None).unwrap();
        record(&settings, &Scene::in_map(alike(), seed).unwrap(), writer, TumWriter::new(&mut poses)).unwrap();
        std::fs::write(path("truth.tum"), poses).unwrap();
        let summary = json(&["map", &path("x.bag"), "--out", &path("x"), "--tum", &path("final.tum"), "--json"]);
        let found = json(&["evaluate", &path("final.tum"), "--truth", &path("truth.tum"), "--json"]);
        let [rmse, max] = ["rmse", "max"].map(|name| found["ate"]["trans_m"][name].as_f64().unwrap());
        println!(
            "seed {seed}: {} m, {} loop edges, ATE {rmse:.3} m, at most {max:.3} m",
            summary["distance_m"], summary["loops"]
        );
        (worst, farthest) = (worst.max(rmse), farthest.max(max));
    }
    // A wrong loop bends the whole map; a keyframe by itself may be placed wrong where niche is like niche.
    assert!(worst < 0.114, "{worst} m: a loop was closed that is none");
    assert!(farthest < 0.634, "{farthest} m");
}
