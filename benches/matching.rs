//! Time of one match, reference preparation included: a new pair at every call, so that branch prediction learns nothing.
#![allow(missing_docs, clippy::unwrap_used)]

#[path = "../tests/common/mod.rs"]
mod common;

use std::hint::black_box;

use anytime_scan_matcher::geometry::Pose2;
use anytime_scan_matcher::matching::correspondence::Correspondence;
use anytime_scan_matcher::matching::rejection::RejectionKnobs;
use anytime_scan_matcher::matching::solver::SolverKind;
use anytime_scan_matcher::matching::{Matcher, MatchingKnobs};
use anytime_scan_matcher::scan::Scan;
use common::{Laser, normal};
use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use rand::SeedableRng;
use rand_pcg::Pcg64;

/// A walk through the room, with a first guess of 15 mm and 0.6 degrees error for every step.
fn walk(laser: Laser) -> Vec<(Scan, Scan, Pose2)> {
    let mut rng = Pcg64::seed_from_u64(21);
    let pose = |i: u32| {
        let turn = f64::from(i) * 0.05;
        Pose2::new(1.5 * turn.cos() - 1.0, 1.5 * turn.sin(), turn + 1.5)
    };
    let scans: Vec<Scan> = (0..200).map(|i| laser.scan(pose(i), 0.01, 0.0, &mut rng)).collect();
    (0..199_u32)
        .map(|i| {
            let motion = pose(i).between(&pose(i + 1));
            let guess = Pose2::new(
                motion.x + 0.01 * normal(&mut rng),
                motion.y + 0.01 * normal(&mut rng),
                motion.theta + 0.01 * normal(&mut rng),
            );
            (scans[i as usize].clone(), scans[i as usize + 1].clone(), guess)
        })
        .collect()
}

fn bench_match(criterion: &mut Criterion, group: &str, knobs: &MatchingKnobs, with_covariance: bool) {
    let mut group = criterion.benchmark_group(group);
    for (degrees, beams) in [(180.0, 181), (180.0, 361), (270.0, 1081), (270.0, 10_000)] {
        let pairs = walk(Laser::with_field_of_view(degrees, beams));
        let mut matcher = Matcher::new(knobs, &RejectionKnobs::default());
        let mut next = 0;
        group.bench_function(BenchmarkId::from_parameter(beams), |bencher| {
            bencher.iter(|| {
                let (reference, sensed, guess) = &pairs[next];
                next = (next + 1) % pairs.len();
                matcher.set_reference(reference);
                let mut refinement = matcher.begin(sensed, *guess);
                while black_box(refinement.refine()).is_none() {}
                if with_covariance {
                    black_box(refinement.uncertainty());
                }
                refinement.pose()
            });
        });
    }
}

fn benches(criterion: &mut Criterion) {
    let variant = |correspondence, solver| MatchingKnobs { correspondence, solver, ..MatchingKnobs::default() };
    let classic = MatchingKnobs::default();
    bench_match(criterion, "match", &classic, false);
    bench_match(criterion, "match_with_covariance", &classic, true);
    bench_match(criterion, "match_kd_tree", &variant(Correspondence::KdTree, SolverKind::PointToLine), false);
    bench_match(
        criterion,
        "match_levenberg_marquardt",
        &variant(Correspondence::JumpTable, SolverKind::LevenbergMarquardt),
        false,
    );
    bench_match(criterion, "match_point_to_point", &variant(Correspondence::JumpTable, SolverKind::PointToPoint), false);
}

criterion_group! {
    name = all;
    config = Criterion::default().sample_size(50).measurement_time(std::time::Duration::from_secs(3)).warm_up_time(std::time::Duration::from_secs(1));
    targets = benches
}
criterion_main!(all);
