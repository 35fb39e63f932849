//! What laser odometry answers.

use std::f64::consts::{FRAC_PI_2, PI};
use std::fmt;

use crate::anytime::ErrorEstimate;
use crate::geometry::{Point, Pose2, PoseCovariance, Twist2};
use crate::matching::{PlacedView, Refinement, StopReason, Uncertainty};

/// How an answer came about.
#[derive(Clone, Debug, PartialEq)]
pub enum Outcome {
    /// By a match.
    Matched,
    /// First scan of a run: the pose is the one the run starts at.
    First,
    /// There was no match to be had; the pose is the prediction.
    Predicted(Failure),
}

crate::choices! {
    /// Why a scan was not matched.
    pub enum FailureReason {
        /// It has the stamp of the scan before.
        DuplicateStamp = "duplicate_stamp",
        /// Its stamp is before that of the last scan.
        OutOfOrder = "out_of_order",
        /// The message is no usable scan.
        MalformedScan = "malformed_scan",
        /// The laser does not look along the floor.
        TiltedMount = "tilted_mount",
        /// It does not fit the reference.
        TooFewCorrespondences = "too_few_correspondences",
        /// The correspondences determine no pose.
        Singular = "singular",
        /// The answer was called for before the first iteration.
        Interrupted = "interrupted",
        /// The time budget left no time for an iteration.
        NoTime = "no_time",
        /// The match corrects the prediction by more than is believed.
        CorrectionTooLarge = "correction_too_large",
    }
}

impl FailureReason {
    /// Whether the scan does not fit where it was expected.
    pub(super) fn is_no_fit(self) -> bool {
        matches!(self, Self::TooFewCorrespondences | Self::CorrectionTooLarge)
    }
}

/// Why a scan was not matched, for programs and in words.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Failure {
    /// The kind.
    pub reason: FailureReason,
    /// In words, with figures.
    pub text: String,
}

impl Failure {
    /// A failure.
    pub fn new(reason: FailureReason, text: impl Into<String>) -> Self {
        Self { reason, text: text.into() }
    }
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}

impl Outcome {
    /// Whether the pose is to be relied on.
    pub fn is_ok(&self) -> bool {
        !matches!(self, Self::Predicted(_))
    }
}

/// The answer to one scan.
#[derive(Clone, Debug)]
pub struct Registration {
    /// How the answer came about.
    pub outcome: Outcome,
    /// Pose of the base where it never jumps.
    pub odom_from_base: Pose2,
    /// Where that frame is on the map: the identity until a place is recognised.
    pub map_from_odom: Pose2,
    /// Covariance of the pose of the base, in the odom frame: grows along the way, as an odometry's does.
    pub covariance: PoseCovariance,
    /// Velocity of the base, in the base frame.
    pub twist: Twist2,
    /// Covariance of the velocity, in the base frame.
    pub twist_covariance: PoseCovariance,
    /// What the refinement did; `None` when there was none.
    pub refinement: Option<RefinementReport>,
    /// Error of the first guess.
    pub predicted_error: ErrorEstimate,
    /// Error of this answer in itself, not of the way up to here.
    pub estimated_error: ErrorEstimate,
    /// The sources of motion that are not believed from here on.
    pub disbelieved: Disbelieved,
    /// The answer is a match which contradicts what the odometry says of the way since the scans before were first matched to the same
    /// keyframe: one of the two is wrong, as where wheels slip or most rays see something that goes along with the laser.
    pub contradicts_odometry: bool,
    /// Whether the scan becomes the reference of the next ones.
    pub new_keyframe: bool,
}

impl Registration {
    /// Pose of the base on the map.
    pub fn map_from_base(&self) -> Pose2 {
        self.map_from_odom * self.odom_from_base
    }
}

/// The sources of motion that the last matches contradict: next to nothing is made of what they say until some agree.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Disbelieved {
    /// What says where the base is: wheel odometry, another node's transforms, a velocity.
    pub odometry: bool,
    /// What says how it turns.
    pub imu: bool,
}

impl Disbelieved {
    /// Their names.
    pub fn names(self) -> impl Iterator<Item = &'static str> {
        [("odometry", self.odometry), ("imu", self.imu)].into_iter().filter_map(|(name, disbelieved)| disbelieved.then_some(name))
    }
}

/// What a refinement did.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RefinementReport {
    /// What ended it.
    pub stop_reason: StopReason,
    /// Iterations made.
    pub iterations: u32,
    /// Sensed rays that carry a measurement.
    pub rays: u32,
    /// Those that took part in the last iteration.
    pub rays_used: u32,
    /// Of those, the ones with a partner.
    pub correspondences: u32,
    /// Of those, the ones that fixed the pose.
    pub inliers: u32,
    /// Mean absolute error of the inliers, m.
    pub mean_residual: f64,
    /// Of the information matrix; infinite where a direction is left open.
    pub condition_number: f64,
    /// That direction, seen from the base: 0 is straight ahead, rad, more than -pi/2 and at most pi/2.
    pub free_direction: Option<f64>,
}

/// Matched points for display: sensed points moved to their place and their reference points, in the map frame, m.
#[derive(Clone, Debug, Default)]
pub struct MatchedPoints {
    /// All points of the reference scan.
    pub reference: Vec<Point>,
    /// Sensed point and its partner.
    pub pairs: Vec<(Point, Point)>,
}

/// What a refinement did that ended for `stop_reason`. `base_heading`: of the base, in the reference frame, rad.
pub(super) fn report(
    refinement: &Refinement,
    stop_reason: StopReason,
    known: Option<&Uncertainty>,
    base_heading: f64,
) -> RefinementReport {
    let last = refinement.trace().last().copied().unwrap_or_default();
    let count = |n: usize| u32::try_from(n).unwrap_or(u32::MAX);
    RefinementReport {
        stop_reason,
        iterations: count(refinement.trace().len()),
        rays: count(refinement.rays()),
        rays_used: last.rays,
        correspondences: last.correspondences,
        inliers: last.inliers,
        mean_residual: last.mean_residual,
        condition_number: known.map_or(f64::INFINITY, |known| known.condition_number),
        free_direction: known.and_then(|known| known.free_direction).map(|open| half_turn(open.y.atan2(open.x) - base_heading)),
    }
}

/// The direction of a line, which has two: more than -pi/2 and at most pi/2.
fn half_turn(angle: f64) -> f64 {
    let angle = angle.rem_euclid(PI);
    if angle > FRAC_PI_2 { angle - PI } else { angle }
}

/// The matched points of a refinement, whose reference frame is the keyframe's.
pub(super) fn matched_points(refinement: &Refinement, views: &[PlacedView], map_from_keyframe: &Pose2) -> MatchedPoints {
    let transform = map_from_keyframe.transform();
    let mut pairs = Vec::new();
    refinement.matched_points(&mut pairs);
    for (p, q) in &mut pairs {
        (*p, *q) = (transform.apply(*p), transform.apply(*q));
    }
    let points = |placed: &PlacedView| {
        let transform = (*map_from_keyframe * placed.reference_from_view).transform();
        placed.view.points().map(move |p| transform.apply(p)).collect::<Vec<_>>()
    };
    MatchedPoints { reference: views.iter().flat_map(points).collect(), pairs }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_has_one_direction() {
        for (angle, expected) in [(0.1, 0.1), (0.1 + PI, 0.1), (-0.1, -0.1), (3.0, 3.0 - PI), (-FRAC_PI_2, FRAC_PI_2)] {
            assert!((half_turn(angle) - expected).abs() < 1e-12, "{angle}");
        }
    }
}
