//! Laser odometry: predict, match, keep the reference up to date.
//!
//! [`LaserOdometry::register`] is the whole of it. Frames: `odom` is where the poses are given, `base` is the robot, `laser` the
//! sensor, and the keyframe is the reference scan's laser.

pub mod heading;
mod local_map;
pub mod sources;
pub mod uncertainty;
pub mod wheel;

use crate::anytime::{Driver, ErrorEstimate, estimated_error};
use crate::geometry::{Point, Pose2, PoseCovariance, Twist2};
use crate::knobs::Seconds;
use crate::matching::rejection::RejectionKnobs;
use crate::matching::{
    FirstGuess, IterationTrace, Matcher, MatchingKnobs, PlacedView, Prior, Refinement, SearchWindow, StopReason,
};
use crate::scan::Scan;
use crate::time::Stamp;
use heading::HeadingReading;
use local_map::{Keyframe, LocalMap, Placement};
use sources::MotionSources;
use wheel::{WheelEvent, WheelSample};

/// Stamps that go back farther than this start a new run (a bag played in a loop); less is a scan out of order, s.
const NEW_RUN: f64 = 1.0;
/// A constant velocity predicts over gaps up to this, s.
const MAX_PREDICTION_GAP: f64 = 1.0;
/// The agreement of scans varies by this from one to the next.
const USUAL_VARIATION: f64 = 0.05;
/// Weight of the last scan in the usual agreement.
const USUAL_WEIGHT: f64 = 0.05;
/// A sweep that takes longer is a mistake of the driver, s.
const LONGEST_SWEEP: f64 = 1.0;
/// To either side of a predicted turn so much of it is searched.
const SEARCHED_PART_OF_TURN: f64 = 1.2;

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
        /// Keyframes that a scan is matched to at once, of those around; where it is matched to nearest points, to the first of them alone.
        views: u32 = 3, in 1 to 20;
        /// Keyframes of the local map at most; beyond, the oldest go. One takes 30 bytes per beam.
        max_keyframes: u32 = 1000, in 1 to 10000;
        /// A new keyframe after this way.
        keyframe_distance: f64 = 0.4, in 0 to 100, unit "m";
        /// A new keyframe after this turn.
        keyframe_angle: f64 = 0.35, in 0 to 4, unit "rad";
        /// Pose of the laser in the base frame, `[x, y, yaw]`; unset: from `/tf` or `/tf_static`, else the identity, with a warning.
        laser_in_base: Option<Pose2> = None, unit "m, m, rad";
        /// Whether to put rays that were taken one after the other where they belong.
        deskew: bool = true;
        /// Time from the first ray of a scan to the last, where the driver's `time_increment` does not say; unset: as it says.
        scan_duration: Option<Seconds> = None, in 0 to 1, unit "s";
        /// Pose of the base at the start, `[x, y, yaw]` in the odom frame.
        initial_pose: Pose2 = Pose2::IDENTITY, unit "m, m, rad";
        /// Longest wait for odometry that is more than 50 ms behind a scan; not longer than the time budget.
        max_wait: Seconds = Seconds(0.3), in 0 to 10, unit "s";
        /// A match that corrects the prediction by more than this is not believed.
        max_correction_distance: f64 = 1.0, in 0.01 to 100, unit "m";
        /// A match that turns the prediction by more than this is not believed.
        max_correction_angle: f64 = 0.8, in 0.01 to 4, unit "rad";
    }
}

/// How an answer came about.
#[derive(Clone, Debug, PartialEq)]
pub enum Outcome {
    /// By a match.
    Matched,
    /// First scan of a run: the pose is the one the run starts at.
    First,
    /// There was no match to be had; the pose is the prediction. Why, in words.
    Predicted(String),
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
    /// Pose of the base.
    pub odom_from_base: Pose2,
    /// Its covariance in the odom frame: grows along the way, as an odometry's does.
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
    /// Whether the scan becomes the reference of the next ones.
    pub new_keyframe: bool,
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
}

/// Matched points for display: sensed points moved to their place and their reference points, in the odom frame, m.
#[derive(Clone, Debug, Default)]
pub struct MatchedPoints {
    /// All points of the reference scan.
    pub reference: Vec<Point>,
    /// Sensed point and its partner.
    pub pairs: Vec<(Point, Point)>,
}

/// Events that are counted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct OdometryCounters {
    /// Keyframes so far.
    pub keyframes: u64,
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
    /// Wheel odometry messages with the stamp of the one before.
    pub duplicate_odometry: u64,
    /// Jumps of the wheel odometry.
    pub odometry_resets: u64,
    /// Scans whose motion the wheel odometry did not cover.
    pub without_odometry: u64,
}

/// The last answer.
#[derive(Clone, Copy, Debug)]
struct Last {
    stamp: Stamp,
    odom_from_base: Pose2,
    odom_from_laser: Pose2,
    covariance: PoseCovariance,
    twist: Twist2,
}

/// Laser odometry: scans and wheel odometry in, poses out.
pub struct LaserOdometry {
    knobs: OdometryKnobs,
    matcher: Matcher,
    wheels: MotionSources,
    /// A scan was answered before the odometry had come for it: it may have died, none is waited for until it is back.
    waited_in_vain: bool,
    map: LocalMap,
    views: Vec<PlacedView>,
    keyframe: Option<Placement>,
    upcoming_keyframe: Option<(Scan, Placement)>,
    /// The last scan, when its answer was given before its match was done, and the pose (in the keyframe) that it had come to.
    unfinished: Option<(Scan, Attempt, Pose2)>,
    last: Option<Last>,
    usual_agreement: f64,
    start: Pose2,
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
            matcher: Matcher::new(matching, rejection),
            wheels: MotionSources::default(),
            waited_in_vain: false,
            map: LocalMap::default(),
            views: Vec::new(),
            keyframe: None,
            upcoming_keyframe: None,
            unfinished: None,
            last: None,
            usual_agreement: 1.0,
            start: knobs.initial_pose,
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

    /// What each iteration of the last match did; empty where there was none for the last answer.
    pub fn iterations(&self) -> &[IterationTrace] {
        &self.iterations
    }

    /// Another limit of the iterations of one match.
    pub fn set_max_iterations(&mut self, limit: u32) {
        self.matcher.set_max_iterations(limit);
    }

    /// Starts again: the next scan is the first one, at `odom_from_base`.
    pub fn restart_at(&mut self, odom_from_base: Pose2) {
        self.forget_reference();
        self.usual_agreement = 1.0;
        self.last = None;
        self.start = odom_from_base;
    }

    /// Starts again at the initial pose, with nothing known.
    pub fn reset(&mut self) {
        self.restart_at(self.knobs.initial_pose);
        self.wheels.clear();
    }

    /// The laser has moved on the base: the next scan becomes a keyframe where the base is.
    pub fn forget_reference(&mut self) {
        self.unfinished = None;
        self.keyframe = None;
        self.map.clear();
        self.upcoming_keyframe = None;
    }

    /// Takes a message of wheel odometry.
    pub fn add_wheel_sample(&mut self, sample: WheelSample) {
        self.waited_in_vain = false;
        match self.wheels.push(sample) {
            WheelEvent::Appended | WheelEvent::TimeJump => {}
            WheelEvent::Duplicate => self.counters.duplicate_odometry += 1,
            WheelEvent::Reset => self.counters.odometry_resets += 1,
        }
    }

    /// Takes a reading of the IMU.
    pub fn add_heading(&mut self, reading: HeadingReading) {
        self.waited_in_vain = false;
        self.wheels.push_heading(reading);
    }

    /// Takes where another node's transforms say the base is.
    pub fn add_transform_sample(&mut self, sample: WheelSample) {
        self.waited_in_vain = false;
        self.wheels.push_transform(sample);
    }

    /// Takes the velocity of the base as it is now.
    pub fn set_velocity(&mut self, twist: Twist2) {
        if let Some(last) = self.last {
            self.wheels.set_velocity(last.stamp, twist);
        }
    }

    /// Whether a scan of this stamp is better answered when the next odometry message has come.
    pub fn awaits_odometry(&self, stamp: Stamp) -> bool {
        !self.waited_in_vain && self.wheels.is_behind(stamp)
    }

    /// The answer for a scan: where the base was when it was taken. `base_from_laser` is the laser's place on the base.
    pub fn register(&mut self, scan: &Scan, base_from_laser: &Pose2, driver: &mut Driver) -> Registration {
        self.maintain();
        self.matched_points = None;
        self.iterations.clear();
        if let Some(answer) = self.answer_by_stamp(scan.stamp()) {
            return answer;
        }
        let undistorted = self.undistorted(scan, base_from_laser);
        let scan = undistorted.as_ref().unwrap_or(scan);
        let Some(last) = self.last else { return self.answer_first(scan, base_from_laser) };
        let prediction = self.predict(&last, scan.stamp());
        let attempt = Attempt { last, prediction, base_from_laser: *base_from_laser };
        let Some(keyframe) = self.keyframe else {
            return self.answer_predicted(scan, &attempt, None, "no reference scan".into(), true);
        };
        let first_guess = keyframe.odom_from_laser.between(&attempt.predicted_laser());
        let found = self.match_to(&keyframe, scan, &attempt, first_guess, driver);
        let becomes_keyframe = self.wants_keyframe(&found.keyframe_from_laser);
        let worth_finishing = match found.report.stop_reason {
            StopReason::Budget | StopReason::Interrupted => true,
            // Good enough for itself, but the errors of keyframes add up.
            StopReason::ErrorBound => becomes_keyframe,
            _ => false,
        };
        if worth_finishing {
            self.unfinished = Some((scan.clone(), attempt, found.keyframe_from_laser));
        }
        match found.answer {
            Ok(answer) => self.conclude(scan, base_from_laser, answer, becomes_keyframe),
            Err(problem) => {
                // Where there was no time to match, nothing speaks against the keyframe.
                let no_time = found.report.iterations == 0 && !found.report.stop_reason.is_failure();
                self.answer_predicted(scan, &attempt, Some(found.report), problem, becomes_keyframe || !no_time)
            }
        }
    }

    /// The scan without the distortion by the motion during its sweep, where there is any: at the velocity of the wheels, else of the
    /// last answers.
    fn undistorted(&self, scan: &Scan, base_from_laser: &Pose2) -> Option<Scan> {
        let seconds = self.knobs.scan_duration.map_or(scan.sweep_duration(), |duration| duration.0);
        if !self.knobs.deskew || seconds <= 0.0 || seconds > LONGEST_SWEEP {
            return None;
        }
        let by_wheels = self.wheels.motion(scan.stamp(), scan.stamp().offset_by(seconds));
        let motion = by_wheels.or_else(|| Some(self.last?.twist.motion(seconds)))?;
        let laser_motion = base_from_laser.inverse() * motion * *base_from_laser;
        Some(scan.undistorted(&Twist2::of_motion(&laser_motion, seconds), seconds))
    }

    /// Finishes the match of the last scan, if its answer had to be given before: what follows is predicted from the better pose.
    pub fn finish(&mut self, driver: &mut Driver) {
        let (Some((scan, attempt, reached)), Some(keyframe)) = (self.unfinished.take(), self.keyframe) else { return };
        let found = self.match_to(&keyframe, &scan, &attempt, reached, driver);
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
        let guess =
            FirstGuess { pose: start, prior: Some(attempt.prior(keyframe)), window: attempt.window(self.usual_agreement) };
        let mut refinement = self.matcher.begin(scan, guess);
        let stop_reason = driver.drive(&mut refinement);
        self.iterations.clear();
        self.iterations.extend_from_slice(refinement.trace());
        let uncertainty = refinement.uncertainty();
        if let Some(agreement) = refinement.agreement() {
            self.usual_agreement += USUAL_WEIGHT * (agreement - self.usual_agreement);
        }
        let report = report(&refinement, stop_reason, uncertainty.map(|known| known.condition_number));
        let keyframe_from_laser = refinement.pose();
        let match_covariance = uncertainty.and_then(|known| known.covariance);
        let estimated_error = estimated_error(&refinement, match_covariance.as_ref());
        if self.keep_matched_points {
            self.matched_points = Some(matched_points(&refinement, &self.views, &keyframe.odom_from_laser));
        }
        let odom_from_laser = keyframe.odom_from_laser * keyframe_from_laser;
        let correction = attempt.predicted_laser().between(&odom_from_laser);
        if let Some(problem) = problem(&report, &correction, &self.knobs) {
            return Found { report, keyframe_from_laser, answer: Err(problem) };
        }
        // Where the scans leave a direction open, what is known of it is the prediction.
        let prediction_covariance = attempt.prediction.covariance;
        let match_covariance = match_covariance.unwrap_or(prediction_covariance);
        let laser_covariance =
            uncertainty::compound(&keyframe.odom_from_laser, &keyframe.covariance, &keyframe_from_laser, &match_covariance);
        let laser_from_base = attempt.base_from_laser.inverse();
        let answer = Answer {
            outcome: Outcome::Matched,
            odom_from_base: odom_from_laser * laser_from_base,
            covariance: uncertainty::compound(&odom_from_laser, &laser_covariance, &laser_from_base, &PoseCovariance::zeros()),
            step_covariance: match_covariance,
            refinement: Some(report),
            predicted_error: ErrorEstimate::of_covariance(&prediction_covariance),
            estimated_error,
        };
        Found { report, keyframe_from_laser, answer: Ok(answer) }
    }

    /// Work that can wait until an answer is out: prepares the reference of the next scans. [`Self::register`] does it otherwise.
    pub fn maintain(&mut self) {
        self.unfinished = None;
        let keeps_map = self.knobs.reference == ReferenceChoice::LocalMap;
        let upcoming = self.upcoming_keyframe.take();
        let changes = upcoming.is_some() || keeps_map;
        if let Some((scan, place)) = upcoming {
            let most = if keeps_map { self.knobs.max_keyframes } else { 1 };
            self.map.add(Keyframe { place, view: self.matcher.view(scan) }, most as usize);
        }
        if changes {
            self.choose_views();
        }
    }

    /// The next scan is matched to the keyframes around the last one.
    fn choose_views(&mut self) {
        let Some(last) = self.last else { return };
        let count = if self.knobs.reference == ReferenceChoice::LocalMap { self.knobs.views } else { 1 };
        self.keyframe = self.map.views_around(&last.odom_from_laser, count as usize, &mut self.views);
        self.matcher.set_views(&self.views);
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
        let seconds = stamp.seconds_since(last.stamp);
        if seconds > 0.0 {
            return None;
        }
        if seconds < -NEW_RUN {
            self.counters.time_jumps += 1;
            self.restart_at(self.knobs.initial_pose);
            return None;
        }
        let problem = if seconds == 0.0 {
            self.counters.duplicate_scans += 1;
            "its stamp is that of the scan before: the same answer again".into()
        } else {
            self.counters.out_of_order_scans += 1;
            format!("its stamp is {:.3} s before that of the last scan: out of order", -seconds)
        };
        self.counters.predicted += 1;
        Some(Registration {
            outcome: Outcome::Predicted(problem),
            odom_from_base: last.odom_from_base,
            covariance: last.covariance,
            twist: last.twist,
            twist_covariance: PoseCovariance::zeros(),
            refinement: None,
            predicted_error: ErrorEstimate::UNKNOWN,
            estimated_error: ErrorEstimate::UNKNOWN,
            new_keyframe: false,
        })
    }

    fn answer_first(&mut self, scan: &Scan, base_from_laser: &Pose2) -> Registration {
        let answer = Answer {
            outcome: Outcome::First,
            odom_from_base: self.start,
            covariance: PoseCovariance::zeros(),
            step_covariance: PoseCovariance::zeros(),
            refinement: None,
            predicted_error: ErrorEstimate::default(),
            estimated_error: ErrorEstimate::default(),
        };
        self.conclude(scan, base_from_laser, answer, true)
    }

    /// The prediction as answer. A scan that could not be matched becomes the keyframe: the one it was to be matched to must not be
    /// kept for ever.
    fn answer_predicted(
        &mut self,
        scan: &Scan,
        attempt: &Attempt,
        refinement: Option<RefinementReport>,
        problem: String,
        becomes_keyframe: bool,
    ) -> Registration {
        let Attempt { last, prediction: Prediction { motion, covariance }, base_from_laser } = attempt;
        self.counters.predicted += 1;
        let error = ErrorEstimate::of_covariance(covariance);
        let answer = Answer {
            outcome: Outcome::Predicted(problem),
            odom_from_base: last.odom_from_base * *motion,
            covariance: uncertainty::compound(&last.odom_from_base, &last.covariance, motion, covariance),
            step_covariance: *covariance,
            refinement,
            predicted_error: error,
            estimated_error: error,
        };
        self.conclude(scan, base_from_laser, answer, becomes_keyframe)
    }

    /// An answer for a scan that could not be used at all, taken at `stamp`.
    pub fn answer_unusable(&mut self, stamp: Stamp, problem: String) -> Registration {
        self.maintain();
        self.matched_points = None;
        self.iterations.clear();
        if let Some(answer) = self.answer_by_stamp(stamp) {
            return answer;
        }
        self.counters.predicted += 1;
        let (odom_from_base, covariance, prediction) = match self.last {
            Some(last) => (last.odom_from_base, last.covariance, self.predict(&last, stamp)),
            None => (self.start, PoseCovariance::zeros(), Prediction::NONE),
        };
        let Prediction { motion, covariance: motion_covariance } = prediction;
        // The last answer stays as it is: the next scan's prediction starts from the last scan there was.
        Registration {
            outcome: Outcome::Predicted(problem),
            odom_from_base: odom_from_base * motion,
            covariance: uncertainty::compound(&odom_from_base, &covariance, &motion, &motion_covariance),
            twist: self.last.map(|last| last.twist).unwrap_or_default(),
            twist_covariance: PoseCovariance::zeros(),
            refinement: None,
            predicted_error: ErrorEstimate::of_covariance(&motion_covariance),
            estimated_error: ErrorEstimate::of_covariance(&motion_covariance),
            new_keyframe: false,
        }
    }

    /// The motion of the base since the last answer: by what says so, else at constant velocity.
    fn predict(&mut self, last: &Last, stamp: Stamp) -> Prediction {
        self.waited_in_vain = self.wheels.is_behind(stamp);
        let (motion, covariance) = if let Some(motion) = self.wheels.motion(last.stamp, stamp) {
            (motion, uncertainty::of_wheels(&motion))
        } else {
            self.counters.without_odometry += 1;
            let seconds = stamp.seconds_since(last.stamp);
            let motion = if seconds <= MAX_PREDICTION_GAP { last.twist.motion(seconds) } else { Pose2::IDENTITY };
            (motion, uncertainty::of_constant_velocity(seconds))
        };
        let (motion, covariance) = self.wheels.with_heading(motion, covariance, last.stamp, stamp);
        Prediction { motion, covariance }
    }

    fn conclude(&mut self, scan: &Scan, base_from_laser: &Pose2, answer: Answer, becomes_keyframe: bool) -> Registration {
        if becomes_keyframe {
            self.counters.keyframes += 1;
            let odom_from_laser = answer.odom_from_base * *base_from_laser;
            let covariance =
                uncertainty::compound(&answer.odom_from_base, &answer.covariance, base_from_laser, &PoseCovariance::zeros());
            self.upcoming_keyframe = Some((scan.clone(), Placement { odom_from_laser, covariance }));
        }
        let seconds = self.last.map(|last| scan.stamp().seconds_since(last.stamp));
        let twist = match (self.last, seconds) {
            (Some(last), Some(seconds)) => Twist2::of_motion(&last.odom_from_base.between(&answer.odom_from_base), seconds),
            _ => Twist2::default(),
        };
        let twist_covariance =
            seconds.map_or_else(PoseCovariance::zeros, |seconds| answer.step_covariance * 2.0 / (seconds * seconds));
        self.last = Some(Last {
            stamp: scan.stamp(),
            odom_from_base: answer.odom_from_base,
            odom_from_laser: answer.odom_from_base * *base_from_laser,
            covariance: answer.covariance,
            twist,
        });
        Registration {
            outcome: answer.outcome,
            odom_from_base: answer.odom_from_base,
            covariance: answer.covariance,
            twist,
            twist_covariance,
            refinement: answer.refinement,
            predicted_error: answer.predicted_error,
            estimated_error: answer.estimated_error,
            new_keyframe: becomes_keyframe,
        }
    }
}

/// What [`LaserOdometry::conclude`] turns into a [`Registration`].
struct Answer {
    outcome: Outcome,
    odom_from_base: Pose2,
    covariance: PoseCovariance,
    step_covariance: PoseCovariance,
    refinement: Option<RefinementReport>,
    predicted_error: ErrorEstimate,
    estimated_error: ErrorEstimate,
}

/// A motion of the base that is expected, seen from its start.
#[derive(Clone, Copy)]
struct Prediction {
    motion: Pose2,
    covariance: PoseCovariance,
}

impl Prediction {
    const NONE: Self =
        Self { motion: Pose2::IDENTITY, covariance: PoseCovariance::new(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0) };
}

/// A scan to be matched.
#[derive(Clone, Copy)]
struct Attempt {
    /// The answer before.
    last: Last,
    /// Motion of the base since then.
    prediction: Prediction,
    base_from_laser: Pose2,
}

impl Attempt {
    /// Covariance of the predicted pose of the laser in the keyframe's frame.
    fn prior(&self, keyframe: &Placement) -> Prior {
        let none = PoseCovariance::zeros();
        let keyframe_from_last = keyframe.odom_from_laser.between(&self.last.odom_from_base);
        let Prediction { motion, covariance } = &self.prediction;
        let keyframe_from_base = keyframe_from_last * *motion;
        let of_base = uncertainty::compound(&keyframe_from_last, &none, motion, covariance);
        Prior {
            pose: keyframe_from_base * self.base_from_laser,
            covariance: uncertainty::compound(&keyframe_from_base, &of_base, &self.base_from_laser, &none),
        }
    }

    /// Where to search, and when: the more the robot has turned, the less is known of how far. Where scans never agree as in a room,
    /// outdoors, less than usual is a sign.
    fn window(&self, usual_agreement: f64) -> SearchWindow {
        let (turn, window) = (self.prediction.motion.theta.abs(), SearchWindow::default());
        let less_than_usual = (usual_agreement - USUAL_VARIATION).min(window.doubtful_agreement);
        SearchWindow {
            angle: window.angle.max(SEARCHED_PART_OF_TURN * turn),
            doubtful_agreement: if turn > window.angle { f64::INFINITY } else { less_than_usual },
            ..window
        }
    }

    fn predicted_laser(&self) -> Pose2 {
        self.last.odom_from_base * self.prediction.motion * self.base_from_laser
    }
}

/// What came of an attempt.
struct Found {
    report: RefinementReport,
    keyframe_from_laser: Pose2,
    /// The answer, or why there is none, in words.
    answer: Result<Answer, String>,
}

fn report(refinement: &Refinement, stop_reason: StopReason, condition_number: Option<f64>) -> RefinementReport {
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
        condition_number: condition_number.unwrap_or(f64::INFINITY),
    }
}

/// Why the pose reached is not to be believed, if so.
fn problem(report: &RefinementReport, correction: &Pose2, knobs: &OdometryKnobs) -> Option<String> {
    let stop_reason = report.stop_reason;
    if stop_reason.is_failure() {
        return Some(match stop_reason {
            StopReason::Singular => "the correspondences determine no pose".into(),
            _ => format!("too few correspondences: the scan of {} rays does not fit the reference", report.rays),
        });
    }
    if report.iterations == 0 {
        return Some(match stop_reason {
            StopReason::Interrupted => "the answer was called for before the first iteration".into(),
            _ => "the time budget leaves no time for an iteration".into(),
        });
    }
    if correction.distance() > knobs.max_correction_distance || correction.theta.abs() > knobs.max_correction_angle {
        return Some(format!(
            "the match corrects the prediction by {:.2} m and {:.1} degrees: more than max_correction_distance or max_correction_angle",
            correction.distance(),
            correction.theta.abs().to_degrees()
        ));
    }
    None
}

fn matched_points(refinement: &Refinement, views: &[PlacedView], odom_from_keyframe: &Pose2) -> MatchedPoints {
    let transform = odom_from_keyframe.transform();
    let mut pairs = Vec::new();
    refinement.matched_points(&mut pairs);
    for (p, q) in &mut pairs {
        (*p, *q) = (transform.apply(*p), transform.apply(*q));
    }
    let points = |placed: &PlacedView| {
        let transform = (*odom_from_keyframe * placed.reference_from_view).transform();
        placed.view.points().map(move |p| transform.apply(p)).collect::<Vec<_>>()
    };
    MatchedPoints { reference: views.iter().flat_map(points).collect(), pairs }
}
