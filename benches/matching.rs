//! Time of one match, reference preparation included: a new pair at every call, so that branch prediction learns nothing.
#![allow(missing_docs, clippy::unwrap_used)]

mod walk;

use std::hint::black_box;

use anytime_scan_matcher::matching::correspondence::Correspondence;
use anytime_scan_matcher::matching::rejection::RejectionKnobs;
use anytime_scan_matcher::matching::solver::SolverKind;
use anytime_scan_matcher::matching::{Matcher, MatchingKnobs};
use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use walk::{LASERS, Laser, match_pair, walk};

fn bench_match(criterion: &mut Criterion, group: &str, knobs: &MatchingKnobs, with_covariance: bool) {
    let mut group = criterion.benchmark_group(group);
    for (degrees, beams) in LASERS {
        let pairs = walk(Laser::with_field_of_view(degrees, beams), 199);
        let mut matcher = Matcher::new(knobs, &RejectionKnobs::default());
        let mut next = pairs.iter().cycle();
        group.bench_function(BenchmarkId::from_parameter(beams), |bencher| {
            bencher.iter(|| next.next().map(|pair| black_box(match_pair(&mut matcher, pair, with_covariance))));
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
