//! Compares every correspondence search with brute force.

use std::f64::consts::{PI, TAU};

use crate::common::{Laser, uniform};
use anytime_scan_matcher::geometry::{Point, Pose2};
use anytime_scan_matcher::matching::classic::correspondence::{CorrespondenceKind, Nearest};
use anytime_scan_matcher::matching::classic::reference::Reference;
use anytime_scan_matcher::scan::Scan;
use anytime_scan_matcher::time::Stamp;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

fn lasers() -> Vec<Laser> {
    let mut lasers = vec![
        Laser::with_field_of_view(180.0, 181),
        Laser::with_field_of_view(270.0, 361),
        Laser::with_field_of_view(90.0, 60),
        Laser::with_field_of_view(350.0, 200),
        Laser::with_field_of_view(359.0, 360),
        Laser::with_field_of_view(40.0, 10),
        // A full turn, with the last beam on the first or one increment before it, starting anywhere.
        Laser::with_field_of_view(360.0, 241),
        Laser { angle_min: 1.3, increment: TAU / 300.0, beams: 300 },
        Laser { angle_min: 0.0, increment: TAU / 150.0, beams: 150 },
    ];
    let clockwise: Vec<_> =
        lasers.iter().map(|l| Laser { angle_min: -l.angle_min, increment: -l.increment, beams: l.beams }).collect();
    lasers.extend(clockwise);
    lasers
}

/// Ranges without any structure: the hardest case for jumps.
fn random_scan(laser: Laser, rng: &mut Pcg64) -> Scan {
    let ranges: Vec<f64> =
        (0..laser.beams).map(|_| if rng.random::<f64>() < 0.2 { f64::NAN } else { uniform(rng, 0.3, 6.0) }).collect();
    Scan::new(Stamp::default(), laser.geometry(), (0.01, 30.0), ranges).unwrap()
}

fn moved_points(scan: &Scan, by: Pose2) -> Vec<Point> {
    scan.rays().map(|(_, direction, range)| by.transform().apply(direction * range)).collect()
}

/// Compares all searches over two calls, of which the second starts from the results of the first; returns the number of comparisons.
fn check(reference_scan: &Scan, sensed: &Scan, motions: [Pose2; 2], max_distance: f64) -> usize {
    let mut reference = Reference::default();
    reference.set(reference_scan);
    let mut compared = 0;
    for &kind in CorrespondenceKind::ALL {
        let Some(mut search) = kind.search() else { continue };
        search.prepare(&reference);
        let mut oracle = CorrespondenceKind::Naive.search().unwrap();
        oracle.prepare(&reference);
        let mut found = vec![Nearest::NONE; sensed.valid_len()];
        for motion in motions {
            let points = moved_points(sensed, motion);
            search.find(&reference, &points, max_distance, &mut found);
            let mut expected = vec![Nearest::NONE; points.len()];
            oracle.find(&reference, &points, max_distance, &mut expected);
            for (i, (found, expected)) in found.iter().zip(&expected).enumerate() {
                assert_eq!(
                    found.is_match(),
                    expected.is_match(),
                    "{} {i} {:?}: {found:?}, nearest is {expected:?}",
                    kind.name(),
                    points[i]
                );
                if expected.is_match() {
                    let difference = found.squared_distance.sqrt() - expected.squared_distance.sqrt();
                    assert!(difference.abs() < 1e-12, "{} {i} {:?}: {found:?}, nearest is {expected:?}", kind.name(), points[i]);
                }
                compared += 1;
            }
        }
    }
    compared
}

fn motion(rng: &mut Pcg64, distance: f64, angle: f64) -> Pose2 {
    Pose2::new(uniform(rng, -distance, distance), uniform(rng, -distance, distance), uniform(rng, -angle, angle))
}

#[test]
fn no_search_differs_from_brute_force_in_rooms() {
    let mut rng = Pcg64::seed_from_u64(11);
    let mut compared = 0;
    for round in 0..12 {
        for laser in lasers() {
            let pose = Pose2::new(uniform(&mut rng, -1.0, 1.0), uniform(&mut rng, -1.0, 1.0), uniform(&mut rng, -PI, PI));
            let (noise, lost) = ([0.0, 0.02][round % 2], [0.0, 0.3][round / 2 % 2]);
            let reference = laser.scan(pose, noise, lost, &mut rng);
            let sensed = laser.scan(pose * motion(&mut rng, 0.3, 0.3), noise, lost, &mut rng);
            compared += check(&reference, &sensed, [motion(&mut rng, 0.3, 0.3), motion(&mut rng, 0.3, 0.3)], 0.5);
        }
    }
    assert!(compared > 100_000, "{compared}");
}

#[test]
fn no_search_differs_from_brute_force_on_random_ranges() {
    let mut rng = Pcg64::seed_from_u64(12);
    for _ in 0..20 {
        for laser in lasers() {
            let (reference, sensed) = (random_scan(laser, &mut rng), random_scan(laser, &mut rng));
            let max_distance = uniform(&mut rng, 0.05, 3.0);
            check(&reference, &sensed, [motion(&mut rng, 1.0, PI), motion(&mut rng, 1.0, PI)], max_distance);
        }
    }
}

#[test]
fn scans_of_different_lasers_can_be_matched() {
    let mut rng = Pcg64::seed_from_u64(13);
    let all = lasers();
    for (i, &laser) in all.iter().enumerate() {
        let other = all[(i + 4) % all.len()];
        let reference = laser.scan(Pose2::IDENTITY, 0.01, 0.1, &mut rng);
        let sensed = other.scan(Pose2::new(0.1, 0.1, 0.4), 0.01, 0.1, &mut rng);
        check(&reference, &sensed, [Pose2::new(0.1, 0.1, 0.3), Pose2::new(0.1, 0.1, 0.4)], 0.4);
    }
}
