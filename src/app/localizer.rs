//! The particle filter as an application: messages in, poses on the map out.

use std::sync::Arc;
use std::time::Duration;

use thiserror::Error;

use super::initial_pose::InitialPose;
use super::intake::{Intake, UnusableScan};
use super::motion_by_scans::ScanMotion;
use super::sensed::SensorMessage;
use super::{InputError, MountSource, ScanProcessor, planar_pose};
use crate::anytime::clock::Clock;
use crate::anytime::contract::{Contract, ContractError};
use crate::anytime::interrupt::{Interrupt, NeverInterrupt};
use crate::anytime::{ContractRunner, ScanContract};
use crate::config::Config;
use crate::geometry::{Pose2, PoseCovariance, Twist2};
use crate::localization::observation::Observation;
use crate::localization::{estimate::Belief, filter::ParticleFilter};
use crate::map::grid::{Cell, OccupancyGrid};
use crate::matching::StopReason;
use crate::messages::geometry_msgs::{PointStamped, PoseWithCovarianceStamped, planar_covariance};
use crate::messages::nav_msgs::Odometry;
use crate::messages::own;
use crate::messages::sensor_msgs::LaserScan;
use crate::messages::std_msgs::Header;
use crate::messages::tf2_msgs::TFMessage;
use crate::odometry::counted_in_words;
use crate::odometry::sources::MotionSources;
use crate::odometry::sweep::Sweep;
use crate::odometry::wheel::WheelEvent;
use crate::scan::Scan;
use crate::time::{Continuity, Stamp, Step};
use crate::transforms::{Mount, TransformTree, frame_name};

/// Maximum time between scans for the motion model, s. After a longer gap the uncertainty is that of this time; a stamp may also
/// be wrong.
const MAX_GAP: f64 = 10.0;
/// Maximum time that the last velocity is extrapolated, s.
const MAX_EXTRAPOLATION: f64 = 0.5;
/// Scans of the warm-up for each number of particles.
const WARM_UP_SCANS: usize = 6;

/// Why a localizer cannot be created.
#[derive(Debug, Error)]
pub enum LocalizerError {
    /// The system cannot start the threads.
    #[error("cannot start the threads of the particle filter (localization.threads): {0}")]
    Threads(#[source] std::io::Error),
    /// The contract of the configuration is invalid.
    #[error(transparent)]
    Contract(#[from] ContractError),
    /// The map has no free cell.
    #[error("no cell of the map is free: are its thresholds right (free_thresh, occupied_thresh), and negate?")]
    NothingFree,
}

/// Why a scan is not used. The belief stays as it was.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum RejectedScan {
    /// The scan is unusable.
    #[error(transparent)]
    Unusable(#[from] UnusableScan),
    /// This scan or a later one has been used already.
    #[error("the scan's stamp is not later than that of the previous scan: every scan is used only once")]
    NotNewer,
}

impl RejectedScan {
    /// The code of the failure, for programs.
    pub fn code(&self) -> &'static str {
        match self {
            Self::Unusable(problem) => problem.reason().name(),
            Self::NotNewer => "not_newer",
        }
    }
}

/// The result for one scan.
#[derive(Clone, Debug)]
pub struct Fix {
    /// The scan's stamp.
    pub stamp: Stamp,
    /// The belief, or why the scan was not used.
    pub belief: Result<Belief, RejectedScan>,
    /// Why the work on the scan ended; `Converged`: all beams were processed.
    pub stop_reason: Option<StopReason>,
    /// The contract that was in force.
    pub contract: Contract,
    /// Time from the scan's arrival to this answer; after `conclude`, to its publication.
    pub elapsed: Duration,
    arrival: Duration,
    /// Reading of the clock when the last beams had been processed.
    refined: Option<Duration>,
}

impl Fix {
    /// How much the answer exceeded the time budget.
    pub fn overrun(&self) -> Duration {
        self.contract.overrun(self.elapsed)
    }
}

/// Localizes a robot on a map.
pub struct Localizer {
    intake: Intake,
    interrupt: Arc<dyn Interrupt>,
    filter: ParticleFilter,
    sources: MotionSources,
    scan_motion: ScanMotion,
    /// A pose set by the user, with its covariance, kept until the first scan after it.
    initial_pose: Option<InitialPose<(Pose2, PoseCovariance)>>,
    /// Stamp of the last scan that was used; before that, of the first one that was not. The robot's motion counts from here.
    last: Option<Stamp>,
    /// Estimated pose at the last scan that was used.
    last_pose: Option<Pose2>,
    stamps: Continuity,
    twist: Twist2,
    without_odometry: u64,
    clock_steps: u64,
    new_runs: u64,
    deadline_misses: u64,
}

impl Localizer {
    /// Starts at the initial pose of the configuration, or else anywhere on the map.
    pub fn new(map: OccupancyGrid, config: &Config, clock: Arc<dyn Clock>) -> Result<Self, LocalizerError> {
        Ok(Self {
            filter: filter_on(map, config)?,
            intake: Intake::new(config, clock)?,
            interrupt: Arc::new(NeverInterrupt),
            sources: MotionSources::default(),
            scan_motion: ScanMotion::new(config),
            initial_pose: None,
            last: None,
            last_pose: None,
            stamps: Continuity::default(),
            twist: Twist2::default(),
            without_odometry: 0,
            clock_steps: 0,
            new_runs: 0,
            deadline_misses: 0,
        })
    }

    /// Sets the interrupt that may end the work on a scan early.
    pub fn set_interrupt(&mut self, interrupt: Arc<dyn Interrupt>) {
        self.interrupt = interrupt;
    }

    /// Prepares for the first scan: processes simulated scans on the map to learn the costs of an answer. Call it before anything
    /// else.
    pub fn warm_up(&mut self) {
        let beams = self.intake.config.sensor.beams as usize;
        let all = self.intake.config.localization.particles;
        for particles in [all, all / 4, all / 16, all / 64].map(|count| count.max(1)) {
            for _ in 0..WARM_UP_SCANS {
                let observation = self.filter.prepare_warm_up(particles, beams);
                let scan_contract = self.intake.unlimited_contract();
                let Intake { clock, costs, .. } = &mut self.intake;
                let mut runner = ContractRunner::new(scan_contract, &**clock, &NeverInterrupt, costs);
                self.filter.predict(&Pose2::new(0.1, 0.0, 0.0), 0.025);
                self.filter.update(observation, &Pose2::IDENTITY, &mut runner);
                let refined = runner.last_step_end();
                self.intake.conclude(scan_contract.arrival, refined, Some(particles as usize));
                let Intake { clock, costs, .. } = &mut self.intake;
                self.filter.finish(false, &mut ContractRunner::new(scan_contract, &**clock, &NeverInterrupt, costs));
            }
        }
        self.intake.costs.learn();
        self.filter.reset();
        set_initial_pose(&mut self.filter, &self.intake.config);
    }

    /// Replaces the map by another one of the same environment: the robot stays where it was.
    pub fn replace_map(&mut self, map: OccupancyGrid) -> Result<(), LocalizerError> {
        self.filter = filter_on(map, &self.intake.config)?;
        if let Some(map_from_base) = self.last_pose {
            self.filter.start_at(&map_from_base, None);
        }
        Ok(())
    }

    /// Sets the transforms that arrived before the map.
    pub fn set_transforms(&mut self, transforms: TransformTree) {
        self.intake.transforms = transforms;
    }

    /// Processes a scan that arrived when the clock read `arrival`: moves the particles to its time, and weights them by it. The
    /// caller must then call [`Self::conclude`] and [`Self::maintain`]. `interrupt` may end the work early.
    pub fn on_scan(&mut self, message: &LaserScan, arrival: Duration, interrupt: &dyn Interrupt) -> Fix {
        self.fix(&message.header, arrival, interrupt, |intake| intake.scan(message))
    }

    fn fix(
        &mut self,
        header: &Header,
        arrival: Duration,
        interrupt: &dyn Interrupt,
        read: impl FnOnce(&mut Intake) -> Result<Scan, UnusableScan>,
    ) -> Fix {
        let (stamp, scan_contract) = (Stamp::from(header.stamp), self.intake.scan_contract(arrival));
        if let Some(InitialPose { pose: (map_from_base, covariance), .. }) =
            self.initial_pose.take_if(|set| set.precedes(stamp, arrival))
        {
            self.start_at(&map_from_base, Some(&covariance));
        }
        let mut fix = Fix {
            stamp,
            belief: Err(RejectedScan::NotNewer),
            stop_reason: None,
            contract: scan_contract.contract,
            elapsed: Duration::ZERO,
            arrival,
            refined: None,
        };
        fix.belief = self.read_new_scan(stamp, read).map(|scan| {
            let (belief, stop_reason, refined) = self.process(&scan, scan_contract, interrupt);
            (fix.stop_reason, fix.refined) = (Some(stop_reason), refined);
            belief
        });
        fix.elapsed = self.intake.clock.now().saturating_sub(arrival);
        fix
    }

    /// Reads the scan, and checks that it is newer than the last one.
    fn read_new_scan(
        &mut self,
        stamp: Stamp,
        read: impl FnOnce(&mut Intake) -> Result<Scan, UnusableScan>,
    ) -> Result<Scan, RejectedScan> {
        let scan = read(&mut self.intake).inspect_err(|_| {
            self.last.get_or_insert(stamp);
        })?;
        if self.is_new(stamp) { Ok(scan) } else { Err(RejectedScan::NotNewer) }
    }

    /// Undistorts the scan if the robot moved during its sweep.
    fn undistorted(&self, scan: &Scan) -> Option<Scan> {
        let sweep = Sweep::of(scan, &self.intake.config.odometry)?;
        let (start, end) = sweep.span(scan.stamp());
        let motion = self.sources.motion(start, end).unwrap_or_else(|| self.twist.motion(sweep.seconds()));
        Some(sweep.deskewed(scan, &self.intake.mount.base_from_laser, &motion))
    }

    /// Whether a scan with this stamp follows the last one, possibly after the clock was set back. In a new run the robot is
    /// assumed to start where it was, and the motion between the runs is unknown.
    fn is_new(&mut self, stamp: Stamp) -> bool {
        let Some(last) = self.last else { return true };
        match self.stamps.step(stamp, last, self.sources.last_wheel_stamp()) {
            Step::Forward => {}
            Step::SetBack { last } => {
                self.clock_steps += 1;
                self.last = Some(last);
            }
            Step::NewRun => {
                self.new_runs += 1;
                self.last = None;
            }
            Step::Same | Step::Late => return false,
        }
        true
    }

    fn process(
        &mut self,
        scan: &Scan,
        scan_contract: ScanContract,
        interrupt: &dyn Interrupt,
    ) -> (Belief, StopReason, Option<Duration>) {
        let stamp = scan.stamp();
        let motion = self.last.map(|last| (self.motion(last, scan, scan_contract, interrupt), stamp.seconds_since(last)));
        if let Some((motion, seconds)) = motion {
            self.twist = Twist2::from_motion(&motion, seconds);
        }
        let undistorted = self.undistorted(scan);
        let observation = Observation::new(undistorted.as_ref().unwrap_or(scan), self.intake.config.sensor.beams as usize);
        let Intake { clock, costs, mount, .. } = &mut self.intake;
        let mut runner = ContractRunner::new(scan_contract, &**clock, interrupt, costs);
        self.filter.plan(observation.len(), &runner);
        if let Some((motion, seconds)) = motion {
            self.filter.predict(&motion, seconds.min(MAX_GAP));
        }
        let (belief, stop_reason) = self.filter.update(observation, &mount.base_from_laser, &mut runner);
        (self.last, self.last_pose) = (Some(stamp), Some(belief.map_from_base));
        if belief.is_localized() {
            self.sources.learn_lag(stamp, belief.map_from_base);
        }
        (belief, stop_reason, runner.last_step_end())
    }

    /// The motion of the base since the scan taken at `from`: from odometry; without odometry, from scan matching; for the first
    /// scan without odometry, from the last velocity.
    fn motion(&mut self, from: Stamp, scan: &Scan, scan_contract: ScanContract, interrupt: &dyn Interrupt) -> Pose2 {
        let to = scan.stamp();
        self.sources.motion(from, to).unwrap_or_else(|| {
            self.without_odometry += 1;
            let Intake { clock, mount, .. } = &self.intake;
            let scan_motion = self.scan_motion.motion(scan, &mount.base_from_laser, from, scan_contract, (&**clock, interrupt));
            scan_motion.unwrap_or_else(|| self.twist.motion(to.seconds_since(from).min(MAX_EXTRAPOLATION)))
        })
    }

    /// The pose of the last answer, extrapolated by odometry to another time; `None` without an answer or without odometry.
    pub fn extrapolated_to(&self, stamp: Stamp) -> Option<Pose2> {
        Some(self.last_pose? * self.sources.motion(self.last?, stamp)?)
    }

    /// The odometry pose at a time, in the frame and on the clock of the odometry, as its transforms publish it.
    pub fn odom_from_base(&self, stamp: Stamp) -> Option<Pose2> {
        self.sources.wheel_pose(stamp)
    }

    /// Lag of the scans behind the wheel odometry, s: scans show the robot where the wheel odometry had it this much earlier.
    /// Estimated along the path; 0 until there is evidence.
    pub fn odometry_lag(&self) -> f64 {
        self.sources.wheel_lag()
    }

    /// Velocity of the base: the motion between the last two scans.
    pub fn twist(&self) -> Twist2 {
        self.twist
    }

    /// Stamp of the newest odometry.
    pub fn odometry_stamp(&self) -> Option<Stamp> {
        self.sources.last_wheel_stamp()
    }

    /// Handles a pose of the base that the user set in `RViz` and that arrived when the clock read `arrival`: the robot was there
    /// at the next scan taken after it.
    pub fn on_initial_pose(&mut self, message: &PoseWithCovarianceStamped, arrival: Duration) -> Result<(), InputError> {
        self.check_frame(&message.header.frame_id)?;
        let pose = planar_pose(&message.pose.pose)?;
        self.check_on_map(&pose)?;
        let covariance = planar_covariance(&message.pose.covariance);
        self.initial_pose = Some(InitialPose::new((pose, covariance), &message.header, arrival));
        Ok(())
    }

    /// Handles a point that the user clicked in `RViz`: the robot is there with unknown heading.
    pub fn on_clicked_point(&mut self, message: &PointStamped) -> Result<(), InputError> {
        self.check_frame(&message.header.frame_id)?;
        let pose = Pose2::new(message.point.x, message.point.y, 0.0);
        if !pose.is_finite() {
            return Err(InputError::PoseNotFinite);
        }
        self.check_on_map(&pose)?;
        self.initial_pose = None;
        self.filter.start_at_position(&pose);
        Ok(())
    }

    /// Handles a contract; it applies from the next scan on.
    pub fn on_contract(&mut self, message: &own::Contract) -> Result<(), InputError> {
        self.intake.contract = Contract::try_from(message)?;
        Ok(())
    }

    /// Sets the contract; it applies from the next scan on.
    pub fn set_contract(&mut self, contract: Contract) {
        self.intake.contract = contract;
    }

    /// The contract in force.
    pub fn contract(&self) -> Contract {
        self.intake.contract
    }

    /// The configuration of this localizer.
    pub fn config(&self) -> &Config {
        &self.intake.config
    }

    /// Restarts near `map_from_base`, with this covariance, or else with that of the configuration.
    pub fn start_at(&mut self, map_from_base: &Pose2, covariance: Option<&PoseCovariance>) {
        self.initial_pose = None;
        self.filter.start_at(map_from_base, covariance);
    }

    /// Restarts with global localization: the robot may be anywhere on the map.
    pub fn start_globally(&mut self) {
        self.initial_pose = None;
        self.filter.start_globally();
    }

    /// The filter.
    pub fn filter(&self) -> &ParticleFilter {
        &self.filter
    }

    /// The mount of the laser on the base, and where it comes from.
    pub fn mount(&self) -> (Mount, MountSource) {
        (self.intake.mount, self.intake.mount_source)
    }

    /// Describes the events so far for the user, one sentence for each kind that occurred.
    pub fn events_in_words(&self) -> impl Iterator<Item = String> {
        counted_in_words([
            (self.without_odometry, "scans without odometry (their motion came from matching them to earlier scans)"),
            (self.clock_steps, "steps of the clock (the estimate continued from the last pose)"),
            (self.new_runs, "jumps back in time (each started a new run from the last pose)"),
        ])
    }

    /// Number of answers later than the time budget.
    pub fn deadline_misses(&self) -> u64 {
        self.deadline_misses
    }

    /// Checks that a pose is in the map frame; an empty frame is accepted, as some programs leave it so.
    fn check_frame(&self, frame: &str) -> Result<(), InputError> {
        let (frame, expected) = (frame_name(frame), frame_name(&self.intake.config.frames.map_frame));
        if frame.is_empty() || frame == expected {
            return Ok(());
        }
        Err(InputError::WrongFrame { frame: frame.into(), expected: expected.into() })
    }

    /// Rejects a pose outside the map.
    pub fn check_on_map(&self, map_from_base: &Pose2) -> Result<(), InputError> {
        let cell = self.filter.map().coordinates(map_from_base.translation());
        #[allow(clippy::cast_possible_truncation)] // saturates: outside any map
        match self.filter.map().cell(cell.x.floor() as i64, cell.y.floor() as i64) {
            Some(_) => Ok(()),
            None => Err(InputError::OutsideMap { x: map_from_base.x, y: map_from_base.y }),
        }
    }
}

impl ScanProcessor for Localizer {
    type Answer = Fix;

    fn on_sensed(&mut self, message: &SensorMessage, arrival: Duration) -> Fix {
        let interrupt = Arc::clone(&self.interrupt);
        match message {
            SensorMessage::Scan(scan) => self.on_scan(scan, arrival, &*interrupt),
            SensorMessage::Cloud(cloud) => self.fix(&cloud.header, arrival, &*interrupt, |intake| intake.cloud(cloud)),
        }
    }

    fn conclude(&mut self, fix: &mut Fix) {
        let size = fix.belief.as_ref().ok().map(|belief| belief.particles);
        fix.elapsed = self.intake.conclude(fix.arrival, fix.refined, size);
        self.deadline_misses += u64::from(size.is_some() && !fix.overrun().is_zero());
    }

    fn maintain(&mut self, interrupt: &dyn Interrupt) {
        let scan_contract = self.intake.unlimited_contract();
        let Intake { config, clock, costs, .. } = &mut self.intake;
        let mut runner = ContractRunner::new(scan_contract, &**clock, interrupt, costs);
        self.filter.finish(config.contract.finish_after_answer, &mut runner);
        costs.learn();
    }

    fn wait_for_inputs(&self, header: &Header) -> Option<Duration> {
        self.intake.max_wait().filter(|_| self.sources.is_behind(header.stamp.into()) || self.intake.awaits_mount(header))
    }

    fn on_odometry(&mut self, message: &Odometry) -> Result<(), InputError> {
        if let WheelEvent::TimeJump { is_continuous } = self.sources.push(self.intake.wheel_sample(message)?) {
            self.stamps.odometry_went_back(is_continuous);
        }
        Ok(())
    }

    fn on_transforms(&mut self, message: &TFMessage) -> Result<(), InputError> {
        self.intake.on_transforms(message)
    }

    fn take_warnings(&mut self) -> Vec<String> {
        self.intake.take_warnings()
    }
}

fn filter_on(map: OccupancyGrid, config: &Config) -> Result<ParticleFilter, LocalizerError> {
    if !map.cells().contains(&Cell::Free) {
        return Err(LocalizerError::NothingFree);
    }
    let mut filter =
        ParticleFilter::new(map, &config.localization, &config.motion, &config.sensor).map_err(LocalizerError::Threads)?;
    set_initial_pose(&mut filter, config);
    Ok(filter)
}

/// Starts at the initial pose of the configuration; without one, the robot may be anywhere.
fn set_initial_pose(filter: &mut ParticleFilter, config: &Config) {
    if let Some(map_from_base) = &config.localization.initial_pose {
        filter.start_at(map_from_base, None);
    }
}
