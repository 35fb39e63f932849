//! Laser odometry: predicts, matches and maintains the reference.
//!
//! The main function is [`LaserOdometry::register_within`]. Frames: `map` is the frame of the keyframes, corrected by loop
//! closures; `odom` is the frame in which the pose never jumps (REP 105); `base` is the robot and `laser` the sensor. The
//! keyframe's frame is that of the laser at the reference scan. A loop closure moves odom relative to map, see
//! [`Registration::map_from_odom`].

mod clock_step;
mod counters;
mod drift;
pub mod heading;
mod inconsistency;
mod keyframe_pose;
mod keyframes;
mod known_motion;
mod lag;
mod local_map;
mod loop_closure;
mod match_problem;
mod match_scan;
mod motion_state;
mod pose_estimate;
mod prediction;
mod previous_estimate;
mod recent_path;
mod recognition;
mod registration;
mod scale_error;
mod set_pose;
mod source_noise;
pub mod sources;
pub mod sweep;
pub mod uncertainty;
mod unmatched;
mod update;
pub mod wheel;

use std::time::Duration;

use crate::anytime::clock::VirtualClock;
use crate::anytime::contract::Contract;
use crate::anytime::cost_model::CostModel;
use crate::anytime::interrupt::NeverInterrupt;
use crate::anytime::{ContractRunner, ScanContract};
use crate::geometry::{Pose2, PoseCovariance, Twist2};
use crate::knobs::Seconds;
use crate::matching::classic::rejection::RejectionKnobs;
use crate::matching::{IterationTrace, Matcher, MatchingKnobs, PlacedView, StopReason};
use crate::scan::Scan;
use crate::time::Continuity;
use crate::transforms::LaserPose;
pub use counters::{OdometryCounters, counted_in_words};
use keyframe_pose::KeyframePose;
use keyframes::{PendingKeyframe, is_same_mount};
use local_map::LocalMap;
use loop_closure::LoopVerifier;
use match_problem::MatchProblem;
use previous_estimate::PreviousEstimate;
use recent_path::RecentPath;
pub use registration::{Failure, FailureReason, MatchedPoints, Outcome, RefinementReport, Registration, RejectedSources};
use set_pose::SetPose;
use source_noise::LearnedNoise;
use sources::MotionSources;
use sweep::Sweep;

/// Weight of the latest scan in the moving averages of agreement and scan period.
const TYPICAL_WEIGHT: f64 = 0.05;

crate::choices! {
    /// The reference that scans are matched to.
    pub enum ReferenceChoice {
        /// The previous scan.
        Previous = "previous",
        /// The latest keyframe.
        Keyframe = "keyframe",
        /// Nearby keyframes of the whole path.
        LocalMap = "local_map",
    }
}

crate::knobs! {
    /// Parameters of laser odometry.
    pub struct OdometryKnobs {
        /// Reference of a scan: the previous scan, the latest keyframe, or nearby keyframes of the local map.
        reference: ReferenceChoice = ReferenceChoice::LocalMap;
        /// Number of keyframes that a scan is matched to at once: the three nearest, then others at increasing distances. Coarse
        /// levels use only the three nearest; nearest-point correspondence searches only the first.
        views: u32 = 6, in 1 to 20;
        /// Maximum number of keyframes in the local map; beyond that, places driven through more than 20 m ago are remembered in
        /// less detail. A keyframe takes 30 to 50 bytes per beam. Keyframes are added where the robot has not been before, so
        /// that their number grows with the area and not with the time.
        max_keyframes: u32 = 2000, in 1 to 10000;
        /// Close loops: recognise previously visited places in the local map and correct the map. Poses then jump in the map
        /// frame, never in the odom frame. Needs projective correspondences. When off, a keyframe is used for 20 m of driving,
        /// and map and odom are the same frame.
        close_loops: bool = true;
        /// Distance from the latest keyframe that triggers a new one.
        keyframe_distance: f64 = 0.4, in 0 to 100, unit "m";
        /// Rotation from the latest keyframe that triggers a new one.
        keyframe_angle: f64 = 0.35, in 0 to 4, unit "rad";
        /// Pose of the laser in the base frame, `[x, y, yaw]`. A fourth number is its roll, 3.1416 for a laser mounted upside
        /// down; by default the roll is taken from tf. Unset: the pose is taken from `/tf` or `/tf_static`, or else is the
        /// identity, with a warning.
        laser_in_base: Option<LaserPose> = None, unit "m, m, rad";
        /// Correct the motion distortion of rays that were measured one after the other.
        deskew: bool = true;
        /// Time from the first to the last ray of a scan, if the driver does not set `time_increment`; unset: use
        /// `time_increment`. Negative if the driver has reversed the rays, so that the last ray was measured first, at the stamp.
        scan_duration: Option<Seconds> = None, in -1 to 1, unit "s";
        /// Initial pose of the base, `[x, y, yaw]`, in both the map and the odom frame.
        initial_pose: Pose2 = Pose2::IDENTITY, unit "m, m, rad";
        /// Maximum time to wait for odometry that is more than 50 ms behind a scan, and at the first scan for the pose of its laser;
        /// limited by the time budget.
        max_wait: Seconds = Seconds(0.3), in 0 to 10, unit "s";
        /// Reject a match that shifts the predicted position by more than this.
        max_correction_distance: f64 = 1.0, in 0.01 to 100, unit "m";
        /// Reject a match that changes the predicted heading by more than this.
        max_correction_angle: f64 = 0.8, in 0.01 to 4, unit "rad";
    }
}

/// Laser odometry: takes scans and wheel odometry, returns poses.
pub struct LaserOdometry {
    knobs: OdometryKnobs,
    matcher: Matcher,
    sources: MotionSources,
    noise: LearnedNoise,
    stamps: Continuity,
    /// A scan was matched before its odometry arrived. The odometry may have stopped, so no scan waits for it until it is back.
    odometry_wait_timed_out: bool,
    map: LocalMap,
    map_from_odom: Pose2,
    /// Covariance of the inverse of `map_from_odom`, in the odom frame: the drift that loop closures have corrected.
    drift_covariance: PoseCovariance,
    loop_verifier: LoopVerifier,
    /// The latest keyframe has not been compared with earlier ones yet.
    loop_check_pending: bool,
    views: Vec<PlacedView>,
    keyframe: Option<KeyframePose>,
    recent_path: RecentPath,
    pending_keyframe: Option<PendingKeyframe>,
    /// The latest scan if its pose was returned before its match had finished, and the pose reached, in the keyframe's frame.
    unfinished: Option<(Scan, MatchProblem, Pose2)>,
    previous: Option<PreviousEstimate>,
    typical_agreement: f64,
    /// Moving average of the time between scans, s.
    typical_period: f64,
    start_pose: Pose2,
    set_pose: Option<SetPose>,
    /// Velocity smoothed over a tenth of a second, so that a single jump of the pose has little effect.
    typical_twist: Twist2,
    counters: OdometryCounters,
    keep_matched_points: bool,
    matched_points: Option<MatchedPoints>,
    iterations: Vec<IterationTrace>,
}

impl LaserOdometry {
    /// Creates an odometry at the configured initial pose.
    pub fn new(knobs: &OdometryKnobs, matching: &MatchingKnobs, rejection: &RejectionKnobs) -> Self {
        Self {
            knobs: knobs.clone(),
            matcher: Matcher::new(matching, rejection).with_noise_estimation(),
            sources: MotionSources::default(),
            noise: LearnedNoise::default(),
            stamps: Continuity::default(),
            odometry_wait_timed_out: false,
            map: LocalMap::default(),
            map_from_odom: Pose2::IDENTITY,
            drift_covariance: PoseCovariance::zeros(),
            loop_verifier: LoopVerifier::default(),
            loop_check_pending: false,
            views: Vec::new(),
            keyframe: None,
            recent_path: RecentPath::default(),
            pending_keyframe: None,
            unfinished: None,
            previous: None,
            typical_agreement: 1.0,
            typical_period: 0.0,
            start_pose: knobs.initial_pose,
            set_pose: None,
            typical_twist: Twist2::default(),
            counters: OdometryCounters::default(),
            keep_matched_points: false,
            matched_points: None,
            iterations: Vec::new(),
        }
    }

    /// Events counted so far.
    pub fn counters(&self) -> &OdometryCounters {
        &self.counters
    }

    /// Whether to keep the matched points of each scan for [`Self::matched_points`].
    pub fn set_keep_matched_points(&mut self, keep: bool) {
        self.keep_matched_points = keep;
    }

    /// The matched points of the latest scan, if it was matched and they were to be kept.
    pub fn matched_points(&self) -> Option<&MatchedPoints> {
        self.matched_points.as_ref()
    }

    /// Estimated lag of scans behind the wheel odometry, s: a scan shows the robot where the odometry had it this much earlier. 0
    /// until it can be estimated.
    pub fn odometry_lag(&self) -> f64 {
        self.sources.wheel_lag()
    }

    /// What each iteration of the latest match did; empty if the latest scan was not matched.
    pub fn iterations(&self) -> &[IterationTrace] {
        &self.iterations
    }

    /// Sets the maximum number of iterations per match.
    pub fn set_max_iterations(&mut self, limit: u32) {
        self.matcher.set_max_iterations(limit);
    }

    /// Restarts: the next scan is the first one, at `map_from_base`, and map and odom coincide again.
    pub fn restart_at(&mut self, map_from_base: Pose2) {
        self.forget_reference();
        self.typical_agreement = 1.0;
        self.noise = LearnedNoise::default();
        self.stamps = Continuity::default();
        self.previous = None;
        self.map_from_odom = Pose2::IDENTITY;
        self.drift_covariance = PoseCovariance::zeros();
        self.start_pose = map_from_base;
        self.set_pose = None;
    }

    /// Restarts at the initial pose and forgets all motion sources.
    pub fn reset(&mut self) {
        self.restart_at(self.knobs.initial_pose);
        self.sources = MotionSources::default();
    }

    /// Drops all keyframes, so that the next scan becomes the reference. For example, the mounting pose of the laser turned out
    /// to be wrong. The base continues from its estimated pose.
    pub fn forget_reference(&mut self) {
        self.unfinished = None;
        self.keyframe = None;
        self.map.clear();
        self.recent_path.clear();
        self.loop_verifier.reset();
        self.loop_check_pending = false;
        self.pending_keyframe = None;
    }

    /// Registers a scan without a time limit: returns the pose of the base when it was taken. `base_from_laser` is the mounting
    /// pose of the laser.
    ///
    /// ```
    /// use anytime_scan_matcher::geometry::Pose2;
    /// use anytime_scan_matcher::matching::{MatchingKnobs, classic::rejection::RejectionKnobs};
    /// use anytime_scan_matcher::odometry::{LaserOdometry, OdometryKnobs};
    /// use anytime_scan_matcher::scan::{BeamGeometry, Scan};
    /// use anytime_scan_matcher::time::Stamp;
    ///
    /// // The scan of a laser that drives at 1 m/s in a room of 6 m by 4 m.
    /// let scan = |seconds: f64| {
    ///     let range = |i: i32| {
    ///         let (sin, cos) = (f64::from(i - 180) * 0.0174).sin_cos();
    ///         let along = (cos.signum() * 3.0 - seconds) / cos;
    ///         along.min(sin.signum() * 2.0 / sin)
    ///     };
    ///     let ranges: Vec<f64> = (0..361).map(range).collect();
    ///     Scan::new(Stamp::from_seconds(seconds), BeamGeometry::new(-180.0 * 0.0174, 0.0174, 361).into(), (0.05, 30.0), ranges)
    /// };
    /// let mut odometry = LaserOdometry::new(&OdometryKnobs::default(), &MatchingKnobs::default(), &RejectionKnobs::default());
    /// for i in 0..20 {
    ///     let registration = odometry.register(&scan(0.05 * f64::from(i)).unwrap(), &Pose2::IDENTITY);
    ///     assert!((registration.odom_from_base.x - 0.05 * f64::from(i)).abs() < 0.01);
    /// }
    /// ```
    pub fn register(&mut self, scan: &Scan, base_from_laser: &Pose2) -> Registration {
        let (clock, mut costs) = (VirtualClock::new(Duration::ZERO), CostModel::new(0.5));
        let scan_contract = ScanContract { contract: Contract::default(), arrival: Duration::ZERO, started: Duration::ZERO };
        self.register_within(scan, base_from_laser, &mut ContractRunner::new(scan_contract, &clock, &NeverInterrupt, &mut costs))
    }

    /// As [`Self::register`], but under a contract: returns the best pose when `runner` stops the refinement, out of time or
    /// within the error bound.
    pub fn register_within(&mut self, scan: &Scan, base_from_laser: &Pose2, runner: &mut ContractRunner) -> Registration {
        self.start_scan();
        if let Some(registration) = self.check_stamp(scan.stamp()) {
            return registration;
        }
        let undistorted = self.undistorted(scan, base_from_laser);
        let scan = undistorted.as_ref().unwrap_or(scan);
        if let Some(registration) = self.register_at_set_pose(scan, base_from_laser) {
            return registration;
        }
        let Some(previous) = self.previous else {
            return self.register_first(scan, base_from_laser, self.start_pose, PoseCovariance::zeros());
        };
        // Predict.
        let mut problem = self.match_problem(&previous, scan.stamp(), base_from_laser);
        if self.keyframe.is_none() {
            let (map_from_base, covariance) = problem.predicted_base();
            return self.register_first(scan, base_from_laser, map_from_base, covariance);
        }
        // Match.
        let Some(keyframe) = self.reference_for(scan, &problem) else {
            return self.register_without_overlap(scan, &problem);
        };
        let first_guess = keyframe.map_from_laser.between(&problem.predicted_laser());
        let mut result = self.match_scan(&keyframe, scan, &problem, first_guess, runner);
        if let Some((corrected, refit)) = self.match_after_clock_step(&keyframe, scan, &problem, &result, runner) {
            (problem, result) = (corrected, refit);
        }
        // Decide.
        let becomes_keyframe = self.needs_keyframe(&result.keyframe_from_laser);
        let worth_finishing = match result.report.stop_reason {
            StopReason::Budget | StopReason::Interrupted => true,
            // The pose is good enough to return, but a keyframe's error adds to those of all later poses.
            StopReason::ErrorBound => becomes_keyframe,
            _ => false,
        };
        if worth_finishing {
            self.unfinished = Some((scan.clone(), problem, result.keyframe_from_laser));
        } else if let Some(registration) = self.replace_refuted_reference(scan, &problem, &result) {
            return registration;
        } else {
            self.update_noise(&problem, &result, scan.stamp());
        }
        // Keep.
        match result.estimate {
            Ok(estimate) => self.commit(scan, base_from_laser, estimate, becomes_keyframe),
            Err(failure) => {
                let is_same_laser = is_same_mount(&keyframe.base_from_laser, base_from_laser);
                self.register_failed_match(scan, &problem, result.report, failure, becomes_keyframe, is_same_laser)
            }
        }
    }

    /// Forgets what belongs to the answer to the previous scan.
    fn start_scan(&mut self) {
        self.maintain();
        self.matched_points = None;
        self.iterations.clear();
    }

    /// The scan without the distortion by the motion during its sweep; `None` if there is none. The motion is that of the wheels,
    /// or else that of the latest poses.
    pub fn undistorted(&self, scan: &Scan, base_from_laser: &Pose2) -> Option<Scan> {
        let sweep = Sweep::of(scan, &self.knobs)?;
        let (start, end) = sweep.span(scan.stamp());
        let by_wheels = self.sources.motion(start, end).filter(|_| !self.noise.odometry.is_rejected());
        let motion = by_wheels.or_else(|| Some(self.previous?.mean_twist.motion(sweep.seconds())))?;
        Some(sweep.deskewed(scan, base_from_laser, &motion))
    }

    /// Finishes the match of the latest scan if its pose had to be returned early: later scans are predicted from the better
    /// pose.
    pub fn finish(&mut self, runner: &mut ContractRunner) {
        let (Some((scan, problem, reached)), Some(keyframe)) = (self.unfinished.take(), self.keyframe) else { return };
        let result = self.match_scan(&keyframe, &scan, &problem, reached, runner);
        if self.replace_refuted_reference(&scan, &problem, &result).is_some() {
            return;
        }
        self.update_noise(&problem, &result, scan.stamp());
        let becomes_keyframe = self.needs_keyframe(&result.keyframe_from_laser);
        if let Ok(estimate) = result.estimate {
            // Redo the update with the better pose. A scan that became a keyframe remains one.
            let was_keyframe = self.pending_keyframe.take().is_some();
            self.counters.keyframes -= u64::from(was_keyframe);
            self.counters.finished_later += 1;
            self.previous = Some(problem.previous);
            self.commit(&scan, &problem.base_from_laser, estimate, becomes_keyframe || was_keyframe);
        }
    }
}
