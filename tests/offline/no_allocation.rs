//! The warm matching loop allocates nothing.

use crate::common::Laser;
use anytime_scan_matcher::geometry::Pose2;
use anytime_scan_matcher::matching::classic::correspondence::CorrespondenceKind;
use anytime_scan_matcher::matching::classic::rejection::RejectionKnobs;
use anytime_scan_matcher::matching::solver::SolverKind;
use anytime_scan_matcher::matching::{Matcher, MatchingKnobs, PlacedView};
use rand::SeedableRng;
use rand_pcg::Pcg64;

#[test]
fn a_warm_match_allocates_nothing() {
    let mut rng = Pcg64::seed_from_u64(41);
    let laser = Laser::with_field_of_view(270.0, 541);
    let pose = |i: f64| Pose2::new(0.05 * i, 0.02 * i, 0.03 * i);
    let scans: Vec<_> = (0..6).map(|i| laser.scan(pose(f64::from(i)), 0.01, 0.02, &mut rng)).collect();
    for &correspondence in CorrespondenceKind::ALL {
        for &solver in SolverKind::ALL {
            let knobs = MatchingKnobs { correspondence, solver, ..MatchingKnobs::default() };
            let mut matcher = Matcher::new(&knobs, &RejectionKnobs::default());
            let views: Vec<_> = scans.iter().map(|scan| [PlacedView::at_origin(matcher.view(scan.clone()))]).collect();
            let run = |matcher: &mut Matcher, with_reference: bool| {
                for (view, sensed) in views.iter().zip(&scans[1..]) {
                    if with_reference {
                        matcher.set_views(view);
                    }
                    let mut refinement = matcher.begin(sensed, Pose2::IDENTITY);
                    while refinement.refine().is_none() {}
                    let uncertainty = refinement.uncertainty().unwrap();
                    assert!(uncertainty.covariance.is_some() && uncertainty.condition_number.is_finite());
                }
            };
            run(&mut matcher, true);
            // kiddo's tree is rebuilt for every reference.
            let with_reference = correspondence != CorrespondenceKind::KdTree;
            let allocations = allocation_counter::measure(|| run(&mut matcher, with_reference));
            assert_eq!(allocations.count_total, 0, "{} {}", correspondence.name(), solver.name());
        }
    }
}
