//! Compares the closed-form covariance with its definition.

use crate::common::Laser;
use anytime_scan_matcher::geometry::{Pose2, PoseCovariance};
use anytime_scan_matcher::matching::classic::correspondence::CorrespondenceKind;
use anytime_scan_matcher::matching::classic::rejection::RejectionKnobs;
use anytime_scan_matcher::matching::solver::SolverKind;
use anytime_scan_matcher::matching::{Matcher, MatchingKnobs};
use anytime_scan_matcher::scan::Scan;
use nalgebra::Vector3;
use rand::SeedableRng;
use rand_pcg::Pcg64;

const NOISE: f64 = 0.01;

fn matcher(solver: SolverKind) -> Matcher {
    let knobs = MatchingKnobs {
        correspondence: CorrespondenceKind::JumpTable,
        solver,
        epsilon_translation: 1e-9,
        epsilon_rotation: 1e-9,
        max_iterations: 100,
        ..MatchingKnobs::default()
    };
    let keep_all = RejectionKnobs {
        remove_duplicates: false,
        trim_percentile: 1.0,
        adaptive_multiplier: 1000.0,
        ..RejectionKnobs::default()
    };
    Matcher::new(&knobs, &keep_all)
}

fn solve(matcher: &mut Matcher, reference: &Scan, sensed: &Scan, guess: Pose2) -> (Pose2, PoseCovariance) {
    matcher.set_reference(reference);
    let mut refinement = matcher.begin(sensed, guess);
    while refinement.refine().is_none() {}
    (refinement.pose(), refinement.uncertainty().unwrap().covariance.unwrap())
}

/// A scan with one range changed.
fn changed(scan: &Scan, ray: usize, by: f64) -> Scan {
    let ranges = scan.ranges().iter().enumerate().map(|(i, r)| if i == ray { r + by } else { *r });
    Scan::new(scan.stamp(), scan.beams().clone().into(), (0.01, 30.0), ranges).unwrap()
}

/// The covariance is `noise^2 * sum of (d pose / d range)^2`; here the derivatives are finite differences of whole matches.
#[test]
fn it_agrees_with_finite_differences_of_the_match() {
    let mut rng = Pcg64::seed_from_u64(51);
    let laser = Laser::with_field_of_view(360.0 - 4.0, 90);
    for solver in [SolverKind::PointToLine, SolverKind::PointToPoint] {
        let pose = Pose2::new(0.02, -0.03, 0.01);
        // Almost no noise: the residuals must not exceed the nominal noise or change the pairs.
        let reference = laser.scan(Pose2::IDENTITY, 1e-4, 0.0, &mut rng);
        let sensed = laser.scan(pose, 1e-4, 0.0, &mut rng);
        let mut matcher = matcher(solver);
        let (at, covariance) = solve(&mut matcher, &reference, &sensed, pose);
        let step = 1e-7;
        let mut expected = PoseCovariance::zeros();
        let mut add = |up: Pose2, down: Pose2| {
            let d = Vector3::new(up.x - down.x, up.y - down.y, up.theta - down.theta) / (2.0 * step);
            expected += d * d.transpose() * NOISE * NOISE;
        };
        for ray in 0..laser.beams {
            let mut of = |by: f64| solve(&mut matcher, &changed(&reference, ray, by), &sensed, at).0;
            add(of(step), of(-step));
            let mut of = |by: f64| solve(&mut matcher, &reference, &changed(&sensed, ray, by), at).0;
            add(of(step), of(-step));
        }
        // Point-to-point residuals are as large as the gaps between points and count as noise.
        let scale = covariance.trace() / expected.trace();
        assert!(scale > 0.999, "{}: {scale}", solver.name());
        if solver == SolverKind::PointToLine {
            assert!((scale - 1.0).abs() < 1e-3, "{scale}");
        }
        let difference = (covariance / scale - expected).norm() / expected.norm();
        assert!(difference < 1e-3, "{}: {difference}\n{covariance}\n{expected}", solver.name());
    }
}

#[test]
fn an_unconstrained_direction_has_no_covariance() {
    let laser = Laser::with_field_of_view(120.0, 121);
    let wall = |_: f64| {
        let ranges = laser.geometry().directions().iter().map(|d| 2.0 / d.x).collect::<Vec<_>>();
        Scan::new(anytime_scan_matcher::time::Stamp::default(), laser.geometry(), (0.01, 30.0), ranges).unwrap()
    };
    let mut matcher = matcher(SolverKind::PointToLine);
    let (reference, sensed) = (wall(0.0), wall(0.0));
    matcher.set_reference(&reference);
    let mut refinement = matcher.begin(&sensed, Pose2::new(0.1, 0.2, 0.0));
    while refinement.refine().is_none() {}
    let pose = refinement.pose();
    assert!(pose.x.abs() < 1e-6 && (pose.y - 0.2).abs() < 0.01, "along the wall the pose must stay at the guess: {pose:?}");
    let uncertainty = refinement.uncertainty().unwrap();
    assert!(uncertainty.condition_number > 1e9, "{uncertainty:?}");
    assert!(uncertainty.covariance.is_none_or(|c| c.m22 > 1.0), "{uncertainty:?}");
}
