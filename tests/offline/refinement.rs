//! How matches end: in a cycle of the same pairs, by a search from other initial guesses, without correspondences.

use anytime_scan_matcher::geometry::Pose2;
use anytime_scan_matcher::matching::classic::correspondence::CorrespondenceKind;
use anytime_scan_matcher::matching::classic::rejection::RejectionKnobs;
use anytime_scan_matcher::matching::{Matcher, MatchingKnobs, Refinement, StopReason};
use anytime_scan_matcher::simulation::pairs::{Pairs, ScanPair};
use anytime_scan_matcher::simulation::random_world::RandomWorld;

fn finish(refinement: &mut Refinement) -> StopReason {
    loop {
        if let Some(reason) = refinement.refine() {
            return reason;
        }
    }
}

/// The pose that a match from `guess` ends at, and whether other initial guesses were tried.
fn ended(pair: &ScanPair, guess: Pose2) -> (Pose2, bool) {
    let mut matcher = Matcher::new(&MatchingKnobs::default(), &RejectionKnobs::default());
    matcher.set_reference(&pair.reference);
    let mut refinement = matcher.begin(&pair.sensed, guess);
    let mut has_searched = false;
    while refinement.refine().is_none() {
        has_searched |= refinement.is_searching();
    }
    (refinement.pose(), has_searched)
}

#[test]
fn repeated_pairs_end_the_iteration_at_the_best_of_them() {
    let never = MatchingKnobs {
        correspondence: CorrespondenceKind::JumpTable,
        coarse_rays: 0,
        epsilon_translation: 0.0,
        epsilon_rotation: 0.0,
        ..MatchingKnobs::default()
    };
    let mut cycles = 0;
    for pair in Pairs::new(RandomWorld::Room, 181, 3).take(20) {
        let mut matcher = Matcher::new(&never, &RejectionKnobs::default());
        matcher.set_reference(&pair.reference);
        let mut refinement = matcher.begin(&pair.sensed, pair.first_guess);
        let reason = finish(&mut refinement);
        if reason == StopReason::Cycle {
            cycles += 1;
            assert!(refinement.trace().iter().any(|iteration| iteration.pose == refinement.pose()), "a pose of the cycle");
        }
        assert_ne!(reason, StopReason::IterationLimit);
    }
    assert!(cycles > 0, "none of 20 ends in a cycle");
}

#[test]
fn a_bad_guess_is_corrected_by_other_starts() {
    let (mut searched, mut found) = (0, 0);
    for pair in Pairs::new(RandomWorld::Room, 361, 5).take(300) {
        let truth = pair.reference_from_sensed;
        let (_, by_tracking) = ended(&pair, truth);
        assert!(!by_tracking, "no search if the scans agree");
        let astray = truth * Pose2::new(-0.25, 0.2, 0.3);
        let (pose, has_searched) = ended(&pair, astray);
        let error = truth.between(&pose);
        searched += u32::from(has_searched);
        found += u32::from(error.distance() < 0.02 && error.theta.abs() < 0.01);
    }
    assert!(searched > 10 && found == 300, "{searched} searched, {found} found of 300");
}

#[test]
fn scans_of_different_places_do_not_match_and_the_pose_stays_as_tracked() {
    let mut pairs = Pairs::new(RandomWorld::Room, 361, 7);
    let (here, there) = (pairs.next().unwrap(), pairs.next().unwrap());
    let mut matcher = Matcher::new(&MatchingKnobs::default(), &RejectionKnobs::default());
    matcher.set_reference(&here.reference);
    let mut refinement = matcher.begin(&there.sensed, Pose2::IDENTITY);
    while !refinement.is_searching() {
        assert_eq!(refinement.refine(), None, "a search must follow");
    }
    let tracked = refinement.pose();
    let reason = finish(&mut refinement);
    assert_eq!((reason, refinement.pose()), (StopReason::TooFewCorrespondences, tracked));
}
