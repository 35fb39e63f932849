//! Localization as a whole: messages in, poses on the map out.

use std::time::Duration;

use rayon::ThreadPoolBuildError;
use thiserror::Error;

use super::{InputError, MountSource, planar_pose, planar_twist};
use crate::config::Config;
use crate::geometry::{Pose2, PoseCovariance, Twist2};
use crate::localization::filter::{Belief, ParticleFilter};
use crate::localization::observation::Observation;
use crate::map::grid::OccupancyGrid;
use crate::messages::geometry_msgs::PoseWithCovarianceStamped;
use crate::messages::nav_msgs::Odometry;
use crate::messages::sensor_msgs::LaserScan;
use crate::messages::tf2_msgs::TFMessage;
use crate::odometry::wheel::{WheelOdometry, WheelSample};
use crate::scan::{ScanConverter, ScanError};
use crate::time::Stamp;
use crate::transforms::{Mount, TransformTree};

/// Over a longer time than this the last velocity says nothing, s.
const LONGEST_GUESS: f64 = 0.5;

/// A scan that cannot be used as evidence. The belief stays as it was.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum NoEvidence {
    /// The message is malformed.
    #[error("malformed scan: {0}")]
    Malformed(#[from] ScanError),
    /// The scan, or a later one, has been used before.
    #[error("the scan's stamp is not later than that of the one before: nothing is evidence twice")]
    NotNewer,
}

/// A robot on a map.
pub struct Localizer {
    config: Config,
    filter: ParticleFilter,
    wheel: WheelOdometry,
    converter: ScanConverter,
    transforms: TransformTree,
    mount: Mount,
    mount_source: MountSource,
    /// Stamp of the scan used last.
    last: Option<Stamp>,
    twist: Twist2,
    without_odometry: u64,
}

impl Localizer {
    /// A robot that may be anywhere on the map. Fails when the system gives no threads.
    pub fn new(map: OccupancyGrid, config: &Config) -> Result<Self, ThreadPoolBuildError> {
        let parameter = config.odometry.laser_in_base;
        Ok(Self {
            filter: ParticleFilter::new(map, &config.localization, &config.motion, &config.sensor)?,
            config: config.clone(),
            wheel: WheelOdometry::default(),
            converter: ScanConverter::default(),
            transforms: TransformTree::default(),
            mount: Mount { base_from_laser: parameter.unwrap_or_default(), upside_down: false },
            mount_source: if parameter.is_some() { MountSource::Parameter } else { MountSource::Assumed },
            last: None,
            twist: Twist2::default(),
            without_odometry: 0,
        })
    }

    /// Takes a scan: moves the particles to its time, and corrects them by it.
    pub fn on_scan(&mut self, message: &LaserScan) -> Result<Belief, NoEvidence> {
        let stamp = Stamp::from(message.header.stamp);
        if self.last.is_some_and(|last| stamp <= last) {
            return Err(NoEvidence::NotNewer);
        }
        self.update_mount(&message.header.frame_id);
        let scan = self.converter.convert(message, self.mount.upside_down)?;
        if let Some(last) = self.last.replace(stamp) {
            let seconds = stamp.seconds_since(last);
            let motion = self.motion(last, stamp);
            self.twist = Twist2::of_motion(&motion, seconds);
            self.filter.predict(&motion, seconds);
        }
        let observation = Observation::new(&scan, &message.ranges, self.config.sensor.beams as usize);
        Ok(self.filter.update(&observation, &self.mount.base_from_laser))
    }

    /// By odometry; where it is silent, as before.
    fn motion(&mut self, from: Stamp, to: Stamp) -> Pose2 {
        self.wheel.motion(from, to).unwrap_or_else(|| {
            self.without_odometry += 1;
            self.twist.motion(to.seconds_since(from).min(LONGEST_GUESS))
        })
    }

    /// How long to hold back a scan of this stamp for odometry that has not come yet; `None`: take it now.
    pub fn wait_for_odometry(&self, stamp: Stamp) -> Option<Duration> {
        let wait = Duration::from_secs_f64(self.config.odometry.max_wait.0);
        (!wait.is_zero() && self.wheel.is_behind(stamp)).then_some(wait)
    }

    /// Takes wheel odometry.
    pub fn on_odometry(&mut self, message: &Odometry) -> Result<(), InputError> {
        let pose = planar_pose(&message.pose.pose)?;
        let twist = planar_twist(&message.twist.twist);
        self.wheel.push(WheelSample { stamp: message.header.stamp.into(), pose, twist });
        Ok(())
    }

    /// Takes transforms, static or not.
    pub fn on_transforms(&mut self, message: &TFMessage) -> Result<(), InputError> {
        let count = self.transforms.add(message);
        if count == 0 { Ok(()) } else { Err(InputError::BadTransforms { count }) }
    }

    /// Takes the pose of the base, as a person sets it in `RViz`.
    pub fn on_initial_pose(&mut self, message: &PoseWithCovarianceStamped) -> Result<(), InputError> {
        let pose = planar_pose(&message.pose.pose)?;
        let of = |row: usize, column: usize| message.pose.covariance[6 * row + column];
        let covariance = PoseCovariance::from_fn(|row, column| of([0, 1, 5][row], [0, 1, 5][column]));
        self.start_at(&pose, Some(&covariance));
        Ok(())
    }

    /// The robot is near `map_from_base`; how near, says `covariance`, or the configuration.
    pub fn start_at(&mut self, map_from_base: &Pose2, covariance: Option<&PoseCovariance>) {
        self.filter.start_at(map_from_base, covariance);
    }

    /// The robot may be anywhere.
    pub fn spread(&mut self) {
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

    fn update_mount(&mut self, laser_frame: &str) {
        if self.mount_source == MountSource::Parameter {
            return;
        }
        if let Some(mount) = self.transforms.mount(&self.config.frames.base_frame, laser_frame) {
            (self.mount, self.mount_source) = (mount, MountSource::Transforms);
        }
    }
}
