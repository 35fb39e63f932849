//! Localization as a whole: messages in, poses on the map out.

use std::sync::Arc;
use std::time::Duration;

use thiserror::Error;

use super::initial_pose::InitialPose;
use super::sensed::Sensed;
use super::{InputError, MountSource, intake, planar_pose};
use crate::anytime::clock::Clock;
use crate::anytime::contract::{Contract, ContractError};
use crate::anytime::cost_model::{CostModel, Phase};
use crate::anytime::interrupt::{Interrupt, Never};
use crate::anytime::{Driver, Task};
use crate::cloud::{self, CloudError};
use crate::config::Config;
use crate::geometry::{Pose2, PoseCovariance, Twist2};
use crate::localization::filter::{Belief, ParticleFilter};
use crate::localization::observation::Observation;
use crate::map::grid::{Cell, OccupancyGrid};
use crate::matching::StopReason;
use crate::messages::geometry_msgs::{PointStamped, PoseWithCovarianceStamped};
use crate::messages::nav_msgs::Odometry;
use crate::messages::own;
use crate::messages::sensor_msgs::{LaserScan, PointCloud2};
use crate::messages::std_msgs::Header;
use crate::messages::tf2_msgs::TFMessage;
use crate::odometry::wheel::WheelOdometry;
use crate::scan::{Scan, ScanConverter, ScanError};
use crate::time::Stamp;
use crate::transforms::{Mount, TiltedMount, TransformTree, frame_name};

/// Over a longer time than this the last velocity says nothing, s.
const LONGEST_GUESS: f64 = 0.5;
/// Stamps that go back by more than this are no disorder: time has begun anew, as a bag that is played again, s.
const NEW_TIME: f64 = 2.0;
/// Scans of the practice before the first one, for each of some numbers of particles.
const PRACTICE_SCANS: usize = 6;

/// Why there is no localizer.
#[derive(Debug, Error)]
pub enum LocalizerError {
    /// The system gives no threads.
    #[error("cannot start the threads of the particle filter (localization.threads): {0}")]
    Threads(#[source] std::io::Error),
    /// The contract of the configuration is none.
    #[error(transparent)]
    Contract(#[from] ContractError),
    /// There is no place for a robot.
    #[error("no cell of the map is free: are its thresholds right (free_thresh, occupied_thresh), and negate?")]
    NothingFree,
}

/// A scan that cannot be used as evidence. The belief stays as it was.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum NoEvidence {
    /// The message is malformed.
    #[error("malformed scan: {0}")]
    Malformed(#[from] ScanError),
    /// The cloud is malformed, or holds nothing at the right height.
    #[error("malformed scan: {0}")]
    MalformedCloud(#[from] CloudError),
    /// The laser does not look along the floor.
    #[error(transparent)]
    Tilted(#[from] TiltedMount),
    /// The scan, or a later one, has been used before.
    #[error("the scan's stamp is not later than that of the one before: nothing is evidence twice")]
    NotNewer,
}

impl NoEvidence {
    /// Its kind, for programs.
    pub fn code(&self) -> &'static str {
        match self {
            Self::Malformed(_) | Self::MalformedCloud(_) => "malformed_scan",
            Self::Tilted(_) => "tilted_mount",
            Self::NotNewer => "not_newer",
        }
    }
}

/// What came of a scan.
#[derive(Clone, Debug)]
pub struct Fix {
    /// The scan's stamp.
    pub stamp: Stamp,
    /// The belief, or why the scan was of no use.
    pub belief: Result<Belief, NoEvidence>,
    /// What ended the work on it: `Converged`, all beams are taken in.
    pub stop_reason: Option<StopReason>,
    /// The contract that was in force.
    pub contract: Contract,
    /// Time from the scan's arrival to this answer; once it is concluded, to its being handed over.
    pub elapsed: Duration,
    arrival: Duration,
    /// Reading of the clock when the last beams were taken in.
    refined: Option<Duration>,
}

impl Fix {
    /// How much later than asked for the answer is.
    pub fn overrun(&self) -> Duration {
        self.contract.overrun(self.elapsed)
    }
}

/// A robot on a map.
pub struct Localizer {
    config: Config,
    clock: Arc<dyn Clock>,
    costs: CostModel,
    contract: Contract,
    filter: ParticleFilter,
    wheel: WheelOdometry,
    /// The last odometry: stamp and pose in its own frame.
    odometer: Option<(Stamp, Pose2)>,
    converter: ScanConverter,
    remarks: Vec<String>,
    transforms: TransformTree,
    mount: Mount,
    mount_source: MountSource,
    /// A pose that was set and its covariance, until the first scan after it.
    initial_pose: Option<InitialPose<(Pose2, PoseCovariance)>>,
    /// Stamp of the scan used last, and where the robot was then.
    last: Option<(Stamp, Pose2)>,
    twist: Twist2,
    without_odometry: u64,
    deadline_misses: u64,
}

impl Localizer {
    /// A robot where the configuration says, or that may be anywhere on the map.
    pub fn new(map: OccupancyGrid, config: &Config, clock: Arc<dyn Clock>) -> Result<Self, LocalizerError> {
        let parameter = config.odometry.laser_in_base;
        Ok(Self {
            filter: filter_on(map, config)?,
            clock,
            costs: CostModel::new(config.contract.confidence),
            contract: Contract::try_from(&config.contract)?,
            config: config.clone(),
            wheel: WheelOdometry::default(),
            odometer: None,
            converter: ScanConverter::new(&config.scan),
            remarks: Vec::new(),
            transforms: TransformTree::default(),
            mount: Mount { base_from_laser: parameter.unwrap_or_default(), ..Mount::default() },
            mount_source: if parameter.is_some() { MountSource::Parameter } else { MountSource::Assumed },
            initial_pose: None,
            last: None,
            twist: Twist2::default(),
            without_odometry: 0,
            deadline_misses: 0,
        })
    }

    /// Gets ready for the first scan by practice on the map, whereby the costs of an answer become known. To be called first of all.
    pub fn warm_up(&mut self) {
        let beams = self.config.sensor.beams as usize;
        let most = self.config.localization.particles;
        for particles in [most, most / 4, most / 16, most / 64].map(|count| count.max(1)) {
            for _ in 0..PRACTICE_SCANS {
                let observation = self.filter.practise(particles, beams);
                let now = self.clock.now();
                let task = Task { contract: Contract::default(), arrival: now, taken_up: now };
                let mut driver = Driver::new(task, &*self.clock, &Never, &mut self.costs);
                self.filter.predict(&Pose2::new(0.1, 0.0, 0.0), 0.025);
                self.filter.update(observation, &Pose2::IDENTITY, &mut driver);
                let refined = driver.refined().unwrap_or(now);
                self.clock.worked(Phase::Closing, particles as usize);
                let closing = self.clock.now().saturating_sub(refined);
                self.filter.finish(false, &mut driver);
                self.costs.observe(Phase::Closing, particles as usize, closing);
            }
        }
        self.costs.learn();
        self.filter.begin_anew();
        begin(&mut self.filter, &self.config);
    }

    /// Another map of the same place: the robot is where it was.
    pub fn replace_map(&mut self, map: OccupancyGrid) -> Result<(), LocalizerError> {
        self.filter = filter_on(map, &self.config)?;
        if let Some((_, map_from_base)) = self.last {
            self.filter.start_at(&map_from_base, None);
        }
        Ok(())
    }

    /// Transforms that came before the map did.
    pub fn set_transforms(&mut self, transforms: TransformTree) {
        self.transforms = transforms;
    }

    /// Takes a scan that arrived when the clock read `arrival`: moves the particles to its time, and corrects them by it.
    /// [`Self::conclude`] and [`Self::maintain`] are to follow. `interrupt`: somebody wants the answer now.
    pub fn on_scan(&mut self, message: &LaserScan, arrival: Duration, interrupt: &dyn Interrupt) -> Fix {
        self.answer(&message.header, arrival, interrupt, |localizer| {
            localizer.mount.check_level(&localizer.config.frames.base_frame, &message.header.frame_id)?;
            Ok(localizer.converter.convert(message, localizer.mount.upside_down)?)
        })
    }

    /// Takes a point cloud as [`Self::on_scan`] does a scan.
    pub fn on_cloud(&mut self, message: &PointCloud2, arrival: Duration, interrupt: &dyn Interrupt) -> Fix {
        self.answer(&message.header, arrival, interrupt, |localizer| {
            Ok(cloud::scan(message, &localizer.config.cloud, &localizer.mount.level_from_laser)?)
        })
    }

    /// Takes whichever of the two it is.
    pub fn on_sensed(&mut self, message: &Sensed, arrival: Duration, interrupt: &dyn Interrupt) -> Fix {
        match message {
            Sensed::Scan(scan) => self.on_scan(scan, arrival, interrupt),
            Sensed::Cloud(cloud) => self.on_cloud(cloud, arrival, interrupt),
        }
    }

    fn answer(
        &mut self,
        header: &Header,
        arrival: Duration,
        interrupt: &dyn Interrupt,
        convert: impl FnOnce(&mut Self) -> Result<Scan, NoEvidence>,
    ) -> Fix {
        let (stamp, taken_up) = (Stamp::from(header.stamp), self.clock.now());
        if let Some(InitialPose { pose: (map_from_base, covariance), .. }) =
            self.initial_pose.take_if(|set| set.precedes(stamp, arrival))
        {
            self.start_at(&map_from_base, Some(&covariance));
        }
        let task = Task { contract: self.contract, arrival, taken_up };
        let mut fix = Fix {
            stamp,
            belief: Err(NoEvidence::NotNewer),
            stop_reason: None,
            contract: self.contract,
            elapsed: Duration::ZERO,
            arrival,
            refined: None,
        };
        fix.belief = self.observe(header, convert).map(|observation| {
            let (belief, stop_reason, refined) = self.take_in(observation, task, interrupt);
            (fix.stop_reason, fix.refined) = (Some(stop_reason), refined);
            belief
        });
        fix.elapsed = self.clock.now().saturating_sub(arrival);
        fix
    }

    /// What a scan shows, if it is new.
    fn observe(
        &mut self,
        header: &Header,
        convert: impl FnOnce(&mut Self) -> Result<Scan, NoEvidence>,
    ) -> Result<Observation, NoEvidence> {
        let stamp = Stamp::from(header.stamp);
        let since_last = self.last.map(|(last, _)| stamp.seconds_since(last));
        if since_last.is_some_and(|seconds| (-NEW_TIME..=0.0).contains(&seconds)) {
            return Err(NoEvidence::NotNewer);
        }
        self.update_mount(&header.frame_id);
        let scan = convert(self);
        self.remarks.extend(self.converter.take_oddities().iter().map(ToString::to_string));
        let scan = scan?;
        self.last.take_if(|_| since_last.is_some_and(|seconds| seconds < 0.0));
        Ok(Observation::new(&scan, self.config.sensor.beams as usize))
    }

    fn take_in(
        &mut self,
        observation: Observation,
        task: Task,
        interrupt: &dyn Interrupt,
    ) -> (Belief, StopReason, Option<Duration>) {
        let stamp = observation.stamp;
        let motion = self.last.map(|(last, _)| (self.motion(last, stamp), stamp.seconds_since(last)));
        let mut driver = Driver::new(task, &*self.clock, interrupt, &mut self.costs);
        self.filter.plan(observation.len(), &driver);
        if let Some((motion, seconds)) = motion {
            self.twist = Twist2::of_motion(&motion, seconds);
            self.filter.predict(&motion, seconds);
        }
        let (belief, stop_reason) = self.filter.update(observation, &self.mount.base_from_laser, &mut driver);
        self.last = Some((stamp, belief.map_from_base));
        (belief, stop_reason, driver.refined())
    }

    /// To be called once the belief of `fix` has been handed over: takes the time.
    pub fn conclude(&mut self, fix: &mut Fix) {
        if let Ok(belief) = &fix.belief {
            self.clock.worked(Phase::Closing, belief.particles);
        }
        let now = self.clock.now();
        fix.elapsed = now.saturating_sub(fix.arrival);
        if let (Ok(belief), Some(refined)) = (&fix.belief, fix.refined) {
            self.deadline_misses += u64::from(!fix.overrun().is_zero());
            self.costs.observe(Phase::Closing, belief.particles, now.saturating_sub(refined));
        }
    }

    /// Work that can wait until an answer is out. `interrupt`: the next scan is here.
    pub fn maintain(&mut self, interrupt: &dyn Interrupt) {
        let now = self.clock.now();
        let task = Task { contract: Contract::default(), arrival: now, taken_up: now };
        let mut driver = Driver::new(task, &*self.clock, interrupt, &mut self.costs);
        self.filter.finish(self.config.contract.finish_after_answer, &mut driver);
        self.costs.learn();
    }

    /// By odometry; where it is silent, as before.
    fn motion(&mut self, from: Stamp, to: Stamp) -> Pose2 {
        self.wheel.motion(from, to).unwrap_or_else(|| {
            self.without_odometry += 1;
            self.twist.motion(to.seconds_since(from).min(LONGEST_GUESS))
        })
    }

    /// The pose of the last answer, carried on by odometry to another time; `None` where there is no answer, or no odometry.
    pub fn carried_to(&self, stamp: Stamp) -> Option<Pose2> {
        let (last, map_from_base) = self.last?;
        Some(map_from_base * self.wheel.motion(last, stamp)?)
    }

    /// Where odometry has the robot at a time, in its own frame.
    pub fn odom_from_base(&self, stamp: Stamp) -> Option<Pose2> {
        let (last, pose) = self.odometer?;
        match self.wheel.motion(stamp, last) {
            Some(motion) => Some(pose * motion.inverse()),
            None => Some(pose * self.wheel.motion(last, stamp)?),
        }
    }

    /// Velocity of the base: the motion between the last two scans.
    pub fn twist(&self) -> Twist2 {
        self.twist
    }

    /// Stamp of the newest odometry.
    pub fn odometry_stamp(&self) -> Option<Stamp> {
        self.odometer.map(|(stamp, _)| stamp)
    }

    /// How long to hold back a scan of this stamp for odometry that has not come yet; `None`: take it now.
    pub fn wait_for_odometry(&self, stamp: Stamp) -> Option<Duration> {
        let wait = self.contract.patience(Duration::from_secs_f64(self.config.odometry.max_wait.0));
        (!wait.is_zero() && self.wheel.is_behind(stamp)).then_some(wait)
    }

    /// Takes wheel odometry.
    pub fn on_odometry(&mut self, message: &Odometry) -> Result<(), InputError> {
        let sample = intake::wheel_sample(message, &self.transforms, &self.config.frames)?;
        self.wheel.push(sample);
        self.odometer = Some((sample.stamp, sample.pose));
        Ok(())
    }

    /// Takes transforms, static or not.
    pub fn on_transforms(&mut self, message: &TFMessage) -> Result<(), InputError> {
        let count = self.transforms.add(message);
        if count == 0 { Ok(()) } else { Err(InputError::BadTransforms { count }) }
    }

    /// Takes the pose of the base, as a person sets it in `RViz`, which came when the clock read `arrival`: the robot is there when the
    /// next scan after it is taken.
    pub fn on_initial_pose(&mut self, message: &PoseWithCovarianceStamped, arrival: Duration) -> Result<(), InputError> {
        self.check_frame(&message.header.frame_id)?;
        let pose = planar_pose(&message.pose.pose)?;
        self.check_place(&pose)?;
        let of = |row: usize, column: usize| message.pose.covariance[6 * row + column];
        let covariance = PoseCovariance::from_fn(|row, column| of([0, 1, 5][row], [0, 1, 5][column]));
        self.initial_pose = Some(InitialPose::new((pose, covariance), &message.header, arrival));
        Ok(())
    }

    /// Takes a place, as a person clicks on it in `RViz`: the robot is there, in whatever direction.
    pub fn on_clicked_point(&mut self, message: &PointStamped) -> Result<(), InputError> {
        self.check_frame(&message.header.frame_id)?;
        let pose = Pose2::new(message.point.x, message.point.y, 0.0);
        if !pose.is_finite() {
            return Err(InputError::PoseNotFinite);
        }
        self.check_place(&pose)?;
        self.initial_pose = None;
        self.filter.start_in_place(&pose);
        Ok(())
    }

    /// Takes a contract; in force from the next scan on.
    pub fn on_contract(&mut self, message: &own::Contract) -> Result<(), InputError> {
        self.contract = Contract::try_from(message)?;
        Ok(())
    }

    /// Another contract; in force from the next scan on.
    pub fn set_contract(&mut self, contract: Contract) {
        self.contract = contract;
    }

    /// The contract in force.
    pub fn contract(&self) -> Contract {
        self.contract
    }

    /// The configuration it was made with.
    pub fn config(&self) -> &Config {
        &self.config
    }

    /// The robot is near `map_from_base`; how near, says `covariance`, or the configuration.
    pub fn start_at(&mut self, map_from_base: &Pose2, covariance: Option<&PoseCovariance>) {
        self.initial_pose = None;
        self.filter.start_at(map_from_base, covariance);
    }

    /// The robot may be anywhere.
    pub fn spread(&mut self) {
        self.initial_pose = None;
        self.filter.spread();
    }

    /// The filter.
    pub fn filter(&self) -> &ParticleFilter {
        &self.filter
    }

    /// Place of the laser on the base, and where that is known from.
    pub fn mount(&self) -> (Mount, MountSource) {
        (self.mount, self.mount_source)
    }

    /// Scans that odometry did not cover.
    pub fn without_odometry(&self) -> u64 {
        self.without_odometry
    }

    /// Answers later than the time budget.
    pub fn deadline_misses(&self) -> u64 {
        self.deadline_misses
    }

    fn update_mount(&mut self, laser_frame: &str) {
        let parameter = self.config.odometry.laser_in_base;
        if let Some(mount) = self.transforms.laser_mount(&self.config.frames.base_frame, laser_frame, parameter) {
            self.mount = mount;
            if parameter.is_none() {
                self.mount_source = MountSource::Transforms;
            }
        }
    }

    /// What is odd in the messages so far and was not said before; each kind of it is said once.
    pub fn take_remarks(&mut self) -> Vec<String> {
        std::mem::take(&mut self.remarks)
    }

    /// A place is given in the frame of the map; some programs leave the frame empty.
    fn check_frame(&self, frame: &str) -> Result<(), InputError> {
        let (frame, expected) = (frame_name(frame), frame_name(&self.config.frames.map_frame));
        if frame.is_empty() || frame == expected {
            return Ok(());
        }
        Err(InputError::WrongFrame { frame: frame.into(), expected: expected.into() })
    }

    fn check_place(&self, map_from_base: &Pose2) -> Result<(), InputError> {
        let cell = self.filter.map().coordinates(map_from_base.translation());
        #[allow(clippy::cast_possible_truncation)] // saturates: outside any map
        match self.filter.map().cell(cell.x.floor() as i64, cell.y.floor() as i64) {
            Some(_) => Ok(()),
            None => Err(InputError::OutsideMap { x: map_from_base.x, y: map_from_base.y }),
        }
    }
}

fn filter_on(map: OccupancyGrid, config: &Config) -> Result<ParticleFilter, LocalizerError> {
    if !map.cells().contains(&Cell::Free) {
        return Err(LocalizerError::NothingFree);
    }
    let mut filter =
        ParticleFilter::new(map, &config.localization, &config.motion, &config.sensor).map_err(LocalizerError::Threads)?;
    begin(&mut filter, config);
    Ok(filter)
}

/// Puts the robot where the configuration says; without a word of it, the robot may be anywhere.
fn begin(filter: &mut ParticleFilter, config: &Config) {
    if let Some(map_from_base) = &config.localization.initial_pose {
        filter.start_at(map_from_base, None);
    }
}
