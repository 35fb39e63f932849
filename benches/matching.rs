//! Time of one match, including the preparation of the reference, with a new pair at every call so that branch prediction cannot learn it.
#![allow(missing_docs, clippy::unwrap_used)]

mod walk;

use std::hint::black_box;

use anytime_scan_matcher::geometry::{Point, Pose2};
use anytime_scan_matcher::matching::classic::correspondence::CorrespondenceKind;
use anytime_scan_matcher::matching::classic::rejection::RejectionKnobs;
use anytime_scan_matcher::matching::solver::{QuadraticForm, SolverKind};
use anytime_scan_matcher::matching::{FirstGuess, Matcher, MatchingKnobs, SearchWindow};
use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use walk::{LASERS, Laser, Pair, match_pair, walk};

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

/// The stages of a match, by the number of beams: surfaces of the reference, one iteration with all rays, the whole match.
fn bench_by_beams(criterion: &mut Criterion) {
    let window = SearchWindow { min_agreement: 0.0, ..SearchWindow::default() };
    let once = MatchingKnobs { coarse_rays: 0, max_iterations: 1, ..MatchingKnobs::default() };
    for beams in [100, 200, 500, 1000, 2000, 5000, 10_000] {
        let pairs = walk(Laser::with_field_of_view(270.0, beams), 99);
        let mut next = pairs.iter().cycle();
        let mut bench = |group: &str, knobs: &MatchingKnobs, work: &dyn Fn(&mut Matcher, &Pair)| {
            let mut matcher = Matcher::new(knobs, &RejectionKnobs::default());
            matcher.set_reference(&pairs[0].reference);
            let mut group = criterion.benchmark_group(group);
            group.bench_function(BenchmarkId::from_parameter(beams), |bencher| {
                bencher.iter(|| next.next().map(|pair| work(&mut matcher, black_box(pair))));
            });
        };
        bench("beams_surfaces", &once, &|matcher, pair| matcher.set_reference(&pair.reference));
        bench("beams_iteration", &once, &|matcher, pair| {
            let guess = FirstGuess { pose: pair.guess, prior: None, window };
            black_box(matcher.begin(&pair.sensed, guess).refine());
        });
        bench("beams_match", &MatchingKnobs::default(), &|matcher, pair| {
            black_box(match_pair(matcher, pair, true));
        });
    }
}

/// The solver step, whose cost does not depend on the number of pairs.
fn bench_solve(criterion: &mut Criterion) {
    let mut form = QuadraticForm::default();
    for i in 0..20 {
        let (sin, cos) = (0.7 * f64::from(i)).sin_cos();
        form.add_line(Point::new(3.0 * sin, 2.0 * cos), Point::new(cos, sin), 0.01 * f64::from(i), 1.0);
    }
    let mut group = criterion.benchmark_group("solve");
    for kind in SolverKind::ALL {
        let solver = kind;
        group.bench_function(kind.name(), |bencher| bencher.iter(|| solver.solve(black_box(&form), &Pose2::IDENTITY)));
    }
}

fn benches(criterion: &mut Criterion) {
    bench_by_beams(criterion);
    bench_solve(criterion);
    let variant = |correspondence, solver| MatchingKnobs { correspondence, solver, ..MatchingKnobs::default() };
    let defaults = MatchingKnobs::default();
    bench_match(criterion, "match", &defaults, false);
    bench_match(criterion, "match_with_covariance", &defaults, true);
    bench_match(criterion, "match_kd_tree", &variant(CorrespondenceKind::KdTree, SolverKind::PointToLine), false);
    bench_match(
        criterion,
        "match_levenberg_marquardt",
        &variant(CorrespondenceKind::JumpTable, SolverKind::LevenbergMarquardt),
        false,
    );
    bench_match(criterion, "match_point_to_point", &variant(CorrespondenceKind::JumpTable, SolverKind::PointToPoint), false);
}

criterion_group! {
    name = all;
    config = Criterion::default().sample_size(50).measurement_time(std::time::Duration::from_secs(3)).warm_up_time(std::time::Duration::from_secs(1));
    targets = benches
}
criterion_main!(all);
