//! The application: messages in, estimates out. The node and the offline tool both drive this, so that a replay is what ran live.

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
use crate::anytime::interrupt::{Interrupt, Never};
use crate::anytime::mode::{Conditions, Outside, Watch};
use crate::anytime::{Driver, ErrorEstimate};
use crate::config::{Config, FrameKnobs};
use crate::geometry::{Pose2, Twist2};
use crate::io::cost_file::{self, CostFileError};
use crate::io::profile_file::{ExpectedError, Profile, ProfileFileError, VariantProfile};
use crate::mapping::{Passage, Sighting};
use crate::matching::IterationTrace;
use crate::messages::geometry_msgs::{Pose, PoseWithCovarianceStamped, Quaternion, Twist};
use crate::messages::nav_msgs::Odometry;
use crate::messages::own;
use crate::messages::sensor_msgs::{Imu, LaserScan, PointCloud2};
use crate::messages::std_msgs::Header;
use crate::messages::tf2_msgs::TFMessage;
use crate::odometry::wheel::WheelSample;
use crate::odometry::{Failure, FailureReason, LaserOdometry, MatchedPoints, OdometryCounters, Outcome, Registration};
use crate::scan::Scan;
use crate::time::Stamp;
use crate::transforms::{FARTHEST, Mount, TransformTree};

pub use answering::{Answered, Answering};
use intake::Intake;
pub use intake::Unusable;
use sensed::Sensed;

/// A quaternion whose length is farther from 1 than this is a mistake of its sender, not rounding.
const QUATERNION_TOLERANCE: f64 = 0.1;
/// No robot is faster, m/s and rad/s, were its wheels to count millimetres or its IMU degrees.
const FASTEST: f64 = 1e4;

/// A message that cannot be used. The application goes on as if it had not come.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum InputError {
    /// A pose holds NaN or infinities, or numbers that can only be damage.
    #[error("the pose has numbers that are not finite, or is nowhere on Earth")]
    PoseNotFinite,
    /// An angular velocity or a velocity holds NaN or infinities, or numbers that can only be damage.
    #[error("the velocity has numbers that are not finite, or that nothing moves at")]
    VelocityNotFinite,
    /// A quaternion is no rotation.
    #[error("the orientation's quaternion has length {:?}: it must be normalised", (.length * 1e3).round() / 1e3)]
    QuaternionNotNormalized {
        /// Its length.
        length: f64,
    },
    /// Transforms that are no rigid motions.
    #[error("{count} transforms are no rigid motions (NaN, a zero quaternion, or a frame that is its own parent)")]
    BadTransforms {
        /// How many.
        count: usize,
    },
    /// A contract that nobody could keep.
    #[error(transparent)]
    Contract(#[from] ContractError),
    /// A place that is not on the map.
    #[error("({x:.2}, {y:.2}) is outside the map: is the pose given in the map's frame?")]
    OutsideMap {
        /// Where, m.
        x: f64,
        /// Where, m.
        y: f64,
    },
    /// Odometry of a frame that nobody knows the place of on the base.
    #[error(
        "it is of the frame '{child}', and no transform says where that is on the base '{base}': unusable (publish the transform on \
         /tf_static, or set the parameter base_frame)"
    )]
    OdometryOfAnotherFrame {
        /// Its frame.
        child: String,
        /// The base's frame.
        base: String,
    },
    /// A place in another frame than the map's.
    #[error("it is given in the frame '{frame}', expected '{expected}' (in RViz: the fixed frame; parameter map_frame)")]
    WrongFrame {
        /// The message's frame.
        frame: String,
        /// The frame of the map.
        expected: String,
    },
}

/// A file that the configuration names is unusable.
#[derive(Debug, Error)]
pub enum StartError {
    /// The learned costs.
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
    /// Pose, covariance, velocity, and how they came about.
    pub registration: Registration,
    /// The contract that was in force.
    pub contract: Contract,
    /// The error that the profile leads to expect of such a time budget, if there is a profile and it knows.
    pub expected_error: Option<ExpectedError>,
    /// Why that is not to be relied on: the last scans are of another kind than the profile's. Known once it is concluded.
    pub outside_profile: Option<Outside>,
    /// Time from the scan's arrival to this answer; once it is concluded, to its pose handed over.
    pub elapsed: Duration,
    /// Reading of the clock when the scan arrived.
    arrival: Duration,
    /// Reading of the clock when the refinement was over, if there was one.
    refined: Option<Duration>,
}

impl Estimate {
    /// Whether the answer is within the time budget; without one it always is.
    pub fn deadline_met(&self) -> bool {
        self.overrun().is_zero()
    }

    /// How the robot came here; `None` where the scan was malformed, or one that had been answered before, or where the next one starts
    /// from where this one did.
    pub fn passage(&self) -> Option<Passage> {
        match &self.registration.outcome {
            Outcome::First => Some(Passage::Start),
            Outcome::Matched => Some(Passage::Known),
            Outcome::Predicted(_) => self.registration.new_keyframe.then_some(Passage::Lost),
        }
    }

    /// How much later than asked for the answer is.
    pub fn overrun(&self) -> Duration {
        self.contract.overrun(self.elapsed)
    }

    /// What the match found; `None` without one.
    pub fn conditions(&self) -> Option<Conditions> {
        let report = self.registration.refinement.as_ref()?;
        Some(Conditions {
            agreement: f64::from(report.inliers) / f64::from(report.rays_used.max(1)),
            rays: f64::from(report.rays),
            condition_number: report.condition_number,
        })
    }

    /// By how much the estimated error, three standard deviations of it, misses the bounds; zero where it keeps them, or there is none.
    pub fn error_excess(&self) -> ErrorEstimate {
        let excess = |error: f64, bound: Option<f64>| bound.map_or(0.0, |bound| (BOUND_SIGMAS * error - bound).max(0.0));
        let error = self.registration.estimated_error;
        ErrorEstimate {
            translation: excess(error.translation, self.contract.translation_error_bound),
            rotation: excess(error.rotation, self.contract.rotation_error_bound),
        }
    }
}

/// Events that are counted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Scans answered.
    pub scans: u64,
    /// Scans that were malformed.
    pub malformed_scans: u64,
    /// Other messages that could not be used.
    pub refused_messages: u64,
    /// Answers later than the time budget.
    pub deadline_misses: u64,
}

/// Where the laser's mount is known from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MountSource {
    /// The parameter `odometry.laser_in_base`.
    Parameter,
    /// `/tf` or `/tf_static`.
    Transforms,
    /// Nowhere: taken to be at the base's origin.
    Assumed,
}

impl MountSource {
    /// What the user of a bag should know of it, with the remedy.
    pub fn reservation(self) -> Option<&'static str> {
        (self == Self::Assumed).then_some(
            "where the laser is on the base is not known: taken to be at its origin (set odometry.laser_in_base, or record /tf_static)",
        )
    }
}

/// Scan matching as a whole.
pub struct App {
    intake: Intake,
    interrupt: Arc<dyn Interrupt>,
    profile: Option<VariantProfile>,
    /// Whether scans are of the profile's kind.
    watch: Option<Watch>,
    odometry: LaserOdometry,
    /// A pose that was set, until the first scan after it.
    initial_pose: Option<InitialPose<Pose2>>,
    counters: Counters,
}

impl App {
    /// An application with this configuration. Fails on an invalid contract.
    pub fn new(config: &Config, clock: Arc<dyn Clock>) -> Result<Self, ContractError> {
        Ok(Self {
            intake: Intake::new(config, clock)?,
            interrupt: Arc::new(Never),
            profile: None,
            watch: None,
            odometry: LaserOdometry::new(&config.odometry, &config.matching, &config.rejection),
            initial_pose: None,
            counters: Counters::default(),
        })
    }

    /// Gets ready for the first scan: practises on simulated ones, and reads the files of costs and of the profile, if there are any.
    pub fn warm_up(&mut self) -> Result<(), StartError> {
        self.intake.costs = warm_up::practise(self);
        if let Some(path) = &self.intake.config.contract.cost_file {
            cost_file::read(Path::new(path), &mut self.intake.costs)?;
        }
        if let Some(path) = &self.intake.config.contract.profile {
            let matching = &self.intake.config.matching;
            let variant = format!("{}+{}", matching.correspondence.name(), matching.solver.name());
            let profile = Profile::load(Path::new(path))?.variant(&variant)?.clone();
            self.watch = Some(Watch::new(profile.conditions));
            self.profile = Some(profile);
        }
        Ok(())
    }

    /// The error that the profile leads to expect under the contract in force.
    pub fn expected_error(&self) -> Option<ExpectedError> {
        self.profile.as_ref()?.expected_error(self.intake.contract.time_budget.unwrap_or(Duration::MAX))
    }

    /// What work costs, as learned so far.
    pub fn costs(&self) -> &CostModel {
        &self.intake.costs
    }

    /// Writes the learned costs to their file, if one is wanted.
    pub fn store_costs(&self) -> Result<(), CostFileError> {
        match &self.intake.config.contract.cost_file {
            Some(path) => cost_file::write(Path::new(path), &self.intake.costs),
            None => Ok(()),
        }
    }

    /// From now on `interrupt` may end a refinement early.
    pub fn set_interrupt(&mut self, interrupt: Arc<dyn Interrupt>) {
        self.interrupt = interrupt;
    }

    /// Answers a scan that arrived when the clock read `arrival`. Always answers: for a scan that is unusable, with the prediction.
    /// [`Self::conclude`] is to follow.
    pub fn on_scan(&mut self, message: &LaserScan, arrival: Duration) -> Estimate {
        self.estimate(&message.header, arrival, |intake| intake.scan(message))
    }

    /// Answers a point cloud as [`Self::on_scan`] does a scan.
    pub fn on_cloud(&mut self, message: &PointCloud2, arrival: Duration) -> Estimate {
        self.estimate(&message.header, arrival, |intake| intake.cloud(message))
    }

    fn estimate(
        &mut self,
        header: &Header,
        arrival: Duration,
        read: impl FnOnce(&mut Intake) -> Result<Scan, Unusable>,
    ) -> Estimate {
        let stamp = header.stamp.into();
        self.counters.scans += 1;
        if let Some(set) = self.initial_pose.take_if(|set| set.precedes(stamp, arrival)) {
            self.odometry.set_pose(set.pose, set.held_at(stamp, arrival));
        }
        let task = self.intake.task(arrival);
        let mount_known_before = self.intake.mount_source;
        let scan = read(&mut self.intake);
        if self.intake.mount_source != mount_known_before {
            self.odometry.forget_reference();
        }
        let Intake { clock, costs, mount, .. } = &mut self.intake;
        let mut driver = Driver::new(task, &**clock, &*self.interrupt, costs);
        let registration = match scan {
            Ok(scan) => self.odometry.register_within(&scan, &mount.base_from_laser, &mut driver),
            Err(problem) => {
                self.counters.malformed_scans += 1;
                self.odometry.answer_unusable(stamp, failure(&problem))
            }
        };
        let refined = driver.refined();
        let elapsed = clock.now().saturating_sub(arrival);
        let (contract, expected_error) = (self.contract(), self.expected_error());
        Estimate { stamp, registration, contract, expected_error, outside_profile: None, elapsed, arrival, refined }
    }

    /// The scan of a message that has just been answered; `None` where it is malformed.
    pub fn scan(&mut self, message: &Sensed) -> Option<Scan> {
        self.intake.scan_again(message)
    }

    /// What a scan that has just been answered is to a map, and the scan as it was measured; `None` where it could not be used.
    pub fn sighting(&mut self, message: &Sensed, estimate: &Estimate) -> Option<(Sighting, Scan)> {
        let passage = estimate.passage()?;
        let measured = self.scan(message)?;
        let Registration { odom_from_base, covariance, .. } = estimate.registration;
        let base_from_laser = self.intake.mount.base_from_laser;
        let scan = self.undistorted(measured.clone());
        Some((Sighting { scan, odom_from_base, covariance, base_from_laser, passage }, measured))
    }

    /// That scan as the laser would have seen it at its stamp.
    pub fn undistorted(&self, scan: Scan) -> Scan {
        self.odometry.undistorted(&scan, &self.intake.mount.base_from_laser).unwrap_or(scan)
    }

    /// How long an answer may be held back for news that make it better: `odometry.max_wait`, and half of the time budget at most.
    pub fn patience(&self) -> Duration {
        self.intake.patience().unwrap_or_default()
    }

    /// Where another node's transforms say the base is, if these are to predict.
    fn predict_from(&mut self, message: &TFMessage) {
        let FrameKnobs { prediction_frame: Some(frame), base_frame, .. } = &self.intake.config.frames else { return };
        let mut moved =
            message.transforms.iter().filter(|moved| self.intake.transforms.carries(&moved.child_frame_id, base_frame));
        if let (Some(moved), Some(place)) = (moved.next(), self.intake.transforms.mount(frame, base_frame)) {
            let stamp = moved.header.stamp.into();
            self.odometry.add_transform_sample(WheelSample { stamp, pose: place.base_from_laser, twist: None });
        }
    }

    /// Takes the velocity of the base as it is now: the prediction where there is no odometry.
    pub fn on_velocity(&mut self, message: &Twist) -> Result<(), InputError> {
        let twist = Twist2 { vx: message.linear.x, vy: message.linear.y, omega: message.angular.z };
        self.count_refused(if is_possible(&twist) { Ok(()) } else { Err(InputError::VelocityNotFinite) })?;
        self.odometry.set_velocity(twist);
        Ok(())
    }

    /// Takes a contract; in force from the next scan on.
    pub fn on_contract(&mut self, message: &own::Contract) -> Result<(), InputError> {
        self.intake.contract = self.count_refused(Contract::try_from(message).map_err(InputError::from))?;
        Ok(())
    }

    /// Another contract; in force from the next scan on.
    pub fn set_contract(&mut self, contract: Contract) {
        self.intake.contract = contract;
    }

    /// Another limit of the iterations of one match; in force from the next scan on.
    pub fn set_max_iterations(&mut self, limit: u32) {
        self.odometry.set_max_iterations(limit);
    }

    /// Takes the pose of the base, which came when the clock read `arrival`: the next scan taken after it is the first one, there.
    pub fn on_initial_pose(&mut self, message: &PoseWithCovarianceStamped, arrival: Duration) -> Result<(), InputError> {
        let pose = self.count_refused(planar_pose(&message.pose.pose))?;
        self.initial_pose = Some(InitialPose::new(pose, &message.header, arrival));
        Ok(())
    }

    /// Starts again from the initial pose.
    pub fn reset(&mut self) {
        self.initial_pose = None;
        self.odometry.reset();
    }

    /// Whether to keep the matched points of each answer for [`Self::matched_points`].
    pub fn set_keep_matched_points(&mut self, keep: bool) {
        self.odometry.set_keep_matched_points(keep);
    }

    /// The matched points of the last answer, where it was a match and they were to be kept.
    pub fn matched_points(&self) -> Option<&MatchedPoints> {
        self.odometry.matched_points()
    }

    /// What each iteration of the last match did; empty where there was none for the last answer.
    pub fn iterations(&self) -> &[IterationTrace] {
        self.odometry.iterations()
    }

    /// Place of the laser on the base, and where that is known from.
    pub fn mount(&self) -> (Mount, MountSource) {
        (self.intake.mount, self.intake.mount_source)
    }

    /// The transforms known.
    pub fn transforms(&self) -> &TransformTree {
        &self.intake.transforms
    }

    /// The contract in force.
    pub fn contract(&self) -> Contract {
        self.intake.contract
    }

    /// The configuration it was made with.
    pub fn config(&self) -> &Config {
        &self.intake.config
    }

    /// Events counted so far.
    pub fn counters(&self) -> &Counters {
        &self.counters
    }

    /// Scans show the robot where the wheel odometry had it so much earlier, s; found along the path, 0 as long as nothing says so.
    pub fn odometry_lag(&self) -> f64 {
        self.odometry.odometry_lag()
    }

    /// Events of the odometry counted so far.
    pub fn odometry_counters(&self) -> &OdometryCounters {
        self.odometry.counters()
    }

    fn count_refused<T>(&mut self, result: Result<T, InputError>) -> Result<T, InputError> {
        self.counters.refused_messages += u64::from(result.is_err());
        result
    }
}

impl Answering for App {
    type Answer = Estimate;

    fn on_sensed(&mut self, message: &Sensed, arrival: Duration) -> Estimate {
        match message {
            Sensed::Scan(scan) => self.on_scan(scan, arrival),
            Sensed::Cloud(cloud) => self.on_cloud(cloud, arrival),
        }
    }

    fn conclude(&mut self, estimate: &mut Estimate) {
        let size = estimate.registration.refinement.as_ref().map(|report| report.rays_used as usize);
        estimate.elapsed = self.intake.conclude(estimate.arrival, estimate.refined, size);
        self.counters.deadline_misses += u64::from(!estimate.deadline_met());
        if let (Some(watch), Some(conditions)) = (&mut self.watch, estimate.conditions()) {
            estimate.outside_profile = watch.add(&conditions);
        }
    }

    fn maintain(&mut self, interrupt: &dyn Interrupt) {
        let task = self.intake.task_without_limit();
        let Intake { config, clock, costs, .. } = &mut self.intake;
        let mut driver = Driver::new(task, &**clock, interrupt, costs);
        if config.contract.finish_after_answer {
            self.odometry.finish(&mut driver);
        }
        self.odometry.maintain();
        self.odometry.close_loop(&mut driver);
        costs.learn();
    }

    fn wait_for_odometry(&self, stamp: Stamp) -> Option<Duration> {
        self.intake.patience().filter(|_| self.odometry.awaits_odometry(stamp))
    }

    fn on_odometry(&mut self, message: &Odometry) -> Result<(), InputError> {
        let sample = self.intake.wheel_sample(message);
        let sample = self.count_refused(sample)?;
        self.odometry.add_wheel_sample(sample);
        Ok(())
    }

    fn on_transforms(&mut self, message: &TFMessage) -> Result<(), InputError> {
        let outcome = self.intake.on_transforms(message);
        self.predict_from(message);
        self.count_refused(outcome)
    }

    fn on_imu(&mut self, message: &Imu) -> Result<(), InputError> {
        let mount = self.intake.transforms.mount(&self.intake.config.frames.base_frame, &message.header.frame_id);
        let reading = heading::reading(message, mount.is_some_and(|mount| mount.upside_down));
        if let Some(reading) = self.count_refused(reading)? {
            self.odometry.add_heading(reading);
        }
        Ok(())
    }

    fn take_remarks(&mut self) -> Vec<String> {
        self.intake.take_remarks()
    }
}

/// Why an unusable scan is answered with the prediction.
fn failure(problem: &Unusable) -> Failure {
    let reason = match problem {
        Unusable::Tilted(_) => FailureReason::TiltedMount,
        Unusable::Malformed(_) | Unusable::MalformedCloud(_) => FailureReason::MalformedScan,
    };
    Failure::new(reason, problem.to_string())
}

/// The pose in the plane that a message holds.
pub fn planar_pose(pose: &Pose) -> Result<Pose2, InputError> {
    let yaw = yaw(&pose.orientation)?;
    let planar = Pose2::new(pose.position.x, pose.position.y, yaw);
    if planar.is_finite() && planar.distance() <= FARTHEST { Ok(planar) } else { Err(InputError::PoseNotFinite) }
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
    [twist.vx, twist.vy, twist.omega].iter().all(|velocity| velocity.abs() <= FASTEST)
}

/// A twist of zeros says nothing: that is how drivers without velocities leave it, and a robot at rest needs none.
fn planar_twist(twist: &Twist) -> Option<Twist2> {
    let planar = Twist2 { vx: twist.linear.x, vy: twist.linear.y, omega: twist.angular.z };
    (is_possible(&planar) && planar != Twist2::default()).then_some(planar)
}
