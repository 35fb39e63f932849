//! Tests of how refinements stop.

use super::*;
use crate::scan::BeamGeometry;
use crate::time::Stamp;

/// Scan of one endless straight wall at this distance ahead, m.
fn wall(distance: f64) -> Scan {
    let beams = BeamGeometry::new(-0.8, 0.01, 161);
    let ranges: Vec<f64> = (0..beams.len()).map(|i| distance / beams.angle(i).cos()).collect();
    Scan::new(Stamp::default(), beams.into(), (0.05, 30.0), ranges).unwrap()
}

fn classic() -> MatchingKnobs {
    MatchingKnobs { correspondence: CorrespondenceKind::JumpTable, coarse_rays: 0, ..MatchingKnobs::default() }
}

#[test]
fn a_solver_that_finds_no_pose_ends_the_match_at_the_guess() {
    let mut matcher = Matcher::new(&classic(), &RejectionKnobs::default());
    matcher.solver = |_, _| None;
    matcher.set_reference(&wall(2.0));
    let sensed = wall(1.9);
    let mut refinement = matcher.begin(&sensed, Pose2::IDENTITY);
    assert_eq!(refinement.refine(), Some(StopReason::Singular));
    assert_eq!((refinement.pose(), refinement.refine()), (Pose2::IDENTITY, Some(StopReason::Singular)), "it stays stopped");
}

/// A single wall does not constrain the motion along it: the pose moves across the wall and stays where it was along it.
#[test]
fn the_pose_stays_at_the_guess_along_an_unconstrained_direction() {
    for knobs in [classic(), MatchingKnobs::default()] {
        let mut matcher = Matcher::new(&knobs, &RejectionKnobs::default());
        matcher.set_reference(&wall(2.0));
        let sensed = wall(1.9);
        let mut refinement = matcher.begin(&sensed, Pose2::new(0.0, 0.02, 0.0));
        while refinement.refine().is_none() {}
        let pose = refinement.pose();
        assert!((pose.x - 0.1).abs() < 1e-3 && (pose.y - 0.02).abs() < 1e-3, "{pose:?}");
    }
}
