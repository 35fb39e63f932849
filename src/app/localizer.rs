//! Localization as a whole: messages in, poses on the map out.

use std::sync::Arc;
use std::time::Duration;

use thiserror::Error;

use super::initial_pose::InitialPose;
use super::intake::{Intake, Unusable};
use super::motion_by_scans::MotionByScans;
use super::sensed::Sensed;
use super::{Answering, InputError, MountSource, planar_pose};
use crate::anytime::clock::Clock;
use crate::anytime::contract::{Contract, ContractError};
use crate::anytime::interrupt::{Interrupt, Never};
use crate::anytime::{Driver, Task};
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

/// After a longer time the robot may be anywhere within its way in this, s: a stamp may also be wrong.
const LONGEST_GAP: f64 = 10.0;
/// The last velocity predicts no longer than this, s.
const LONGEST_GUESS: f64 = 0.5;
/// Scans of the practice before the first one, for each of some numbers of particles.
const PRACTICE_SCANS: usize = 6;

/// Why there is no localizer.
#[derive(Debug, Error)]
pub enum LocalizerError {
    /// The system gives no threads.
    #[error("cannot start the threads of the particle filter (localization.threads): {0}")]
    Threads(#[source] std::io::Error),
    /// The contract of the configuration is invalid.
    #[error(transparent)]
    Contract(#[from] ContractError),
    /// There is no place for a robot.
    #[error("no cell of the map is free: are its thresholds right (free_thresh, occupied_thresh), and negate?")]
    NothingFree,
}

/// A scan that cannot be used as evidence. The belief stays as it was.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum NoEvidence {
    /// It cannot be used at all.
    #[error(transparent)]
    Unusable(#[from] Unusable),
    /// The scan, or a later one, has been used before.
    #[error("the scan's stamp is not later than that of the one before: nothing is evidence twice")]
    NotNewer,
}

impl NoEvidence {
    /// Its code, for programs.
    pub fn code(&self) -> &'static str {
        match self {
            Self::Unusable(Unusable::Malformed(_) | Unusable::MalformedCloud(_)) => "malformed_scan",
            Self::Unusable(Unusable::Tilted(_)) => "tilted_mount",
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
    intake: Intake,
    interrupt: Arc<dyn Interrupt>,
    filter: ParticleFilter,
    sources: MotionSources,
    by_scans: MotionByScans,
    /// A pose that was set and its covariance, until the first scan after it.
    initial_pose: Option<InitialPose<(Pose2, PoseCovariance)>>,
    /// Stamp of the scan used last; before the first one, of the first that was of no use: the robot's motion counts from there.
    last: Option<Stamp>,
    /// Where the robot was at the scan used last.
    believed: Option<Pose2>,
    stamps: Continuity,
    twist: Twist2,
    without_odometry: u64,
    clock_steps: u64,
    new_runs: u64,
    deadline_misses: u64,
}

impl Localizer {
    /// A robot where the configuration says, or that may be anywhere on the map.
    pub fn new(map: OccupancyGrid, config: &Config, clock: Arc<dyn Clock>) -> Result<Self, LocalizerError> {
        Ok(Self {
            filter: filter_on(map, config)?,
            intake: Intake::new(config, clock)?,
            interrupt: Arc::new(Never),
            sources: MotionSources::default(),
            by_scans: MotionByScans::new(config),
            initial_pose: None,
            last: None,
            believed: None,
            stamps: Continuity::default(),
            twist: Twist2::default(),
            without_odometry: 0,
            clock_steps: 0,
            new_runs: 0,
            deadline_misses: 0,
        })
    }

    /// From now on `interrupt` may end the work on a scan early.
    pub fn set_interrupt(&mut self, interrupt: Arc<dyn Interrupt>) {
        self.interrupt = interrupt;
    }

    /// Gets ready for the first scan by practice on the map, whereby the costs of an answer become known. To be called first of all.
    pub fn warm_up(&mut self) {
        let beams = self.intake.config.sensor.beams as usize;
        let most = self.intake.config.localization.particles;
        for particles in [most, most / 4, most / 16, most / 64].map(|count| count.max(1)) {
            for _ in 0..PRACTICE_SCANS {
                let observation = self.filter.practise(particles, beams);
                let task = self.intake.task_without_limit();
                let Intake { clock, costs, .. } = &mut self.intake;
                let mut driver = Driver::new(task, &**clock, &Never, costs);
                self.filter.predict(&Pose2::new(0.1, 0.0, 0.0), 0.025);
                self.filter.update(observation, &Pose2::IDENTITY, &mut driver);
                let refined = driver.refined();
                self.intake.conclude(task.arrival, refined, Some(particles as usize));
                let Intake { clock, costs, .. } = &mut self.intake;
                self.filter.finish(false, &mut Driver::new(task, &**clock, &Never, costs));
            }
        }
        self.intake.costs.learn();
        self.filter.begin_anew();
        begin(&mut self.filter, &self.intake.config);
    }

    /// Another map of the same place: the robot is where it was.
    pub fn replace_map(&mut self, map: OccupancyGrid) -> Result<(), LocalizerError> {
        self.filter = filter_on(map, &self.intake.config)?;
        if let Some(map_from_base) = self.believed {
            self.filter.start_at(&map_from_base, None);
        }
        Ok(())
    }

    /// Transforms that came before the map did.
    pub fn set_transforms(&mut self, transforms: TransformTree) {
        self.intake.transforms = transforms;
    }

    /// Takes a scan that arrived when the clock read `arrival`: moves the particles to its time, and corrects them by it.
    /// [`Self::conclude`] and [`Self::maintain`] are to follow. `interrupt`: somebody wants the answer now.
    pub fn on_scan(&mut self, message: &LaserScan, arrival: Duration, interrupt: &dyn Interrupt) -> Fix {
        self.fix(&message.header, arrival, interrupt, |intake| intake.scan(message))
    }

    fn fix(
        &mut self,
        header: &Header,
        arrival: Duration,
        interrupt: &dyn Interrupt,
        read: impl FnOnce(&mut Intake) -> Result<Scan, Unusable>,
    ) -> Fix {
        let (stamp, task) = (Stamp::from(header.stamp), self.intake.task(arrival));
        if let Some(InitialPose { pose: (map_from_base, covariance), .. }) =
            self.initial_pose.take_if(|set| set.precedes(stamp, arrival))
        {
            self.start_at(&map_from_base, Some(&covariance));
        }
        let mut fix = Fix {
            stamp,
            belief: Err(NoEvidence::NotNewer),
            stop_reason: None,
            contract: task.contract,
            elapsed: Duration::ZERO,
            arrival,
            refined: None,
        };
        fix.belief = self.newer(stamp, read).map(|scan| {
            let (belief, stop_reason, refined) = self.take_in(&scan, task, interrupt);
            (fix.stop_reason, fix.refined) = (Some(stop_reason), refined);
            belief
        });
        fix.elapsed = self.intake.clock.now().saturating_sub(arrival);
        fix
    }

    /// The scan, if it is new.
    fn newer(&mut self, stamp: Stamp, read: impl FnOnce(&mut Intake) -> Result<Scan, Unusable>) -> Result<Scan, NoEvidence> {
        let scan = read(&mut self.intake).inspect_err(|_| {
            self.last.get_or_insert(stamp);
        })?;
        if self.is_new(stamp) { Ok(scan) } else { Err(NoEvidence::NotNewer) }
    }

    /// The scan without the distortion by the motion during its sweep, where there is any.
    fn straightened(&self, scan: &Scan) -> Option<Scan> {
        let sweep = Sweep::of(scan, &self.intake.config.odometry)?;
        let (start, end) = sweep.span(scan.stamp());
        let motion = self.sources.motion(start, end).unwrap_or_else(|| self.twist.motion(sweep.seconds()));
        Some(sweep.straightened(scan, &self.intake.mount.base_from_laser, &motion))
    }

    /// Whether a scan of this stamp comes after the last one, be it that the clock was set meanwhile. In a new run the robot is where it
    /// was; how it came there is not known.
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

    fn take_in(&mut self, scan: &Scan, task: Task, interrupt: &dyn Interrupt) -> (Belief, StopReason, Option<Duration>) {
        let stamp = scan.stamp();
        let motion = self.last.map(|last| (self.motion(last, scan, task, interrupt), stamp.seconds_since(last)));
        if let Some((motion, seconds)) = motion {
            self.twist = Twist2::of_motion(&motion, seconds);
        }
        let straightened = self.straightened(scan);
        let observation = Observation::new(straightened.as_ref().unwrap_or(scan), self.intake.config.sensor.beams as usize);
        let Intake { clock, costs, mount, .. } = &mut self.intake;
        let mut driver = Driver::new(task, &**clock, interrupt, costs);
        self.filter.plan(observation.len(), &driver);
        if let Some((motion, seconds)) = motion {
            self.filter.predict(&motion, seconds.min(LONGEST_GAP));
        }
        let (belief, stop_reason) = self.filter.update(observation, &mount.base_from_laser, &mut driver);
        (self.last, self.believed) = (Some(stamp), Some(belief.map_from_base));
        if belief.is_localized() {
            self.sources.learn_lag(stamp, belief.map_from_base);
        }
        (belief, stop_reason, driver.refined())
    }

    /// The motion of the base since the scan taken at `from`: by odometry; where it is silent, by the scans; at the first of those, as before.
    fn motion(&mut self, from: Stamp, scan: &Scan, task: Task, interrupt: &dyn Interrupt) -> Pose2 {
        let to = scan.stamp();
        self.sources.motion(from, to).unwrap_or_else(|| {
            self.without_odometry += 1;
            let Intake { clock, mount, .. } = &self.intake;
            let by_scans = self.by_scans.motion(scan, &mount.base_from_laser, from, task, (&**clock, interrupt));
            by_scans.unwrap_or_else(|| self.twist.motion(to.seconds_since(from).min(LONGEST_GUESS)))
        })
    }

    /// The pose of the last answer, carried on by odometry to another time; `None` where there is no answer, or no odometry.
    pub fn carried_to(&self, stamp: Stamp) -> Option<Pose2> {
        Some(self.believed? * self.sources.motion(self.last?, stamp)?)
    }

    /// Where odometry says that the robot is at a time, in its own frame and by its own clock: as its transforms have it.
    pub fn odom_from_base(&self, stamp: Stamp) -> Option<Pose2> {
        self.sources.wheel_pose(stamp)
    }

    /// Scans show the robot where the wheel odometry had it so much earlier, s; found along the path, 0 as long as nothing says so.
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

    /// Takes the pose of the base, as a person sets it in `RViz`, which came when the clock read `arrival`: the robot is there when the
    /// next scan after it is taken.
    pub fn on_initial_pose(&mut self, message: &PoseWithCovarianceStamped, arrival: Duration) -> Result<(), InputError> {
        self.check_frame(&message.header.frame_id)?;
        let pose = planar_pose(&message.pose.pose)?;
        self.check_place(&pose)?;
        let covariance = planar_covariance(&message.pose.covariance);
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
        self.intake.contract = Contract::try_from(message)?;
        Ok(())
    }

    /// Another contract; in force from the next scan on.
    pub fn set_contract(&mut self, contract: Contract) {
        self.intake.contract = contract;
    }

    /// The contract in force.
    pub fn contract(&self) -> Contract {
        self.intake.contract
    }

    /// The configuration it was made with.
    pub fn config(&self) -> &Config {
        &self.intake.config
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
        (self.intake.mount, self.intake.mount_source)
    }

    /// What the user should know of the events so far, one sentence for each kind that there was.
    pub fn events_in_words(&self) -> impl Iterator<Item = String> {
        counted_in_words([
            (self.without_odometry, "scans whose motion is that of a match to the scans before: no odometry covers it"),
            (self.clock_steps, "steps of the clock (each went on from the last pose)"),
            (self.new_runs, "jumps back in time (each started a new run, from the last pose)"),
        ])
    }

    /// Answers later than the time budget.
    pub fn deadline_misses(&self) -> u64 {
        self.deadline_misses
    }

    /// A place is given in the frame of the map; some programs leave the frame empty.
    fn check_frame(&self, frame: &str) -> Result<(), InputError> {
        let (frame, expected) = (frame_name(frame), frame_name(&self.intake.config.frames.map_frame));
        if frame.is_empty() || frame == expected {
            return Ok(());
        }
        Err(InputError::WrongFrame { frame: frame.into(), expected: expected.into() })
    }

    /// Refuses a place that is not on the map.
    pub fn check_place(&self, map_from_base: &Pose2) -> Result<(), InputError> {
        let cell = self.filter.map().coordinates(map_from_base.translation());
        #[allow(clippy::cast_possible_truncation)] // saturates: outside any map
        match self.filter.map().cell(cell.x.floor() as i64, cell.y.floor() as i64) {
            Some(_) => Ok(()),
            None => Err(InputError::OutsideMap { x: map_from_base.x, y: map_from_base.y }),
        }
    }
}

impl Answering for Localizer {
    type Answer = Fix;

    fn on_sensed(&mut self, message: &Sensed, arrival: Duration) -> Fix {
        let interrupt = Arc::clone(&self.interrupt);
        match message {
            Sensed::Scan(scan) => self.on_scan(scan, arrival, &*interrupt),
            Sensed::Cloud(cloud) => self.fix(&cloud.header, arrival, &*interrupt, |intake| intake.cloud(cloud)),
        }
    }

    fn conclude(&mut self, fix: &mut Fix) {
        let size = fix.belief.as_ref().ok().map(|belief| belief.particles);
        fix.elapsed = self.intake.conclude(fix.arrival, fix.refined, size);
        self.deadline_misses += u64::from(size.is_some() && !fix.overrun().is_zero());
    }

    fn maintain(&mut self, interrupt: &dyn Interrupt) {
        let task = self.intake.task_without_limit();
        let Intake { config, clock, costs, .. } = &mut self.intake;
        let mut driver = Driver::new(task, &**clock, interrupt, costs);
        self.filter.finish(config.contract.finish_after_answer, &mut driver);
        costs.learn();
    }

    fn wait_for_odometry(&self, stamp: Stamp) -> Option<Duration> {
        self.intake.patience().filter(|_| self.sources.is_behind(stamp))
    }

    fn on_odometry(&mut self, message: &Odometry) -> Result<(), InputError> {
        if let WheelEvent::TimeJump { goes_on } = self.sources.push(self.intake.wheel_sample(message)?) {
            self.stamps.odometry_went_back(goes_on);
        }
        Ok(())
    }

    fn on_transforms(&mut self, message: &TFMessage) -> Result<(), InputError> {
        self.intake.on_transforms(message)
    }

    fn take_remarks(&mut self) -> Vec<String> {
        self.intake.take_remarks()
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
