//! Laser odometry: predict, match, keep the reference up to date.
//!
//! [`LaserOdometry::register_within`] is the whole of it. Frames: `map` is where the keyframes are, and drifts as little as they let it;
//! `odom` is where the pose never jumps (REP 105); `base` is the robot, `laser` the sensor, and the keyframe is the reference scan's
//! laser. When a place is recognised, map and odom part: [`Registration::map_from_odom`].

mod answer;
mod attempt;
mod clock_step;
mod counters;
mod doubt;
mod drift;
pub mod heading;
mod keyframes;
mod known_motion;
mod lag;
mod local_map;
mod loop_closure;
mod motion_state;
mod placement;
mod prediction;
mod recognition;
mod registration;
mod set_pose;
mod source_noise;
pub mod sources;
pub mod sweep;
pub mod uncertainty;
mod unmatched;
pub mod wheel;

use std::time::Duration;

use crate::anytime::clock::VirtualClock;
use crate::anytime::contract::Contract;
use crate::anytime::cost_model::CostModel;
use crate::anytime::interrupt::Never;
use crate::anytime::{Driver, ErrorEstimate, Task, estimated_error};
use crate::geometry::{Pose2, PoseCovariance, Twist2};
use crate::knobs::Seconds;
use crate::matching::classic::rejection::RejectionKnobs;
use crate::matching::{FirstGuess, IterationTrace, Matcher, MatchingKnobs, PlacedView, StopReason};
use crate::scan::Scan;
use crate::time::{Continuity, Stamp};
use crate::transforms::LaserPlace;
use answer::{Answer, Found, problem};
use attempt::{Attempt, Last};
pub use counters::{OdometryCounters, counted_in_words};
use doubt::Doubt;
use heading::HeadingReading;
use keyframes::{Approach, UpcomingKeyframe, is_same_mount};
use local_map::LocalMap;
use loop_closure::LoopCloser;
use motion_state::MotionState;
use placement::Placement;
use prediction::Prediction;
pub use registration::{Disbelieved, Failure, FailureReason, MatchedPoints, Outcome, RefinementReport, Registration};
use registration::{matched_points, report};
use set_pose::SetPose;
use source_noise::LearnedNoise;
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
    /// use anytime_scan_matcher::matching::{MatchingKnobs, classic::rejection::RejectionKnobs};
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
        if self.keyframe.is_none() {
            let (map_from_base, covariance) = attempt.predicted_base();
            return self.answer_first(scan, base_from_laser, map_from_base, covariance);
        }
        let Some(keyframe) = self.keyframe_seen_by(scan, &attempt) else {
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

/// Whether a robot can come from one velocity to the other within `seconds`.
fn is_steady(before: &Twist2, after: &Twist2, seconds: f64) -> bool {
    let change = (after.vx - before.vx).hypot(after.vy - before.vy);
    let turn_change = (after.omega - before.omega).abs();
    let within = |change: f64, jump: f64, acceleration: f64| change * seconds < jump + acceleration * seconds * seconds;
    within(change, JUMP, MAX_ACCELERATION) && within(turn_change, TURN_JUMP, MAX_TURN_ACCELERATION)
}
