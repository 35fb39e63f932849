//! The output of laser odometry.

use std::f64::consts::{FRAC_PI_2, PI};
use std::fmt;

use crate::anytime::ErrorEstimate;
use crate::geometry::{Point, Pose2, PoseCovariance, Twist2};
use crate::matching::{IterationTrace, PlacedView, Refinement, StopReason, Uncertainty};

/// How a pose was obtained.
#[derive(Clone, Debug, PartialEq)]
pub enum Outcome {
    /// By a match.
    Matched,
    /// First scan of a run: the pose is the start pose of the run.
    First,
    /// The match failed; the pose is the prediction.
    Predicted(Failure),
}

crate::choices! {
    /// Why a scan was not matched.
    pub enum FailureReason {
        /// It has the stamp of the previous scan.
        DuplicateStamp = "duplicate_stamp",
        /// Its stamp is older than that of the previous scan.
        OutOfOrder = "out_of_order",
        /// The message is not a valid scan.
        MalformedScan = "malformed_scan",
        /// The laser does not scan in a horizontal plane.
        TiltedMount = "tilted_mount",
        /// It does not fit the reference.
        TooFewCorrespondences = "too_few_correspondences",
        /// The correspondences do not determine a pose.
        Singular = "singular",
        /// The answer was requested before the first iteration.
        Interrupted = "interrupted",
        /// The time budget left no time for an iteration.
        NoTime = "no_time",
        /// The match corrects the prediction by more than the limit.
        CorrectionTooLarge = "correction_too_large",
    }
}

impl FailureReason {
    /// Whether the scan did not fit at the predicted pose.
    pub(super) fn is_no_fit(self) -> bool {
        matches!(self, Self::TooFewCorrespondences | Self::CorrectionTooLarge)
    }
}

/// Why a scan was not matched.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Failure {
    /// The reason, for programs.
    pub reason: FailureReason,
    /// The reason as a sentence, with numbers.
    pub text: String,
}

impl Failure {
    /// Creates a failure.
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
    /// Whether the pose is reliable.
    pub fn is_ok(&self) -> bool {
        !matches!(self, Self::Predicted(_))
    }
}

/// The registration of one scan.
#[derive(Clone, Debug)]
pub struct Registration {
    /// How the pose was obtained.
    pub outcome: Outcome,
    /// Pose of the base in the odom frame, in which it never jumps.
    pub odom_from_base: Pose2,
    /// Pose of the odom frame on the map: the identity until a loop is closed.
    pub map_from_odom: Pose2,
    /// Covariance of the base's pose in the odom frame: grows along the path, as that of any odometry.
    pub covariance: PoseCovariance,
    /// Velocity of the base, in the base frame.
    pub twist: Twist2,
    /// Covariance of the velocity, in the base frame.
    pub twist_covariance: PoseCovariance,
    /// What the refinement did; `None` if there was none.
    pub refinement: Option<RefinementReport>,
    /// Error of the first guess.
    pub predicted_error: ErrorEstimate,
    /// Error of this match alone, without the error of the path before it.
    pub estimated_error: ErrorEstimate,
    /// The sources of motion that are rejected from here on.
    pub rejected_sources: RejectedSources,
    /// The match contradicts the odometry over the last seconds. One of the two is wrong: wheels slip, or most rays hit something
    /// that moves along with the laser.
    pub contradicts_odometry: bool,
    /// Whether the scan becomes a keyframe.
    pub new_keyframe: bool,
}

impl Registration {
    /// Pose of the base on the map.
    pub fn map_from_base(&self) -> Pose2 {
        self.map_from_odom * self.odom_from_base
    }
}

/// The sources of motion that the latest matches contradict: they get almost no weight until matches agree with them again.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RejectedSources {
    /// Sources of position: wheel odometry, another node's transforms, a velocity.
    pub odometry: bool,
    /// The IMU, as a source of rotation.
    pub imu: bool,
}

impl RejectedSources {
    /// Names of the rejected sources.
    pub fn names(self) -> impl Iterator<Item = &'static str> {
        [("odometry", self.odometry), ("imu", self.imu)].into_iter().filter_map(|(name, rejected)| rejected.then_some(name))
    }
}

/// What a refinement did.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RefinementReport {
    /// Why it stopped.
    pub stop_reason: StopReason,
    /// Number of iterations.
    pub iterations: u32,
    /// Rays of the scan with a valid measurement.
    pub rays: u32,
    /// The last iteration; zeros if there was none.
    pub last: IterationTrace,
    /// Condition number of the information matrix; infinite if a direction is unconstrained.
    pub condition_number: f64,
    /// The unconstrained direction in the base frame, rad: 0 is forward, in (-pi/2, pi/2].
    pub free_direction: Option<f64>,
}

/// Matched points for display, in the map frame, m: points of the scan at the estimated pose, and the reference points.
#[derive(Clone, Debug, Default)]
pub struct MatchedPoints {
    /// All points of the reference.
    pub reference: Vec<Point>,
    /// Point of the scan and the reference point matched to it.
    pub pairs: Vec<(Point, Point)>,
}

/// Report of a refinement that stopped for `stop_reason`. `base_heading` is the heading of the base in the reference frame, rad.
pub(super) fn report(
    refinement: &Refinement,
    stop_reason: StopReason,
    uncertainty: Option<&Uncertainty>,
    base_heading: f64,
) -> RefinementReport {
    let count = |n: usize| u32::try_from(n).unwrap_or(u32::MAX);
    RefinementReport {
        stop_reason,
        iterations: count(refinement.trace().len()),
        rays: count(refinement.rays()),
        last: refinement.trace().last().copied().unwrap_or_default(),
        condition_number: uncertainty.map_or(f64::INFINITY, |known| known.condition_number),
        free_direction: uncertainty
            .and_then(|known| known.free_direction)
            .map(|open| half_turn(open.y.atan2(open.x) - base_heading)),
    }
}

/// Normalizes the direction of a line, which has no sign, to (-pi/2, pi/2].
fn half_turn(angle: f64) -> f64 {
    let angle = angle.rem_euclid(PI);
    if angle > FRAC_PI_2 { angle - PI } else { angle }
}

/// The matched points of a refinement in the keyframe's frame.
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
