//! Laser odometry: predict, match, keep the reference up to date.
//!
//! [`LaserOdometry::register_within`] is the whole of it. Frames: `map` is where the keyframes are, and drifts as little as they let it;
//! `odom` is where the pose never jumps (REP 105); `base` is the robot, `laser` the sensor, and the keyframe is the reference scan's
//! laser. When a place is recognised, map and odom part: [`Registration::map_from_odom`].

mod answer;
mod attempt;
mod doubt;
mod drift;
pub mod heading;
mod lag;
mod local_map;
mod loop_closure;
mod motion_state;
mod placement;
mod prediction;
mod registration;
mod set_pose;
mod source_noise;
pub mod sources;
pub mod sweep;
pub mod uncertainty;
pub mod wheel;

use std::time::Duration;

use crate::anytime::clock::VirtualClock;
use crate::anytime::contract::Contract;
use crate::anytime::cost_model::CostModel;
use crate::anytime::interrupt::Never;
use crate::anytime::{Driver, ErrorEstimate, Task, estimated_error};
use crate::geometry::{Pose2, PoseCovariance, Twist2, wrap_angle};
use crate::knobs::Seconds;
use crate::matching::rejection::RejectionKnobs;
use crate::matching::{FirstGuess, IterationTrace, Matcher, MatchingKnobs, PlacedView, StopReason};
use crate::scan::Scan;
use crate::time::{Continuity, Stamp, Step};
use crate::transforms::LaserPlace;
use answer::{Answer, Found, problem};
use attempt::{Attempt, Last, USUAL_VARIATION};
use doubt::Doubt;
use heading::HeadingReading;
use local_map::{LocalMap, Unrecognised};
use loop_closure::{LoopCloser, Recognition, Sighting};
use motion_state::MotionState;
use placement::Placement;
use prediction::Prediction;
pub use registration::{Disbelieved, Failure, FailureReason, MatchedPoints, Outcome, RefinementReport, Registration};
use registration::{matched_points, report};
use set_pose::SetPose;
use source_noise::SourceNoise;
use sources::MotionSources;
use sweep::Sweep;
use wheel::{WheelEvent, WheelSample};

/// A pose farther than this, m, from where the velocity before leads has jumped, ...
const JUMP: f64 = 0.04;
/// as has one with this turn, rad, ...
const TURN_JUMP: f64 = 0.04;
/// besides what a robot speeds up by: m/s^2 ...
const MAX_ACCELERATION: f64 = 30.0;
/// ... and rad/s^2.
const MAX_TURN_ACCELERATION: f64 = 100.0;
/// So many times as long as usual after the last one, a scan has come late, or the clock was set. Less than that a search bridges.
const LATE_BY_PERIODS: f64 = 4.0;
/// Two places of a laser on the base, m and rad, are one when they differ by less: tf jitters.
const SAME_MOUNT: f64 = 0.05;
/// Weight of the last scan in the usual agreement and period.
const USUAL_WEIGHT: f64 = 0.05;
/// Time that the usual velocity is of, s.
const USUAL_TIME: f64 = 0.1;

crate::choices! {
    /// The scan that is matched to.
    pub enum ReferenceChoice {
        /// The scan before.
        Previous = "previous",
        /// The last keyframe.
        Keyframe = "keyframe",
        /// The keyframes around, of the whole path.
        LocalMap = "local_map",
    }
}

crate::knobs! {
    /// From matches to a trajectory.
    pub struct OdometryKnobs {
        /// What a scan is matched to: the scan before, the last keyframe, or the keyframes around.
        reference: ReferenceChoice = ReferenceChoice::LocalMap;
        /// Keyframes that a scan is matched to at once: the three nearest, and some farther and farther out. Coarse levels make do with
        /// the three; nearest points are looked for in the first of them alone.
        views: u32 = 6, in 1 to 20;
        /// Keyframes of the local map at most; beyond, the oldest go. One takes 30 to 50 bytes per beam.
        max_keyframes: u32 = 1000, in 1 to 10000;
        /// Recognise places of earlier on the path, in the local map, and put the map right: poses then jump in the map frame, never in
        /// the odom frame. Takes projective pairs. Without, keyframes serve for 20 m of the way, and map and odom are one.
        close_loops: bool = true;
        /// A new keyframe after this way.
        keyframe_distance: f64 = 0.4, in 0 to 100, unit "m";
        /// A new keyframe after this turn.
        keyframe_angle: f64 = 0.35, in 0 to 4, unit "rad";
        /// Pose of the laser in the base frame, `[x, y, yaw]`; with a fourth number, its roll, which is 3.1416 for a laser on its head and
        /// else what tf says; unset: from `/tf` or `/tf_static`, else the identity, with a warning.
        laser_in_base: Option<LaserPlace> = None, unit "m, m, rad";
        /// Whether to put rays that were taken one after the other where they belong.
        deskew: bool = true;
        /// Time from the first ray of a scan to the last, where the driver's `time_increment` does not say; unset: as it says. Less than
        /// zero where the driver has put the rays in reverse order: the last one was taken first, at the stamp.
        scan_duration: Option<Seconds> = None, in -1 to 1, unit "s";
        /// Pose of the base at the start, `[x, y, yaw]` in the map frame and in the odom frame.
        initial_pose: Pose2 = Pose2::IDENTITY, unit "m, m, rad";
        /// Longest wait for odometry that is more than 50 ms behind a scan; not longer than the time budget.
        max_wait: Seconds = Seconds(0.3), in 0 to 10, unit "s";
        /// A match that corrects the prediction by more than this is not believed.
        max_correction_distance: f64 = 1.0, in 0.01 to 100, unit "m";
        /// A match that turns the prediction by more than this is not believed.
        max_correction_angle: f64 = 0.8, in 0.01 to 4, unit "rad";
    }
}

/// Events that are counted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct OdometryCounters {
    /// Keyframes so far.
    pub keyframes: u64,
    /// Places recognised.
    pub closed_loops: u64,
    /// Answers that were predictions.
    pub predicted: u64,
    /// Matches that were finished after their answer was out.
    pub finished_later: u64,
    /// Scans with the stamp of the one before.
    pub duplicate_scans: u64,
    /// Scans a little older than the one before.
    pub out_of_order_scans: u64,
    /// Runs that ended because time went back.
    pub time_jumps: u64,
    /// Steps of the clock after which the robot drove on.
    pub clock_steps: u64,
    /// Wheel odometry messages with the stamp of the one before.
    pub duplicate_odometry: u64,
    /// Jumps of the wheel odometry.
    pub odometry_resets: u64,
    /// Scans whose motion the wheel odometry did not cover.
    pub without_odometry: u64,
    /// Scans whose prediction made next to nothing of the odometry there was, as the matches before had contradicted it.
    pub odometry_disbelieved: u64,
    /// The same of the IMU.
    pub imu_disbelieved: u64,
    /// Matches that contradict the odometry, which has not been disbelieved: it says another way from the last keyframe.
    pub odometry_contradicted: u64,
}

impl OdometryCounters {
    /// What the user should know of the events, one sentence for each kind that there was.
    pub fn in_words(&self) -> impl Iterator<Item = String> {
        let counted = [
            (self.without_odometry, "scans predicted at constant velocity: no odometry covers them"),
            (self.duplicate_scans, "scans with the stamp of the one before"),
            (self.out_of_order_scans, "scans out of order"),
            (self.time_jumps, "jumps back in time (each started a new run)"),
            (self.clock_steps, "steps of the clock (each went on from the last pose)"),
            (self.duplicate_odometry, "odometry messages with the stamp of the one before"),
            (self.odometry_resets, "jumps of the odometry"),
            (self.imu_disbelieved, "scans predicted without the IMU, which the scans before had contradicted"),
            (self.odometry_disbelieved, "scans predicted almost without the odometry, which the scans before had contradicted"),
            (
                self.odometry_contradicted,
                "matches that contradict the odometry: one of the two is wrong (do wheels slip? does the laser see the robot itself, or a \
                 cover, or people all around?)",
            ),
        ];
        counted.into_iter().filter(|(count, _)| *count > 0).map(|(count, what)| format!("{count} {what}"))
    }
}

/// Laser odometry: scans and wheel odometry in, poses out.
pub struct LaserOdometry {
    knobs: OdometryKnobs,
    matcher: Matcher,
    sources: MotionSources,
    noise: LearnedNoise,
    stamps: Continuity,
    /// A scan was answered before the odometry had come for it: it may have died, none is waited for until it is back.
    waited_in_vain: bool,
    map: LocalMap,
    map_from_odom: Pose2,
    /// Covariance of its inverse, in the odom frame: by so much the path had drifted where places were recognised.
    drift_covariance: PoseCovariance,
    loop_closer: LoopCloser,
    /// The last keyframe has not been compared with earlier ones yet.
    to_be_recognised: bool,
    views: Vec<PlacedView>,
    keyframe: Option<Placement>,
    approach: Approach,
    upcoming_keyframe: Option<UpcomingKeyframe>,
    /// The last scan, when its answer was given before its match was done, and the pose (in the keyframe) that it had come to.
    unfinished: Option<(Scan, Attempt, Pose2)>,
    last: Option<Last>,
    usual_agreement: f64,
    /// Time from one scan to the next, s.
    usual_period: f64,
    start: Pose2,
    set_pose: Option<SetPose>,
    /// The velocity of the last [`USUAL_TIME`]; a single pose that jumps spoils it little.
    usual_twist: Twist2,
    counters: OdometryCounters,
    keep_matched_points: bool,
    matched_points: Option<MatchedPoints>,
    iterations: Vec<IterationTrace>,
}

impl LaserOdometry {
    /// Odometry with these knobs, at its initial pose.
    pub fn new(knobs: &OdometryKnobs, matching: &MatchingKnobs, rejection: &RejectionKnobs) -> Self {
        Self {
            knobs: knobs.clone(),
            matcher: Matcher::new(matching, rejection).learning_noise(),
            sources: MotionSources::default(),
            noise: LearnedNoise::default(),
            stamps: Continuity::default(),
            waited_in_vain: false,
            map: LocalMap::default(),
            map_from_odom: Pose2::IDENTITY,
            drift_covariance: PoseCovariance::zeros(),
            loop_closer: LoopCloser::default(),
            to_be_recognised: false,
            views: Vec::new(),
            keyframe: None,
            approach: Approach::default(),
            upcoming_keyframe: None,
            unfinished: None,
            last: None,
            usual_agreement: 1.0,
            usual_period: 0.0,
            start: knobs.initial_pose,
            set_pose: None,
            usual_twist: Twist2::default(),
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

    /// Whether to keep the matched points of each answer for [`Self::matched_points`].
    pub fn set_keep_matched_points(&mut self, keep: bool) {
        self.keep_matched_points = keep;
    }

    /// The matched points of the last answer, where it was a match and they were to be kept.
    pub fn matched_points(&self) -> Option<&MatchedPoints> {
        self.matched_points.as_ref()
    }

    /// Scans show the robot where the wheel odometry had it so much earlier, s; found along the path, 0 as long as nothing says so.
    pub fn odometry_lag(&self) -> f64 {
        self.sources.wheel_lag()
    }

    /// What each iteration of the last match did; empty where there was none for the last answer.
    pub fn iterations(&self) -> &[IterationTrace] {
        &self.iterations
    }

    /// Another limit of the iterations of one match.
    pub fn set_max_iterations(&mut self, limit: u32) {
        self.matcher.set_max_iterations(limit);
    }

    /// Starts again: the next scan is the first one, at `map_from_base`; map and odom are one again.
    pub fn restart_at(&mut self, map_from_base: Pose2) {
        self.forget_reference();
        self.usual_agreement = 1.0;
        self.noise = LearnedNoise::default();
        self.stamps = Continuity::default();
        self.last = None;
        self.map_from_odom = Pose2::IDENTITY;
        self.drift_covariance = PoseCovariance::zeros();
        self.start = map_from_base;
        self.set_pose = None;
    }

    /// Starts again at the initial pose, with nothing known.
    pub fn reset(&mut self) {
        self.restart_at(self.knobs.initial_pose);
        self.sources.clear();
    }

    /// The next scan is one that others are matched to: as when those before were taken from another place on the base than was known. The
    /// base goes on from where it was said to be.
    pub fn forget_reference(&mut self) {
        self.unfinished = None;
        self.keyframe = None;
        self.map.clear();
        self.loop_closer.forget();
        self.to_be_recognised = false;
        self.upcoming_keyframe = None;
    }

    /// Takes a message of wheel odometry.
    pub fn add_wheel_sample(&mut self, sample: WheelSample) {
        self.waited_in_vain = false;
        match self.sources.push(sample) {
            WheelEvent::Appended => {}
            WheelEvent::TimeJump { goes_on } => self.stamps.odometry_went_back(goes_on),
            WheelEvent::Duplicate => self.counters.duplicate_odometry += 1,
            WheelEvent::Reset => self.counters.odometry_resets += 1,
        }
    }

    /// Takes a reading of the IMU.
    pub fn add_heading(&mut self, reading: HeadingReading) {
        self.waited_in_vain = false;
        self.sources.push_heading(reading);
    }

    /// Takes where another node's transforms say the base is.
    pub fn add_transform_sample(&mut self, sample: WheelSample) {
        self.waited_in_vain = false;
        self.sources.push_transform(sample);
    }

    /// Takes the velocity of the base as it is now.
    pub fn set_velocity(&mut self, twist: Twist2) {
        if let Some(last) = self.last {
            self.sources.set_velocity(last.stamp, twist);
        }
    }

    /// Whether a scan of this stamp is better answered when the next odometry message has come.
    pub fn awaits_odometry(&self, stamp: Stamp) -> bool {
        !self.waited_in_vain && self.sources.is_behind(stamp)
    }

    /// The answer for a scan: where the base was when it was taken, whatever time it takes to find out. `base_from_laser` is the laser's
    /// place on the base.
    ///
    /// ```
    /// use anytime_scan_matcher::geometry::Pose2;
    /// use anytime_scan_matcher::matching::{MatchingKnobs, rejection::RejectionKnobs};
    /// use anytime_scan_matcher::odometry::{LaserOdometry, OdometryKnobs};
    /// use anytime_scan_matcher::scan::{BeamGeometry, Scan};
    /// use anytime_scan_matcher::time::Stamp;
    ///
    /// // What a laser sees that drives at 1 m/s in a room of 6 m by 4 m.
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
    ///     let answer = odometry.register(&scan(0.05 * f64::from(i)).unwrap(), &Pose2::IDENTITY);
    ///     assert!((answer.odom_from_base.x - 0.05 * f64::from(i)).abs() < 0.01);
    /// }
    /// ```
    pub fn register(&mut self, scan: &Scan, base_from_laser: &Pose2) -> Registration {
        let (clock, mut costs) = (VirtualClock::new(Duration::ZERO), CostModel::new(0.5));
        let task = Task { contract: Contract::default(), arrival: Duration::ZERO, taken_up: Duration::ZERO };
        self.register_within(scan, base_from_laser, &mut Driver::new(task, &clock, &Never, &mut costs))
    }

    /// The same within a contract: the best answer there is when `driver` says that time is up, or that it is good enough.
    pub fn register_within(&mut self, scan: &Scan, base_from_laser: &Pose2, driver: &mut Driver) -> Registration {
        self.maintain();
        self.matched_points = None;
        self.iterations.clear();
        if let Some(answer) = self.answer_by_stamp(scan.stamp()) {
            return answer;
        }
        let undistorted = self.undistorted(scan, base_from_laser);
        let scan = undistorted.as_ref().unwrap_or(scan);
        if let Some(answer) = self.answer_at_set_pose(scan, base_from_laser) {
            return answer;
        }
        let Some(last) = self.last else { return self.answer_first(scan, base_from_laser, self.start, PoseCovariance::zeros()) };
        let mut attempt = self.attempt(&last, scan.stamp(), base_from_laser);
        let Some(keyframe) = self.keyframe else {
            let (map_from_base, covariance) = attempt.predicted_base();
            return self.answer_first(scan, base_from_laser, map_from_base, covariance);
        };
        let Some(keyframe) = self.keyframe_seen_by(scan, keyframe, &attempt) else {
            return self.answer_unseen(scan, &attempt);
        };
        let first_guess = keyframe.map_from_laser.between(&attempt.predicted_laser());
        let mut found = self.match_to(&keyframe, scan, &attempt, first_guess, driver);
        if let Some((set_forward, fits)) = self.match_where_the_clock_was_set(&keyframe, scan, &attempt, &found, driver) {
            (attempt, found) = (set_forward, fits);
        }
        let becomes_keyframe = self.wants_keyframe(&found.keyframe_from_laser);
        let worth_finishing = match found.report.stop_reason {
            StopReason::Budget | StopReason::Interrupted => true,
            // Good enough for itself, but the errors of keyframes add up.
            StopReason::ErrorBound => becomes_keyframe,
            _ => false,
        };
        if !worth_finishing
            && self.is_reference_refuted(&attempt, &found, scan.stamp())
            && let Some(answer) = self.replace_reference(scan, &attempt, &found)
        {
            return answer;
        }
        if worth_finishing {
            self.unfinished = Some((scan.clone(), attempt, found.keyframe_from_laser));
        } else {
            self.judge_sources(&attempt, &found, scan.stamp());
        }
        match found.answer {
            Ok(answer) => self.conclude(scan, base_from_laser, answer, becomes_keyframe),
            Err(problem) => {
                // Where there was no time to match, or another laser took it, nothing speaks against the keyframe.
                let no_time = found.report.iterations == 0 && !found.report.stop_reason.is_failure();
                let is_lost = !no_time && is_same_mount(&keyframe.base_from_laser, base_from_laser);
                self.answer_predicted(scan, &attempt, Some(found.report), problem, becomes_keyframe || !no_time, is_lost)
            }
        }
    }

    /// The scan without the distortion by the motion during its sweep, where there is any: at the velocity of the wheels, else of the
    /// last answers.
    pub fn undistorted(&self, scan: &Scan, base_from_laser: &Pose2) -> Option<Scan> {
        let sweep = Sweep::of(scan, &self.knobs)?;
        let (start, end) = sweep.span(scan.stamp());
        let by_wheels = self.sources.motion(start, end).filter(|_| !self.noise.odometry.is_disbelieved());
        let motion = by_wheels.or_else(|| Some(self.last?.mean_twist.motion(sweep.seconds())))?;
        Some(sweep.straightened(scan, base_from_laser, &motion))
    }

    /// Finishes the match of the last scan, if its answer had to be given before: what follows is predicted from the better pose.
    pub fn finish(&mut self, driver: &mut Driver) {
        let (Some((scan, attempt, reached)), Some(keyframe)) = (self.unfinished.take(), self.keyframe) else { return };
        let found = self.match_to(&keyframe, &scan, &attempt, reached, driver);
        if self.is_reference_refuted(&attempt, &found, scan.stamp()) {
            self.replace_reference(&scan, &attempt, &found);
            return;
        }
        self.judge_sources(&attempt, &found, scan.stamp());
        let becomes_keyframe = self.wants_keyframe(&found.keyframe_from_laser);
        if let Ok(answer) = found.answer {
            // As if this had been the answer; a keyframe stays one.
            let was_keyframe = self.upcoming_keyframe.take().is_some();
            self.counters.keyframes -= u64::from(was_keyframe);
            self.counters.finished_later += 1;
            self.last = Some(attempt.last);
            self.conclude(&scan, &attempt.base_from_laser, answer, becomes_keyframe || was_keyframe);
        }
    }

    /// A match where the robot has hardly moved, of a scan that comes later than usual, where that fits decidedly better than where the
    /// velocity leads in that time: the clock was set forward, and the robot has driven on for no longer than from any scan to the next.
    /// Odometry would know.
    fn match_where_the_clock_was_set(
        &mut self,
        keyframe: &Placement,
        scan: &Scan,
        attempt: &Attempt,
        found: &Found,
        driver: &mut Driver,
    ) -> Option<(Attempt, Found)> {
        let is_done = !matches!(found.report.stop_reason, StopReason::Budget | StopReason::Interrupted)
            && found.answer.as_ref().err().is_none_or(|failure| failure.reason.is_no_fit());
        let seconds = scan.stamp().seconds_since(attempt.last.stamp);
        let came_late = self.usual_period > 0.0 && seconds > LATE_BY_PERIODS * self.usual_period;
        if attempt.said.is_some() || !came_late || !is_done {
            return None;
        }
        let last = Last { stamp: scan.stamp().offset_by(-self.usual_period), ..attempt.last };
        let expected = last.motion.expect(self.usual_period).prediction();
        let attempt = Attempt { last, expected, prediction: expected, said_turn: None, ..*attempt };
        let first_guess = keyframe.map_from_laser.between(&attempt.predicted_laser());
        let shown = (std::mem::take(&mut self.iterations), self.matched_points.take());
        let fits = self.match_to(keyframe, scan, &attempt, first_guess, driver);
        let is_better = found.answer.is_err() || fits.agreement > found.agreement.map(|agreement| agreement + USUAL_VARIATION);
        if fits.answer.is_err() || !is_better {
            (self.iterations, self.matched_points) = shown;
            return None;
        }
        self.counters.clock_steps += 1;
        self.last = Some(last);
        Some((attempt, fits))
    }

    /// Matches a scan to the keyframe, from `start` on.
    fn match_to(&mut self, keyframe: &Placement, scan: &Scan, attempt: &Attempt, start: Pose2, driver: &mut Driver) -> Found {
        let none = PoseCovariance::zeros();
        let guess =
            FirstGuess { pose: start, prior: Some(attempt.prior(keyframe, &none)), window: attempt.window(self.usual_agreement) };
        let mut refinement = self.matcher.begin(scan, guess);
        let stop_reason = driver.drive(&mut refinement);
        self.iterations.clear();
        self.iterations.extend_from_slice(refinement.trace());
        let uncertainty = refinement.uncertainty();
        let agreement = refinement.agreement();
        if let Some(agreement) = agreement {
            self.usual_agreement += USUAL_WEIGHT * (agreement - self.usual_agreement);
        }
        let keyframe_from_laser = refinement.pose();
        let base_heading = keyframe_from_laser.theta - attempt.base_from_laser.theta;
        let report = report(&refinement, stop_reason, uncertainty.as_ref(), base_heading);
        let match_covariance = uncertainty.and_then(|known| known.covariance);
        let estimated_error = estimated_error(&refinement, match_covariance.as_ref());
        if self.keep_matched_points {
            self.matched_points = Some(matched_points(&refinement, &self.views, &keyframe.map_from_laser));
        }
        let map_from_laser = keyframe.map_from_laser * keyframe_from_laser;
        let correction = attempt.predicted_laser().between(&map_from_laser);
        if let Some(problem) = problem(&report, &correction, &self.knobs) {
            return Found { report, keyframe_from_laser, agreement, answer: Err(problem) };
        }
        let alike = uncertainty::rays_alike(scan, report.rays_used);
        let doubt = self.doubt(keyframe, attempt, &map_from_laser, scan.stamp());
        let answer = Answer::matched(attempt, keyframe, &keyframe_from_laser, uncertainty.as_ref(), alike, &doubt);
        Found {
            keyframe_from_laser,
            agreement,
            answer: Ok(Answer { estimated_error, refinement: Some(report), ..answer }),
            report,
        }
    }

    /// What is doubtful of a match that has found the laser at `map_from_laser`: by odometry, and by how a robot can move.
    fn doubt(&self, keyframe: &Placement, attempt: &Attempt, map_from_laser: &Pose2, stamp: Stamp) -> Doubt {
        let map_from_base = *map_from_laser * attempt.base_from_laser.inverse();
        let last = &attempt.last.map_from_base;
        let step = last.between(&map_from_base);
        let doubt =
            Doubt::of_step(self.noise.odometry, attempt.said.as_ref(), &step).against(&attempt.expected, &step, last.theta);
        let Approach { stamp: since, keyframe_from_base } = self.approach;
        let Some(motion) = self.sources.motion_without_imu(since, stamp) else {
            return Doubt { is_contradiction: false, ..doubt };
        };
        let covariance = uncertainty::of_wheels(&motion, stamp.seconds_since(since));
        let start = keyframe.map_from_laser * keyframe_from_base;
        doubt.against(&Prediction { motion, covariance }, &start.between(&map_from_base), start.theta)
    }

    /// Work that can wait until an answer is out: prepares the reference of the next scans. [`Self::register_within`] does it otherwise.
    pub fn maintain(&mut self) {
        self.unfinished = None;
        let keeps_map = self.knobs.reference == ReferenceChoice::LocalMap;
        let upcoming = self.upcoming_keyframe.take();
        let changes = upcoming.is_some() || keeps_map;
        if let Some(UpcomingKeyframe { scan, place, is_lost }) = upcoming {
            let most = if keeps_map { self.knobs.max_keyframes } else { 1 };
            self.map.add(place, self.matcher.view(scan), is_lost, most as usize);
            self.map.forget_moved();
            self.to_be_recognised = keeps_map && self.knobs.close_loops;
        }
        if changes {
            self.choose_views();
        }
    }

    /// The next scan is matched to the keyframes around the last one.
    fn choose_views(&mut self) {
        if let Some(last) = self.last {
            self.choose_views_around(&last, &last.map_from_laser, None);
        }
    }

    /// The keyframe to match a scan to: the one chosen around the last scan, unless this one is of a laser elsewhere on the base, as when two
    /// take turns. `None`: none has looked where it does.
    fn keyframe_seen_by(&mut self, scan: &Scan, chosen: Placement, attempt: &Attempt) -> Option<Placement> {
        let predicted = attempt.predicted_laser();
        if !is_same_mount(&attempt.last.base_from_laser(), &attempt.base_from_laser) {
            self.choose_views_around(&attempt.last, &predicted, Some(scan));
        }
        let chosen = self.keyframe.unwrap_or(chosen);
        let turn = chosen.map_from_laser.theta - predicted.theta;
        let is_seen = self.views.first().is_some_and(|placed| scan.shares_view_with(placed.view.scan(), turn));
        is_seen.then_some(chosen)
    }

    /// A scan that looks where none has looked is answered by the prediction; others can be matched to it.
    fn answer_unseen(&mut self, scan: &Scan, attempt: &Attempt) -> Registration {
        self.counters.predicted += 1;
        let problem = Failure::new(
            FailureReason::TooFewCorrespondences,
            "it looks where no scan has looked before: there is nothing to match",
        );
        self.conclude(scan, &attempt.base_from_laser, Answer::predicted(attempt, problem), true)
    }

    fn choose_views_around(&mut self, last: &Last, map_from_laser: &Pose2, scan: Option<&Scan>) {
        let count = if self.knobs.reference == ReferenceChoice::LocalMap { self.knobs.views } else { 1 };
        let before = self.keyframe.map(|keyframe| keyframe.stamp);
        self.keyframe = self.map.views_around(map_from_laser, scan, count as usize, &mut self.views);
        if let Some(keyframe) = self.keyframe.filter(|keyframe| Some(keyframe.stamp) != before) {
            let keyframe_from_base = keyframe.map_from_laser.between(&last.map_from_base);
            self.approach = Approach { stamp: last.stamp, keyframe_from_base };
        }
        self.matcher.set_views(&self.views);
    }

    /// Compares the last keyframe with those of long ago that seem to be around, if it has not been done; puts the map right by what
    /// comes of it. The next scans are answered the better for it, but none needs to wait for it.
    pub fn close_loop(&mut self, driver: &mut Driver) {
        if !std::mem::take(&mut self.to_be_recognised) {
            return;
        }
        if let Some(recognised) = self.unrecognised() {
            let sighting = self.sight(&recognised, driver);
            match sighting.map(|sighting| self.loop_closer.judge(&sighting)) {
                // Again when there is more time.
                None => self.to_be_recognised = true,
                Some(None) => {}
                Some(Some(recognition)) => self.recognise(&recognised, &recognition),
            }
            self.choose_views();
        } else {
            self.loop_closer.forget();
        }
    }

    /// The keyframes to compare the last one with, as `views`; none while scans are matched to such keyframes anyway.
    fn unrecognised(&mut self) -> Option<Unrecognised> {
        let (place, _) = self.map.last().filter(|_| self.map.is_exploring())?;
        self.map.unrecognised_around(&place, self.knobs.views as usize, &mut self.views)
    }

    /// Matches the last keyframe to `views`, the first of which was taken at `earlier`; `None`: there was no time for it.
    fn sight(&mut self, earlier: &Unrecognised, driver: &mut Driver) -> Option<Sighting> {
        let (by_path, view) = self.map.last()?;
        self.matcher.set_views(&self.views);
        let pose = earlier.map_from_laser.between(&by_path);
        let guess = FirstGuess { pose, prior: None, window: loop_closure::window(self.map.free_way(earlier)) };
        let mut refinement = self.matcher.begin(view.scan(), guess);
        if driver.drive(&mut refinement) == StopReason::Interrupted {
            return None;
        }
        let condition_number = refinement.uncertainty().map_or(f64::INFINITY, |known| known.condition_number);
        let by_earlier = earlier.map_from_laser * refinement.pose();
        Some(Sighting { by_path, by_earlier, agreement: refinement.agreement().unwrap_or_default(), condition_number })
    }

    fn recognise(&mut self, earlier: &Unrecognised, recognition: &Recognition) {
        self.counters.closed_loops += 1;
        self.map.link(earlier);
        let Recognition::Drifted(correction) = recognition else { return };
        self.map.correct(earlier, correction);
        if let Some(last) = &mut self.last {
            // On the map the pose is known from there on as the earlier keyframe's is; in odom as it was.
            let odom_from_map = self.map_from_odom.inverse();
            let in_odom = uncertainty::compound(&odom_from_map, &self.drift_covariance, &last.map_from_base, &last.covariance);
            last.covariance = earlier.covariance;
            let way = odom_from_map.transform().rotate(last.map_from_base.translation());
            let drift = in_odom - uncertainty::turned(&last.covariance, odom_from_map.theta);
            self.drift_covariance = uncertainty::before_way(&uncertainty::positive(&drift), way);
            last.map_from_base = *correction * last.map_from_base;
            last.map_from_laser = *correction * last.map_from_laser;
        }
        self.map_from_odom = *correction * self.map_from_odom;
    }

    fn wants_keyframe(&self, keyframe_from_laser: &Pose2) -> bool {
        match self.knobs.reference {
            ReferenceChoice::Previous => true,
            ReferenceChoice::LocalMap | ReferenceChoice::Keyframe => {
                keyframe_from_laser.distance() > self.knobs.keyframe_distance
                    || keyframe_from_laser.theta.abs() > self.knobs.keyframe_angle
            }
        }
    }

    /// Scans that are not later than the last one are answered without a match.
    fn answer_by_stamp(&mut self, stamp: Stamp) -> Option<Registration> {
        let last = self.last?;
        let problem = match self.stamps.step(stamp, last.stamp, self.sources.last_wheel_stamp()) {
            Step::Forward => return None,
            Step::NewRun => {
                self.counters.time_jumps += 1;
                self.restart_at(self.knobs.initial_pose);
                return None;
            }
            Step::SetBack { last: stamp } => {
                self.counters.clock_steps += 1;
                self.last = Some(Last { stamp, ..last });
                return None;
            }
            Step::Same => {
                self.counters.duplicate_scans += 1;
                Failure::new(FailureReason::DuplicateStamp, "its stamp is that of the scan before: the same answer again")
            }
            Step::Late => {
                self.counters.out_of_order_scans += 1;
                let seconds = last.stamp.seconds_since(stamp);
                Failure::new(
                    FailureReason::OutOfOrder,
                    format!("its stamp is {seconds:.3} s before that of the last scan: out of order"),
                )
            }
        };
        self.counters.predicted += 1;
        let answer = self.registration(Outcome::Predicted(problem), last.map_from_base, &last.covariance);
        Some(Registration { twist: last.motion.twist, ..answer })
    }

    /// An answer of which no more is known than this, in terms of the map.
    fn registration(&self, outcome: Outcome, map_from_base: Pose2, covariance: &PoseCovariance) -> Registration {
        let odom_from_map = self.map_from_odom.inverse();
        Registration {
            outcome,
            odom_from_base: odom_from_map * map_from_base,
            map_from_odom: self.map_from_odom,
            covariance: uncertainty::compound(&odom_from_map, &self.drift_covariance, &map_from_base, covariance),
            twist: Twist2::default(),
            twist_covariance: PoseCovariance::zeros(),
            refinement: None,
            predicted_error: ErrorEstimate::UNKNOWN,
            estimated_error: ErrorEstimate::UNKNOWN,
            disbelieved: self.noise.disbelieved(),
            contradicts_odometry: false,
            new_keyframe: false,
        }
    }

    /// The first scan that others can be matched to.
    fn answer_first(
        &mut self,
        scan: &Scan,
        base_from_laser: &Pose2,
        map_from_base: Pose2,
        covariance: PoseCovariance,
    ) -> Registration {
        self.conclude(scan, base_from_laser, Answer::first(map_from_base, covariance), true)
    }

    /// The prediction as answer. `is_lost`: the scan could not be matched. It becomes the keyframe then: the one it was to be matched to
    /// must not be kept for ever.
    fn answer_predicted(
        &mut self,
        scan: &Scan,
        attempt: &Attempt,
        refinement: Option<RefinementReport>,
        problem: Failure,
        becomes_keyframe: bool,
        is_lost: bool,
    ) -> Registration {
        self.counters.predicted += 1;
        if is_lost
            && attempt.awaits_odometry
            && let Some(start) = &mut self.last
            && !std::mem::replace(&mut start.passed_over, true)
        {
            // What comes says better how the robot has moved: the next scan starts from where this one did.
            let twist = attempt.last.motion.expect(scan.stamp().seconds_since(attempt.last.stamp)).unseen().twist;
            let error = ErrorEstimate::of_covariance(&attempt.prediction.covariance);
            let (map_from_base, covariance) = attempt.predicted_base();
            return Registration { refinement, ..self.passing(problem, map_from_base, &covariance, (twist, error)) };
        }
        let answer = Answer { is_lost, refinement, ..Answer::predicted(attempt, problem) };
        self.conclude(scan, &attempt.base_from_laser, answer, becomes_keyframe)
    }

    /// An answer for a scan that could not be used at all, taken at `stamp`.
    pub fn answer_unusable(&mut self, stamp: Stamp, problem: Failure) -> Registration {
        self.maintain();
        self.matched_points = None;
        self.iterations.clear();
        self.counters.predicted += 1;
        // The stamp of such a scan may be as wrong as the rest of it: no run starts again by it.
        if let Some(last) = self.last.filter(|last| stamp <= last.stamp) {
            return self.passing(problem, last.map_from_base, &last.covariance, (last.motion.twist, ErrorEstimate::UNKNOWN));
        }
        let (map_from_base, covariance, prediction) = match self.last {
            Some(last) => (last.map_from_base, last.covariance, self.attempt(&last, stamp, &Pose2::IDENTITY).prediction),
            None => (self.start, PoseCovariance::zeros(), Prediction::NONE),
        };
        let Prediction { motion, covariance: motion_covariance } = prediction;
        let covariance = uncertainty::compound(&map_from_base, &covariance, &motion, &motion_covariance);
        let map_from_base = map_from_base * motion;
        let error = ErrorEstimate::of_covariance(&motion_covariance);
        let state = self.last.map_or_else(
            || MotionState::unknown(&covariance),
            |last| last.motion.expect(stamp.seconds_since(last.stamp)).unseen(),
        );
        let twist = state.twist;
        // The next scan's prediction starts from the last scan there was; where there was none, from here.
        if self.keyframe.is_none() && self.upcoming_keyframe.is_none() {
            self.last = Some(Last {
                stamp,
                map_from_base,
                map_from_laser: map_from_base,
                covariance,
                covariance_to_keyframe: PoseCovariance::zeros(),
                seen_twist: twist,
                mean_twist: twist,
                motion: state,
                passed_over: false,
            });
        }
        self.passing(problem, map_from_base, &covariance, (twist, error))
    }

    /// A prediction that the next scan does not start from.
    fn passing(
        &self,
        problem: Failure,
        map_from_base: Pose2,
        covariance: &PoseCovariance,
        (twist, error): (Twist2, ErrorEstimate),
    ) -> Registration {
        let answer = self.registration(Outcome::Predicted(problem), map_from_base, covariance);
        Registration { twist, predicted_error: error, estimated_error: error, ..answer }
    }

    /// What is known of the pose of a scan taken at `stamp`: the base has gone on as it did, and moved as the odometry says, each as far
    /// as it has been right lately.
    fn attempt(&mut self, last: &Last, stamp: Stamp, base_from_laser: &Pose2) -> Attempt {
        let awaits_odometry = self.awaits_odometry(stamp);
        self.waited_in_vain = self.sources.is_behind(stamp);
        let expected = last.motion.expect(stamp.seconds_since(last.stamp)).prediction();
        let said = self.sources.motion_without_imu(last.stamp, stamp);
        // Where stamps jitter, less time has passed by them than it took.
        let seconds = stamp.seconds_since(last.stamp).max(self.usual_period);
        let said = said.map(|motion| Prediction { motion, covariance: uncertainty::of_wheels(&motion, seconds) });
        let said_turn = self.sources.turn_by_imu(last.stamp, stamp);
        self.count_disbelieved(said.is_some());
        // Where nothing else is known, a velocity that was wrong is no worse than before: a robot that was carried off drives on.
        let fused = |said: Prediction| {
            let (said, expected) = (said.with_noise(self.noise.odometry), expected.with_noise(self.noise.velocity));
            let usually = last.motion.expect(self.usual_period.max(stamp.seconds_since(last.stamp))).prediction();
            said.doubted_by(&expected, &usually).and(&expected)
        };
        let known = said.map_or(expected, fused);
        self.sources.believe_imu(!self.noise.imu.is_disbelieved());
        let prediction = self.sources.with_heading(&known, last.stamp, stamp);
        Attempt { last: *last, prediction, expected, said, said_turn, awaits_odometry, base_from_laser: *base_from_laser }
    }

    fn count_disbelieved(&mut self, has_odometry: bool) {
        let Disbelieved { odometry, imu } = self.noise.disbelieved();
        self.counters.without_odometry += u64::from(!has_odometry);
        self.counters.odometry_disbelieved += u64::from(has_odometry && odometry);
        self.counters.imu_disbelieved += u64::from(imu);
    }

    /// What a match that is done makes of what each source said; a scan that was not matched says nothing.
    fn judge_sources(&mut self, attempt: &Attempt, found: &Found, stamp: Stamp) {
        let Ok(answer) = &found.answer else { return };
        self.counters.odometry_contradicted += u64::from(answer.contradicts_odometry && !self.noise.odometry.is_disbelieved());
        self.sources.learn_lag(stamp, self.map_from_odom.inverse() * answer.map_from_base);
        let motion = attempt.last.map_from_base.between(&answer.map_from_base);
        self.noise.velocity.judge(source_noise::deviation(&attempt.expected, &motion));
        if let Some(said) = &attempt.said {
            self.noise.odometry.judge(source_noise::deviation(said, &motion));
        }
        if let Some((turn, deviation)) = attempt.said_turn {
            self.noise.imu.judge(wrap_angle(motion.theta - turn).abs() / deviation);
        }
    }

    /// What the answer for a scan taken at `stamp` says of the velocity, and whether the robot can have come to it by driving: a pose that
    /// jumps, as when the robot is carried off, is no velocity unless it goes on like that.
    fn motion(&self, stamp: Stamp, answer: &Answer) -> (Twist2, MotionState, bool) {
        let Some(last) = self.last else { return (Twist2::default(), MotionState::unknown(&PoseCovariance::zeros()), true) };
        let seconds = stamp.seconds_since(last.stamp);
        let moved = last.map_from_base.between(&answer.map_from_base);
        let seen = Twist2::of_motion(&moved, seconds);
        let goes_on = [last.motion.twist, last.seen_twist].iter().any(|before| is_steady(before, &seen, seconds));
        let expected = last.motion.expect(seconds);
        let motion = match &answer.matched_covariance {
            Some(known) if goes_on => expected.found(&moved, known),
            Some(known) => expected.carried_off(known),
            None => expected.unseen(),
        };
        (seen, motion, goes_on)
    }

    fn conclude(&mut self, scan: &Scan, base_from_laser: &Pose2, answer: Answer, becomes_keyframe: bool) -> Registration {
        let (seen_twist, motion, goes_on) = self.motion(scan.stamp(), &answer);
        let is_lost = answer.is_lost || !goes_on;
        let mean_twist = self.last.filter(|_| !goes_on).map_or(seen_twist, |last| last.mean_twist);
        let seconds = self.last.map_or(0.0, |last| scan.stamp().seconds_since(last.stamp));
        let weight = if self.usual_period > 0.0 { USUAL_WEIGHT } else { 1.0 };
        self.usual_period += weight * (seconds - self.usual_period);
        self.usual_twist = self.usual_twist.towards(&motion.twist, (seconds / USUAL_TIME).clamp(0.0, 1.0));
        let becomes_keyframe = becomes_keyframe || is_lost;
        let map_from_laser = answer.map_from_base * *base_from_laser;
        if becomes_keyframe {
            self.counters.keyframes += 1;
            let covariance =
                uncertainty::compound(&answer.map_from_base, &answer.covariance, base_from_laser, &PoseCovariance::zeros());
            let (stamp, base_from_laser, step_covariance) = (scan.stamp(), *base_from_laser, answer.step_covariance);
            let place = Placement { stamp, map_from_laser, base_from_laser, covariance, step_covariance };
            self.upcoming_keyframe = Some(UpcomingKeyframe { scan: scan.clone(), place, is_lost });
        }
        self.last = Some(Last {
            stamp: scan.stamp(),
            map_from_base: answer.map_from_base,
            map_from_laser,
            covariance: answer.covariance,
            covariance_to_keyframe: if becomes_keyframe { PoseCovariance::zeros() } else { answer.covariance_to_keyframe },
            seen_twist,
            mean_twist,
            motion,
            passed_over: false,
        });
        Registration {
            twist: motion.twist,
            twist_covariance: motion.twist_covariance(),
            refinement: answer.refinement,
            predicted_error: answer.predicted_error,
            estimated_error: answer.estimated_error,
            contradicts_odometry: answer.contradicts_odometry,
            new_keyframe: becomes_keyframe,
            ..self.registration(answer.outcome, answer.map_from_base, &answer.covariance)
        }
    }
}

/// Whether two places on the base are those of one laser.
fn is_same_mount(one: &Pose2, other: &Pose2) -> bool {
    let moved = one.between(other);
    moved.distance() + moved.theta.abs() <= SAME_MOUNT
}

/// Whether a robot can come from one velocity to the other within `seconds`.
fn is_steady(before: &Twist2, after: &Twist2, seconds: f64) -> bool {
    let change = (after.vx - before.vx).hypot(after.vy - before.vy);
    let turn_change = (after.omega - before.omega).abs();
    let within = |change: f64, jump: f64, acceleration: f64| change * seconds < jump + acceleration * seconds * seconds;
    within(change, JUMP, MAX_ACCELERATION) && within(turn_change, TURN_JUMP, MAX_TURN_ACCELERATION)
}

/// How wrong each source of motion has been lately.
#[derive(Clone, Copy, Debug, Default)]
struct LearnedNoise {
    /// The robot going on as it did.
    velocity: SourceNoise,
    odometry: SourceNoise,
    imu: SourceNoise,
}

impl LearnedNoise {
    fn disbelieved(&self) -> Disbelieved {
        Disbelieved { odometry: self.odometry.is_disbelieved(), imu: self.imu.is_disbelieved() }
    }
}

/// Since when scans have been matched to the present keyframe before all others, and where the base was then, seen from it.
#[derive(Clone, Copy, Debug, Default)]
struct Approach {
    stamp: Stamp,
    keyframe_from_base: Pose2,
}

/// A scan that is to become a keyframe.
struct UpcomingKeyframe {
    scan: Scan,
    place: Placement,
    /// How the robot came here from the last keyframe is not known.
    is_lost: bool,
}
