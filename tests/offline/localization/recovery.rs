//! How a filter recovers if scans fit worse: it searches elsewhere, step by step, and keeps its estimate until it finds a better one.

use anytime_scan_matcher::config::Config;
use anytime_scan_matcher::geometry::Pose2;
use anytime_scan_matcher::map::grid::{Cell, OccupancyGrid};

use super::{Drive, Outcome, at_truth, map, run};
use crate::common::corridor;

/// Rays per second of a search, and of a step that begins when almost all of them have been cast.
const SEARCH: f64 = 10e6 + 40.0 * 4.0 * 256.0 * 60.0;

fn config(particles: u32) -> Config {
    let mut config = Config::default();
    config.localization.particles = particles;
    config
}

/// Checks that no update took more work than a cloud of `particles` plus the search within a scan's period.
fn assert_bounded(outcome: &Outcome, particles: u32, rate: f64) {
    let most = u64::from(particles * 60) + (SEARCH / rate) as u64;
    assert!(outcome.rays.iter().all(|&rays| rays <= most), "{:?} of {most}", outcome.rays.iter().max());
}

#[test]
fn a_pose_that_explains_the_scans_is_never_given_up() {
    // The drive of `anytime simulate --world levine.yaml --duration 15s`: from scan 437 on rays graze walls.
    let Some(map) = map("levine") else { return };
    let outcome = run(&map, &[Drive { seed: 1, seconds: 15.0, rate: 40.0 }], &config(2000), |localizer, pose| {
        localizer.start_at(&pose, None);
    });
    assert!(outcome.answers.iter().all(|(error, belief)| belief.is_localized() && error.distance() < 0.3));
    assert!(outcome.rays.iter().all(|&rays| rays <= 2000 * 60), "there must be no search: {:?}", outcome.rays.iter().max());
}

#[test]
fn a_kidnapped_robot_is_found_again() {
    let rate = 10.0;
    let drives = [2, 5].map(|seed| Drive { seed, seconds: 20.0, rate });
    let outcome = run(&corridor(), &drives, &Config::default(), at_truth);
    let (before, after) = (&outcome.answers[190], &outcome.answers[205]);
    assert!(before.0.distance() < 0.2 && after.0.distance() > 1.0, "{before:?} {after:?}");
    assert!(outcome.converged(rate), "{:?}", outcome.answers.last());
    assert_bounded(&outcome, 4000, rate);
    let claims = outcome.answers[205..].iter().filter(|answer| answer.1.is_localized() && !super::is_right(answer)).count();
    assert!(claims < 50, "{claims} answers reported the old pose");
}

#[test]
fn a_global_search_is_spread_over_updates() {
    let mut settings = config(1000);
    settings.localization.global_particles = 50_000;
    for rate in [10.0, 40.0] {
        let outcome = run(&corridor(), &[Drive { seed: 3, seconds: 100.0 / rate, rate }], &settings, |_, _| {});
        assert_bounded(&outcome, 1000, rate);
        let total: u64 = outcome.rays.iter().sum();
        assert!(total > 60 * 50_000 && !outcome.answers[0].1.is_localized(), "{total}");
    }
}

/// The map with furniture along every third stretch of the walls.
fn furnished(map: &OccupancyGrid) -> OccupancyGrid {
    let (width, height) = (map.width(), map.height());
    let near_wall = |i: usize| {
        let (x, y) = (i % width, i / width);
        let around = |d: usize| {
            [(x.saturating_sub(d), y), ((x + d).min(width - 1), y), (x, y.saturating_sub(d)), (x, (y + d).min(height - 1))]
        };
        (x / 20 + y / 20) % 3 == 0 && around(6).iter().any(|&(x, y)| map.cells()[y * width + x] == Cell::Occupied)
    };
    let cells = (0..width * height).map(|i| if near_wall(i) { Cell::Occupied } else { map.cells()[i] });
    OccupancyGrid::new(width, map.resolution(), Pose2::new(-4.0, 2.0, 0.0), cells.collect()).unwrap()
}

#[test]
fn unmapped_furniture_does_not_move_the_estimate() {
    // The car drives in the furnished world; the filter has the bare map.
    let drive = Drive { seed: 3, seconds: 15.0, rate: 20.0 };
    let outcome = super::run_in(&furnished(&corridor()), &corridor(), &[drive], &config(2000), at_truth);
    assert!(outcome.answers.iter().skip(20).all(|(error, _)| error.distance() < 0.4), "{:?}", outcome.rmse(20));
}

#[test]
fn a_drive_elsewhere_is_not_localized() {
    let names = ["levine", "columbia", "skirk", "berlin", "porto", "vegas"];
    let Some(maps) = names.iter().map(|name| map(name)).collect::<Option<Vec<_>>>() else { return };
    for (i, own) in maps.iter().enumerate() {
        let other = (i + 1) % maps.len();
        let drive = Drive { seed: 2, seconds: 8.0, rate: 10.0 };
        let mut settings = config(500);
        settings.localization.global_particles = 20_000;
        let outcome = super::run_in(own, &maps[other], &[drive], &settings, at_truth);
        let localized = outcome.answers.iter().filter(|(_, belief)| belief.is_localized()).count();
        assert!(localized * 20 <= outcome.answers.len(), "{} on {}: {localized}", names[i], names[other]);
    }
}
