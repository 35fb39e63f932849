//! The application: messages in, estimates out. The node and the offline tool run the same code, so that a replay repeats what
//! ran live.

mod answering;
mod heading;
mod initial_pose;
mod intake;
pub mod localizer;
pub mod map_message;
mod motion_by_scans;
mod report;
pub mod sensed;
mod warm_up;

use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use thiserror::Error;

use self::initial_pose::InitialPose;
use crate::anytime::clock::Clock;
use crate::anytime::contract::{BOUND_SIGMAS, Contract, ContractError};
use crate::anytime::cost_model::CostModel;
use crate::anytime::interrupt::{Interrupt, NeverInterrupt};
use crate::anytime::mode::{ConditionMonitor, Conditions, OutOfRange};
use crate::anytime::{ContractRunner, ErrorEstimate};
use crate::config::{Config, FrameKnobs};
use crate::geometry::{Pose2, Twist2};
use crate::io::cost_file::{self, CostFileError};
use crate::io::profile_file::{ExpectedError, Profile, ProfileFileError, VariantProfile};
use crate::mapping::{MotionStatus, PosedScan};
use crate::matching::IterationTrace;
use crate::messages::geometry_msgs::{Pose, PoseWithCovarianceStamped, Quaternion, Twist};
use crate::messages::nav_msgs::Odometry;
use crate::messages::own;
use crate::messages::sensor_msgs::{Imu, LaserScan};
use crate::messages::std_msgs::Header;
use crate::messages::tf2_msgs::TFMessage;
use crate::odometry::wheel::WheelSample;
use crate::odometry::{Failure, LaserOdometry, MatchedPoints, OdometryCounters, Outcome, Registration};
use crate::scan::Scan;
use crate::time::Stamp;
use crate::transforms::{MAX_COORDINATE, Mount, TransformTree};

pub use answering::{PublishedAnswer, ScanProcessor};
use intake::Intake;
pub use intake::UnusableScan;
use sensed::SensorMessage;

/// Maximum deviation of a quaternion's length from 1. A larger one is an error of the sender, not rounding.
const QUATERNION_TOLERANCE: f64 = 0.1;
/// Maximum plausible velocity, m/s and rad/s: no robot is faster, even if its wheels count millimetres or its IMU degrees.
const MAX_VELOCITY: f64 = 1e4;

/// A message that cannot be used. The application ignores it.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum InputError {
    /// A pose has NaN or infinite numbers, or implausibly large ones.
    #[error("the pose has numbers that are not finite or implausibly large")]
    PoseNotFinite,
    /// A linear or angular velocity has NaN or infinite numbers, or implausibly large ones.
    #[error("the velocity has numbers that are not finite or implausibly large")]
    VelocityNotFinite,
    /// A quaternion is not a rotation.
    #[error("the orientation's quaternion has length {:?}: it must be normalised", (.length * 1e3).round() / 1e3)]
    QuaternionNotNormalized {
        /// Its length.
        length: f64,
    },
    /// Some transforms are not rigid motions.
    #[error("{count} transforms are not rigid motions (NaN, a zero quaternion, or a frame that is its own parent)")]
    BadTransforms {
        /// How many.
        count: usize,
    },
    /// A contract is invalid.
    #[error(transparent)]
    Contract(#[from] ContractError),
    /// A pose or point is outside the map.
    #[error("({x:.2}, {y:.2}) is outside the map: is the pose given in the map's frame?")]
    OutsideMap {
        /// Coordinate, m.
        x: f64,
        /// Coordinate, m.
        y: f64,
    },
    /// Odometry of a frame whose pose on the base is unknown.
    #[error(
        "it is for the frame '{child}', and no transform gives the pose of that frame on the base '{base}': ignored (publish the transform on \
         /tf_static, or set the parameter base_frame)"
    )]
    OdometryOfAnotherFrame {
        /// Its frame.
        child: String,
        /// The base's frame.
        base: String,
    },
    /// A pose or point is in another frame than the map's.
    #[error("it is given in the frame '{frame}', expected '{expected}' (in RViz: the fixed frame; parameter map_frame)")]
    WrongFrame {
        /// The message's frame.
        frame: String,
        /// The frame of the map.
        expected: String,
    },
}

/// A file named in the configuration is unusable.
#[derive(Debug, Error)]
pub enum StartError {
    /// The file of learned costs.
    #[error(transparent)]
    Costs(#[from] CostFileError),
    /// The profile.
    #[error(transparent)]
    Profile(#[from] ProfileFileError),
}

/// The answer to a scan.
#[derive(Clone, Debug)]
pub struct Estimate {
    /// The scan's stamp.
    pub stamp: Stamp,
    /// Pose, covariance and velocity, and how they were computed.
    pub registration: Registration,
    /// The contract that was in force.
    pub contract: Contract,
    /// The error that the profile predicts for this time budget, if there is a profile that covers it.
    pub expected_error: Option<ExpectedError>,
    /// Why the expected error is unreliable: the last scans are unlike those of the profile. Known after `conclude`.
    pub outside_profile: Option<OutOfRange>,
    /// Time from the scan's arrival to this answer; after `conclude`, to the publication of its pose.
    pub elapsed: Duration,
    /// Reading of the clock when the scan arrived.
    arrival: Duration,
    /// Reading of the clock at the end of the refinement, if there was one.
    refined: Option<Duration>,
}

impl Estimate {
    /// Whether the answer kept the time budget; always true without one.
    pub fn deadline_met(&self) -> bool {
        self.overrun().is_zero()
    }

    /// How the robot moved to this pose, for the mapper; `None` for a malformed or repeated scan, or if the next scan continues
    /// from the same start as this one.
    pub fn motion_status(&self) -> Option<MotionStatus> {
        match &self.registration.outcome {
            Outcome::First => Some(MotionStatus::Start),
            Outcome::Matched => Some(MotionStatus::Known),
            Outcome::Predicted(_) => self.registration.new_keyframe.then_some(MotionStatus::Lost),
        }
    }

    /// How much the answer exceeded the time budget.
    pub fn overrun(&self) -> Duration {
        self.contract.overrun(self.elapsed)
    }

    /// The matching conditions of this scan; `None` if it was not matched.
    pub fn conditions(&self) -> Option<Conditions> {
        let report = self.registration.refinement.as_ref()?;
        Some(Conditions {
            agreement: f64::from(report.last.inliers) / f64::from(report.last.rays.max(1)),
            rays: f64::from(report.rays),
            condition_number: report.condition_number,
        })
    }

    /// By how much three standard deviations of the estimated error exceed the error bounds; zero if they are kept or there are
    /// none.
    pub fn error_excess(&self) -> ErrorEstimate {
        let excess = |error: f64, bound: Option<f64>| bound.map_or(0.0, |bound| (BOUND_SIGMAS * error - bound).max(0.0));
        let error = self.registration.estimated_error;
        ErrorEstimate {
            translation: excess(error.translation, self.contract.translation_error_bound),
            rotation: excess(error.rotation, self.contract.rotation_error_bound),
        }
    }
}

/// Counted events.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Scans processed.
    pub scans: u64,
    /// Scans that were malformed.
    pub malformed_scans: u64,
    /// Other messages that were rejected.
    pub refused_messages: u64,
    /// Answers later than the time budget.
    pub deadline_misses: u64,
}

/// Where the laser's mount comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MountSource {
    /// The parameter `odometry.laser_in_base`.
    Parameter,
    /// `/tf` or `/tf_static`.
    Transforms,
    /// Unknown: assumed to be at the base's origin.
    Assumed,
}

impl MountSource {
    /// A warning for the user of a bag if the mount is unknown, with the remedy.
    pub fn warning(self) -> Option<&'static str> {
        (self == Self::Assumed).then_some(
            "the pose of the laser on the base is unknown: assumed to be at its origin (set odometry.laser_in_base, or record /tf_static)",
        )
    }
}

/// The scan matcher as an application.
pub struct App {
    intake: Intake,
    interrupt: Arc<dyn Interrupt>,
    profile: Option<VariantProfile>,
    /// Checks whether scans are like those of the profile.
    watch: Option<ConditionMonitor>,
    odometry: LaserOdometry,
    /// A pose set by the user, kept until the first scan after it.
    initial_pose: Option<InitialPose<Pose2>>,
    counters: Counters,
}

impl App {
    /// Creates an application with this configuration. Fails on an invalid contract.
    pub fn new(config: &Config, clock: Arc<dyn Clock>) -> Result<Self, ContractError> {
        Ok(Self {
            intake: Intake::new(config, clock)?,
            interrupt: Arc::new(NeverInterrupt),
            profile: None,
            watch: None,
            odometry: LaserOdometry::new(&config.odometry, &config.matching, &config.rejection),
            initial_pose: None,
            counters: Counters::default(),
        })
    }

    /// Prepares for the first scan: matches simulated scans to learn their costs, and reads the files of costs and of the
    /// profile, if there are any.
    pub fn warm_up(&mut self) -> Result<(), StartError> {
        self.intake.costs = warm_up::measure_costs(self);
        if let Some(path) = &self.intake.config.contract.cost_file {
            cost_file::read(Path::new(path), &mut self.intake.costs)?;
        }
        if let Some(path) = &self.intake.config.contract.profile {
            let matching = &self.intake.config.matching;
            let variant = format!("{}+{}", matching.correspondence.name(), matching.solver.name());
            let profile = Profile::load(Path::new(path))?.variant(&variant)?.clone();
            self.watch = Some(ConditionMonitor::new(profile.conditions));
            self.profile = Some(profile);
        }
        Ok(())
    }

    /// The error that the profile predicts for the contract in force.
    pub fn expected_error(&self) -> Option<ExpectedError> {
        self.profile.as_ref()?.expected_error(self.intake.contract.time_budget.unwrap_or(Duration::MAX))
    }

    /// The costs of work, as learned so far.
    pub fn costs(&self) -> &CostModel {
        &self.intake.costs
    }

    /// Writes the learned costs to their file, if one is configured.
    pub fn store_costs(&self) -> Result<(), CostFileError> {
        match &self.intake.config.contract.cost_file {
            Some(path) => cost_file::write(Path::new(path), &self.intake.costs),
            None => Ok(()),
        }
    }

    /// Sets the interrupt that may end a refinement early.
    pub fn set_interrupt(&mut self, interrupt: Arc<dyn Interrupt>) {
        self.interrupt = interrupt;
    }

    /// Processes a scan that arrived when the clock read `arrival`. Always returns an estimate: for an unusable scan, the
    /// prediction. The caller must then call [`Self::conclude`].
    pub fn on_scan(&mut self, message: &LaserScan, arrival: Duration) -> Estimate {
        self.estimate(&message.header, arrival, |intake| intake.scan(message))
    }

    fn estimate(
        &mut self,
        header: &Header,
        arrival: Duration,
        read: impl FnOnce(&mut Intake) -> Result<Scan, UnusableScan>,
    ) -> Estimate {
        let stamp = header.stamp.into();
        self.counters.scans += 1;
        if let Some(set) = self.initial_pose.take_if(|set| set.precedes(stamp, arrival)) {
            self.odometry.set_pose(set.pose, set.time_on_scan_clock(stamp, arrival));
        }
        let scan_contract = self.intake.scan_contract(arrival);
        let mount_known_before = self.intake.mount_source;
        let scan = read(&mut self.intake);
        if self.intake.mount_source != mount_known_before {
            self.odometry.forget_reference();
        }
        let Intake { clock, costs, mount, .. } = &mut self.intake;
        let mut runner = ContractRunner::new(scan_contract, &**clock, &*self.interrupt, costs);
        let registration = match scan {
            Ok(scan) => self.odometry.register_within(&scan, &mount.base_from_laser, &mut runner),
            Err(problem) => {
                self.counters.malformed_scans += 1;
                self.odometry.register_unusable(stamp, Failure::new(problem.reason(), problem.to_string()))
            }
        };
        let refined = runner.last_step_end();
        let elapsed = clock.now().saturating_sub(arrival);
        let (contract, expected_error) = (self.contract(), self.expected_error());
        Estimate { stamp, registration, contract, expected_error, outside_profile: None, elapsed, arrival, refined }
    }

    /// Converts the message that has just been processed to a scan; `None` if it is malformed.
    pub fn scan(&mut self, message: &SensorMessage) -> Option<Scan> {
        self.intake.scan_again(message)
    }

    /// The scan that has just been processed with its pose, as the mapper needs it, and the scan as it was measured; `None` if it
    /// could not be used.
    pub fn posed_scan(&mut self, message: &SensorMessage, estimate: &Estimate) -> Option<(PosedScan, Scan)> {
        let motion_status = estimate.motion_status()?;
        let measured = self.scan(message)?;
        let Registration { odom_from_base, covariance, .. } = estimate.registration;
        let base_from_laser = self.intake.mount.base_from_laser;
        let scan = self.undistorted(measured.clone());
        Some((PosedScan { scan, odom_from_base, covariance, base_from_laser, motion_status }, measured))
    }

    /// Undistorts a scan to its stamp.
    pub fn undistorted(&self, scan: Scan) -> Scan {
        self.odometry.undistorted(&scan, &self.intake.mount.base_from_laser).unwrap_or(scan)
    }

    /// How long to delay an answer for odometry that improves it: `odometry.max_wait`, but at most half of the time budget.
    pub fn max_odometry_wait(&self) -> Duration {
        self.intake.max_wait().unwrap_or_default()
    }

    /// Adds the base pose of another node's transforms as a prediction, if `prediction_frame` is set.
    fn predict_from(&mut self, message: &TFMessage) {
        let FrameKnobs { prediction_frame: Some(frame), base_frame, .. } = &self.intake.config.frames else { return };
        let mut moved =
            message.transforms.iter().filter(|moved| self.intake.transforms.is_ancestor(&moved.child_frame_id, base_frame));
        if let (Some(moved), Some(mount)) = (moved.next(), self.intake.transforms.mount(frame, base_frame)) {
            let stamp = moved.header.stamp.into();
            self.odometry.add_transform_sample(WheelSample { stamp, pose: mount.base_from_laser, twist: None });
        }
    }

    /// Handles the current velocity of the base: the prediction if there is no odometry.
    pub fn on_velocity(&mut self, message: &Twist) -> Result<(), InputError> {
        let twist = Twist2 { vx: message.linear.x, vy: message.linear.y, omega: message.angular.z };
        self.count_rejected(if is_possible(&twist) { Ok(()) } else { Err(InputError::VelocityNotFinite) })?;
        self.odometry.set_velocity(twist);
        Ok(())
    }

    /// Handles a contract; it applies from the next scan on.
    pub fn on_contract(&mut self, message: &own::Contract) -> Result<(), InputError> {
        self.intake.contract = self.count_rejected(Contract::try_from(message).map_err(InputError::from))?;
        Ok(())
    }

    /// Sets the contract; it applies from the next scan on.
    pub fn set_contract(&mut self, contract: Contract) {
        self.intake.contract = contract;
    }

    /// Sets the maximum number of iterations of a match; it applies from the next scan on.
    pub fn set_max_iterations(&mut self, limit: u32) {
        self.odometry.set_max_iterations(limit);
    }

    /// Handles an initial pose of the base that arrived when the clock read `arrival`: the next scan taken after it is the first
    /// one of a new start from this pose.
    pub fn on_initial_pose(&mut self, message: &PoseWithCovarianceStamped, arrival: Duration) -> Result<(), InputError> {
        let pose = self.count_rejected(planar_pose(&message.pose.pose))?;
        self.initial_pose = Some(InitialPose::new(pose, &message.header, arrival));
        Ok(())
    }

    /// Restarts from the initial pose.
    pub fn reset(&mut self) {
        self.initial_pose = None;
        self.odometry.reset();
    }

    /// Sets whether the matched points of each answer are kept for [`Self::matched_points`].
    pub fn set_keep_matched_points(&mut self, keep: bool) {
        self.odometry.set_keep_matched_points(keep);
    }

    /// The matched points of the last answer, if it was a match and they are kept.
    pub fn matched_points(&self) -> Option<&MatchedPoints> {
        self.odometry.matched_points()
    }

    /// The iterations of the last match; empty if the last answer was not a match.
    pub fn iterations(&self) -> &[IterationTrace] {
        self.odometry.iterations()
    }

    /// The mount of the laser on the base, and where it comes from.
    pub fn mount(&self) -> (Mount, MountSource) {
        (self.intake.mount, self.intake.mount_source)
    }

    /// The known transforms.
    pub fn transforms(&self) -> &TransformTree {
        &self.intake.transforms
    }

    /// The contract in force.
    pub fn contract(&self) -> Contract {
        self.intake.contract
    }

    /// The configuration of this application.
    pub fn config(&self) -> &Config {
        &self.intake.config
    }

    /// The events counted so far.
    pub fn counters(&self) -> &Counters {
        &self.counters
    }

    /// Lag of the scans behind the wheel odometry, s: scans show the robot where the wheel odometry had it this much earlier.
    /// Estimated along the path; 0 until there is evidence.
    pub fn odometry_lag(&self) -> f64 {
        self.odometry.odometry_lag()
    }

    /// The events of the odometry counted so far.
    pub fn odometry_counters(&self) -> &OdometryCounters {
        self.odometry.counters()
    }

    fn count_rejected<T>(&mut self, result: Result<T, InputError>) -> Result<T, InputError> {
        self.counters.refused_messages += u64::from(result.is_err());
        result
    }
}

impl ScanProcessor for App {
    type Answer = Estimate;

    fn on_sensed(&mut self, message: &SensorMessage, arrival: Duration) -> Estimate {
        match message {
            SensorMessage::Scan(scan) => self.on_scan(scan, arrival),
            SensorMessage::Cloud(cloud) => self.estimate(&cloud.header, arrival, |intake| intake.cloud(cloud)),
        }
    }

    fn conclude(&mut self, estimate: &mut Estimate) {
        let size = estimate.registration.refinement.as_ref().map(|report| report.last.rays as usize);
        estimate.elapsed = self.intake.conclude(estimate.arrival, estimate.refined, size);
        self.counters.deadline_misses += u64::from(!estimate.deadline_met());
        if let (Some(watch), Some(conditions)) = (&mut self.watch, estimate.conditions()) {
            estimate.outside_profile = watch.add(&conditions);
        }
    }

    fn maintain(&mut self, interrupt: &dyn Interrupt) {
        let scan_contract = self.intake.unlimited_contract();
        let Intake { config, clock, costs, .. } = &mut self.intake;
        let mut runner = ContractRunner::new(scan_contract, &**clock, interrupt, costs);
        if config.contract.finish_after_answer {
            self.odometry.finish(&mut runner);
        }
        self.odometry.maintain();
        self.odometry.close_loop(&mut runner);
        costs.learn();
    }

    fn wait_for_inputs(&self, header: &Header) -> Option<Duration> {
        let is_waiting = |_: &_| self.odometry.awaits_odometry(header.stamp.into()) || self.intake.awaits_mount(header);
        self.intake.max_wait().filter(is_waiting)
    }

    fn on_odometry(&mut self, message: &Odometry) -> Result<(), InputError> {
        let sample = self.intake.wheel_sample(message);
        let sample = self.count_rejected(sample)?;
        self.odometry.add_wheel_sample(sample);
        Ok(())
    }

    fn on_transforms(&mut self, message: &TFMessage) -> Result<(), InputError> {
        let outcome = self.intake.on_transforms(message);
        self.predict_from(message);
        self.count_rejected(outcome)
    }

    fn on_imu(&mut self, message: &Imu) -> Result<(), InputError> {
        let mount = self.intake.transforms.mount(&self.intake.config.frames.base_frame, &message.header.frame_id);
        let reading = heading::reading(message, mount.is_some_and(|mount| mount.upside_down));
        if let Some(reading) = self.count_rejected(reading)? {
            self.odometry.add_imu_reading(reading);
        }
        Ok(())
    }

    fn take_warnings(&mut self) -> Vec<String> {
        self.intake.take_warnings()
    }
}

/// The planar pose of a message.
pub fn planar_pose(pose: &Pose) -> Result<Pose2, InputError> {
    let yaw = yaw(&pose.orientation)?;
    let planar = Pose2::new(pose.position.x, pose.position.y, yaw);
    if planar.is_finite() && planar.distance() <= MAX_COORDINATE { Ok(planar) } else { Err(InputError::PoseNotFinite) }
}

fn yaw(q: &Quaternion) -> Result<f64, InputError> {
    let length = q.norm();
    if !length.is_finite() {
        return Err(InputError::PoseNotFinite);
    }
    if (length - 1.0).abs() > QUATERNION_TOLERANCE {
        return Err(InputError::QuaternionNotNormalized { length });
    }
    Ok(q.yaw())
}

fn is_possible(twist: &Twist2) -> bool {
    [twist.vx, twist.vy, twist.omega].iter().all(|velocity| velocity.abs() <= MAX_VELOCITY)
}

/// A zero twist carries no information: drivers without velocities leave it so, and a robot at rest needs none.
fn planar_twist(twist: &Twist) -> Option<Twist2> {
    let planar = Twist2 { vx: twist.linear.x, vy: twist.linear.y, omega: twist.angular.z };
    (is_possible(&planar) && planar != Twist2::default()).then_some(planar)
}
