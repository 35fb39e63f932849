//! The application: messages in, estimates out. The node and the offline tool both drive this, so that a replay is what ran live.

mod heading;
mod initial_pose;
mod intake;
pub mod localizer;
pub mod map_message;
pub mod sensed;
mod warm_up;

use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use thiserror::Error;

use self::initial_pose::InitialPose;
use crate::anytime::clock::Clock;
use crate::anytime::contract::{BOUND_SIGMAS, Contract, ContractError};
use crate::anytime::cost_model::{CostModel, Phase};
use crate::anytime::interrupt::{Interrupt, Never};
use crate::anytime::mode::{Conditions, Outside, Watch};
use crate::anytime::{Driver, ErrorEstimate, Task};
use crate::cloud;
use crate::config::{Config, FrameKnobs};
use crate::geometry::{Pose2, Twist2};
use crate::io::cost_file::{self, CostFileError};
use crate::io::profile_file::{ExpectedError, Profile, ProfileFileError, VariantProfile};
use crate::matching::IterationTrace;
use crate::messages::geometry_msgs::{Pose, PoseWithCovarianceStamped, Quaternion, Twist};
use crate::messages::nav_msgs::Odometry;
use crate::messages::own;
use crate::messages::sensor_msgs::{Imu, LaserScan, PointCloud2};
use crate::messages::std_msgs::Header;
use crate::messages::tf2_msgs::TFMessage;
use crate::odometry::wheel::WheelSample;
use crate::odometry::{Failure, FailureReason, LaserOdometry, MatchedPoints, OdometryCounters, Registration};
use crate::scan::{Scan, ScanConverter};
use crate::time::Stamp;
use crate::transforms::{Mount, TransformTree};

use sensed::Sensed;

/// A quaternion whose length is farther from 1 than this is a mistake of its sender, not rounding.
const QUATERNION_TOLERANCE: f64 = 0.1;
/// A mount that moves by more than this (m, rad) between two scans is worth a remark: no laser shakes that much on its bracket.
const MOUNT_JUMP: f64 = 0.02;

/// A message that cannot be used. The application goes on as if it had not come.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum InputError {
    /// A pose holds NaN or infinities.
    #[error("the pose has numbers that are not finite")]
    PoseNotFinite,
    /// An angular velocity or a velocity holds NaN or infinities.
    #[error("the velocity has numbers that are not finite")]
    VelocityNotFinite,
    /// A quaternion is no rotation.
    #[error("the orientation's quaternion has length {length:.3}: it must be normalised")]
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

/// A file that the configuration names is of no use.
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

/// Scan matching as a whole.
pub struct App {
    config: Config,
    clock: Arc<dyn Clock>,
    interrupt: Arc<dyn Interrupt>,
    costs: CostModel,
    profile: Option<VariantProfile>,
    /// Whether scans are of the profile's kind.
    watch: Option<Watch>,
    contract: Contract,
    odometry: LaserOdometry,
    converter: ScanConverter,
    transforms: TransformTree,
    mount: Mount,
    mount_source: MountSource,
    /// The frame of the last scan, and where on the base it was.
    last_mount: Option<(String, Pose2)>,
    mount_jumped: bool,
    /// A pose that was set, until the first scan after it.
    initial_pose: Option<InitialPose<Pose2>>,
    remarks: Vec<String>,
    counters: Counters,
}

impl App {
    /// An application with this configuration. Fails on a contract that is none.
    pub fn new(config: &Config, clock: Arc<dyn Clock>) -> Result<Self, ContractError> {
        let parameter = config.odometry.laser_in_base;
        Ok(Self {
            config: config.clone(),
            clock,
            interrupt: Arc::new(Never),
            costs: CostModel::new(config.contract.confidence),
            profile: None,
            watch: None,
            contract: Contract::try_from(&config.contract)?,
            odometry: LaserOdometry::new(&config.odometry, &config.matching, &config.rejection),
            converter: ScanConverter::new(&config.scan),
            transforms: TransformTree::default(),
            mount: Mount { base_from_laser: parameter.unwrap_or_default(), ..Mount::default() },
            mount_source: if parameter.is_some() { MountSource::Parameter } else { MountSource::Assumed },
            last_mount: None,
            mount_jumped: false,
            initial_pose: None,
            remarks: Vec::new(),
            counters: Counters::default(),
        })
    }

    /// Gets ready for the first scan: practises on simulated ones, and reads the files of costs and of the profile, if there are any.
    pub fn warm_up(&mut self) -> Result<(), StartError> {
        self.costs = warm_up::practise(self);
        if let Some(path) = &self.config.contract.cost_file {
            cost_file::read(Path::new(path), &mut self.costs)?;
        }
        if let Some(path) = &self.config.contract.profile {
            let matching = &self.config.matching;
            let variant = format!("{}+{}", matching.correspondence.name(), matching.solver.name());
            let profile = Profile::load(Path::new(path))?.variant(&variant)?.clone();
            self.watch = Some(Watch::new(profile.conditions));
            self.profile = Some(profile);
        }
        Ok(())
    }

    /// The error that the profile leads to expect under the contract in force.
    pub fn expected_error(&self) -> Option<ExpectedError> {
        self.profile.as_ref()?.expected_error(self.contract.time_budget.unwrap_or(Duration::MAX))
    }

    /// What work costs, as learned so far.
    pub fn costs(&self) -> &CostModel {
        &self.costs
    }

    /// Writes the learned costs to their file, if one is wanted.
    pub fn store_costs(&self) -> Result<(), CostFileError> {
        match &self.config.contract.cost_file {
            Some(path) => cost_file::write(Path::new(path), &self.costs),
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
        self.answer(&message.header, arrival, |app| {
            let level = app.mount.check_level(&app.config.frames.base_frame, &message.header.frame_id);
            level.map_err(|e| Failure::new(FailureReason::TiltedMount, e.to_string()))?;
            app.converter.convert(message, app.mount.upside_down).map_err(|e| malformed(&e))
        })
    }

    /// Answers a point cloud as [`Self::on_scan`] does a scan.
    pub fn on_cloud(&mut self, message: &PointCloud2, arrival: Duration) -> Estimate {
        self.answer(&message.header, arrival, |app| {
            let scan = cloud::scan(message, &app.config.cloud, &app.mount.level_from_laser).map_err(|e| malformed(&e))?;
            scan.masked(app.converter.mask()).map_err(|e| malformed(&e))
        })
    }

    /// Answers whichever of the two it is.
    pub fn on_sensed(&mut self, message: &Sensed, arrival: Duration) -> Estimate {
        match message {
            Sensed::Scan(scan) => self.on_scan(scan, arrival),
            Sensed::Cloud(cloud) => self.on_cloud(cloud, arrival),
        }
    }

    fn answer(
        &mut self,
        header: &Header,
        arrival: Duration,
        convert: impl FnOnce(&mut Self) -> Result<Scan, Failure>,
    ) -> Estimate {
        let stamp = header.stamp.into();
        self.counters.scans += 1;
        if let Some(set) = self.initial_pose.take_if(|set| set.precedes(stamp, arrival)) {
            self.odometry.set_pose(set.pose, set.held_at(stamp, arrival));
        }
        let task = Task { contract: self.contract, arrival, taken_up: self.clock.now() };
        self.update_mount(&header.frame_id);
        let scan = convert(self);
        self.remarks.extend(self.converter.take_oddities().iter().map(ToString::to_string));
        let mut driver = Driver::new(task, &*self.clock, &*self.interrupt, &mut self.costs);
        let registration = match scan {
            Ok(scan) => self.odometry.register(&scan, &self.mount.base_from_laser, &mut driver),
            Err(problem) => {
                self.counters.malformed_scans += 1;
                self.odometry.answer_unusable(stamp, problem)
            }
        };
        let refined = driver.refined();
        let elapsed = self.clock.now().saturating_sub(arrival);
        let (contract, expected_error) = (self.contract, self.expected_error());
        Estimate { stamp, registration, contract, expected_error, outside_profile: None, elapsed, arrival, refined }
    }

    /// The scan of a message that has just been answered; `None` where it is malformed.
    pub fn scan(&mut self, message: &Sensed) -> Option<Scan> {
        message.scan(&mut self.converter, &self.config.cloud, &self.mount)
    }

    /// That scan as the laser would have seen it at its stamp.
    pub fn undistorted(&self, scan: Scan) -> Scan {
        self.odometry.undistorted(&scan, &self.mount.base_from_laser).unwrap_or(scan)
    }

    /// What is odd in the messages so far and was not said before; each kind of it is said once.
    pub fn take_remarks(&mut self) -> Vec<String> {
        std::mem::take(&mut self.remarks)
    }

    /// To be called once the pose of `estimate` has been handed over: takes the time.
    pub fn conclude(&mut self, estimate: &mut Estimate) {
        if let Some(report) = &estimate.registration.refinement {
            self.clock.worked(Phase::Closing, report.rays_used as usize);
        }
        let now = self.clock.now();
        estimate.elapsed = now.saturating_sub(estimate.arrival);
        self.counters.deadline_misses += u64::from(!estimate.deadline_met());
        if let (Some(report), Some(refined)) = (&estimate.registration.refinement, estimate.refined) {
            self.costs.observe(Phase::Closing, report.rays_used as usize, now.saturating_sub(refined));
        }
        if let (Some(watch), Some(conditions)) = (&mut self.watch, estimate.conditions()) {
            estimate.outside_profile = watch.add(&conditions);
        }
    }

    /// How long to hold back a scan of this stamp for odometry that it needs and that has not come yet; `None`: answer it now. A scan
    /// that is answered all the same is predicted with what odometry there is.
    pub fn wait_for_odometry(&self, stamp: Stamp) -> Option<Duration> {
        let wait = self.contract.patience(Duration::from_secs_f64(self.config.odometry.max_wait.0));
        (!wait.is_zero() && self.odometry.awaits_odometry(stamp)).then_some(wait)
    }

    /// Work that can wait until an answer is out: the next scan is answered sooner and better for it. `interrupt`: the next scan is
    /// here.
    pub fn maintain(&mut self, interrupt: &dyn Interrupt) {
        let now = self.clock.now();
        let task = Task { contract: Contract::default(), arrival: now, taken_up: now };
        let mut driver = Driver::new(task, &*self.clock, interrupt, &mut self.costs);
        if self.config.contract.finish_after_answer {
            self.odometry.finish(&mut driver);
        }
        self.odometry.maintain();
        self.odometry.close_loop(&mut driver);
        self.costs.learn();
    }

    /// Takes wheel odometry.
    pub fn on_odometry(&mut self, message: &Odometry) -> Result<(), InputError> {
        let sample = intake::wheel_sample(message, &self.transforms, &self.config.frames);
        let sample = self.count_refused(sample)?;
        self.odometry.add_wheel_sample(sample);
        Ok(())
    }

    /// Takes transforms, static or not.
    pub fn on_transforms(&mut self, message: &TFMessage) -> Result<(), InputError> {
        let count = self.transforms.add(message);
        self.predict_from(message);
        self.count_refused(if count == 0 { Ok(()) } else { Err(InputError::BadTransforms { count }) })
    }

    /// Where another node's transforms say the base is, if these are to predict.
    fn predict_from(&mut self, message: &TFMessage) {
        let FrameKnobs { prediction_frame: Some(frame), base_frame, .. } = &self.config.frames else { return };
        let mut moved = message.transforms.iter().filter(|moved| self.transforms.carries(&moved.child_frame_id, base_frame));
        if let (Some(moved), Some(place)) = (moved.next(), self.transforms.mount(frame, base_frame)) {
            let stamp = moved.header.stamp.into();
            self.odometry.add_transform_sample(WheelSample { stamp, pose: place.base_from_laser, twist: None });
        }
    }

    /// Takes a reading of the IMU; one that says nothing (some simulators publish zeros) is let pass.
    pub fn on_imu(&mut self, message: &Imu) -> Result<(), InputError> {
        let mount = self.transforms.mount(&self.config.frames.base_frame, &message.header.frame_id);
        let reading = heading::reading(message, mount.is_some_and(|mount| mount.upside_down));
        if let Some(reading) = self.count_refused(reading)? {
            self.odometry.add_heading(reading);
        }
        Ok(())
    }

    /// Takes the velocity of the base as it is now: the prediction where there is no odometry.
    pub fn on_velocity(&mut self, message: &Twist) -> Result<(), InputError> {
        let twist = Twist2 { vx: message.linear.x, vy: message.linear.y, omega: message.angular.z };
        self.count_refused(if twist.is_finite() { Ok(()) } else { Err(InputError::VelocityNotFinite) })?;
        self.odometry.set_velocity(twist);
        Ok(())
    }

    /// Takes a contract; in force from the next scan on.
    pub fn on_contract(&mut self, message: &own::Contract) -> Result<(), InputError> {
        self.contract = self.count_refused(Contract::try_from(message).map_err(InputError::from))?;
        Ok(())
    }

    /// Another contract; in force from the next scan on.
    pub fn set_contract(&mut self, contract: Contract) {
        self.contract = contract;
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
        (self.mount, self.mount_source)
    }

    /// The transforms known.
    pub fn transforms(&self) -> &TransformTree {
        &self.transforms
    }

    /// The contract in force.
    pub fn contract(&self) -> Contract {
        self.contract
    }

    /// The configuration it was made with.
    pub fn config(&self) -> &Config {
        &self.config
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

    /// Where the laser of this scan is on the base: every scan has its own place, which may move.
    fn update_mount(&mut self, laser_frame: &str) {
        let parameter = self.config.odometry.laser_in_base;
        if let Some(mount) = self.transforms.laser_mount(&self.config.frames.base_frame, laser_frame, parameter) {
            self.mount = mount;
            if parameter.is_none() {
                self.mount_source = MountSource::Transforms;
            }
        }
        self.note_mount_jump(laser_frame);
    }

    fn note_mount_jump(&mut self, laser_frame: &str) {
        let place = self.mount.base_from_laser;
        let Some((_, before)) = self.last_mount.as_mut().filter(|(frame, _)| frame == laser_frame) else {
            self.last_mount = Some((laser_frame.into(), place));
            return;
        };
        let motion = std::mem::replace(before, place).between(&place);
        if !self.mount_jumped && (motion.distance() > MOUNT_JUMP || motion.theta.abs() > MOUNT_JUMP) {
            self.mount_jumped = true;
            let (distance, degrees) = (motion.distance(), motion.theta.to_degrees());
            self.remarks.push(format!(
                "by tf the laser '{laser_frame}' moved on the base by {distance:.3} m and {degrees:.1} degrees from one scan to the next: \
                 poses follow tf (is it published by one node only?)"
            ));
        }
    }
}

fn malformed(problem: &dyn std::fmt::Display) -> Failure {
    Failure::new(FailureReason::MalformedScan, format!("malformed scan: {problem}"))
}

/// The pose in the plane that a message holds.
pub fn planar_pose(pose: &Pose) -> Result<Pose2, InputError> {
    let yaw = yaw(&pose.orientation)?;
    let planar = Pose2::new(pose.position.x, pose.position.y, yaw);
    if planar.is_finite() { Ok(planar) } else { Err(InputError::PoseNotFinite) }
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

/// A twist of zeros says nothing: that is how drivers without velocities leave it, and a robot at rest needs none.
fn planar_twist(twist: &Twist) -> Option<Twist2> {
    let planar = Twist2 { vx: twist.linear.x, vy: twist.linear.y, omega: twist.angular.z };
    (planar.is_finite() && planar != Twist2::default()).then_some(planar)
}
