//! Input handling shared by laser odometry and the particle filter: scans, transforms, odometry and contracts.

use std::sync::Arc;
use std::time::Duration;

use nalgebra::{Isometry3, Vector3};
use thiserror::Error;

use super::sensed::SensorMessage;
use super::{InputError, MountSource, planar_pose, planar_twist};
use crate::anytime::ScanContract;
use crate::anytime::clock::Clock;
use crate::anytime::contract::{Contract, ContractError};
use crate::anytime::cost_model::{CostModel, Phase};
use crate::cloud::{self, CloudError};
use crate::config::{Config, FrameKnobs};
use crate::geometry::Pose2;
use crate::messages::geometry_msgs::{self, Twist};
use crate::messages::nav_msgs::Odometry;
use crate::messages::sensor_msgs::{LaserScan, PointCloud2};
use crate::messages::std_msgs::Header;
use crate::messages::tf2_msgs::TFMessage;
use crate::odometry::FailureReason;
use crate::odometry::wheel::WheelSample;
use crate::scan::{Scan, ScanConverter, ScanError};
use crate::time::Stamp;
use crate::transforms::{Mount, TiltedMount, TransformTree, frame_name, rigid_motion};

/// A mount that moves by more than this (m, rad) between two scans is reported: no laser shakes that much on its bracket.
const MAX_MOUNT_SHAKE: f64 = 0.02;
/// Time after which a missing transform to the laser counts as late, s. At startup, transforms take less to arrive.
const MAX_MOUNT_DELAY: f64 = 2.0;

/// Why a scan cannot be used.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum UnusableScan {
    /// The message is malformed.
    #[error("malformed scan: {0}")]
    Malformed(#[from] ScanError),
    /// The cloud is malformed, or has no points at the configured heights.
    #[error("malformed scan: {0}")]
    MalformedCloud(#[from] CloudError),
    /// The laser's scan plane is tilted against the floor.
    #[error(transparent)]
    Tilted(#[from] TiltedMount),
}

impl UnusableScan {
    /// The code of the failure, for programs.
    pub(super) fn reason(&self) -> FailureReason {
        match self {
            Self::Malformed(_) | Self::MalformedCloud(_) => FailureReason::MalformedScan,
            Self::Tilted(_) => FailureReason::TiltedMount,
        }
    }
}

/// The state that messages update, and the converters that read scans.
pub(super) struct Intake {
    pub(super) config: Config,
    pub(super) clock: Arc<dyn Clock>,
    pub(super) costs: CostModel,
    /// The contract in force.
    pub(super) contract: Contract,
    pub(super) transforms: TransformTree,
    pub(super) mount: Mount,
    pub(super) mount_source: MountSource,
    converter: ScanConverter,
    /// The frame of the last scan, and the pose of that frame on the base.
    last_mount: Option<(String, Pose2)>,
    mount_jumped: bool,
    /// Stamp of the first scan for which the pose of the laser was unknown.
    first_assumed: Option<Stamp>,
    warnings: Vec<String>,
}

impl Intake {
    /// Fails on an invalid contract.
    pub(super) fn new(config: &Config, clock: Arc<dyn Clock>) -> Result<Self, ContractError> {
        let parameter = config.odometry.laser_in_base;
        Ok(Self {
            clock,
            costs: CostModel::new(config.contract.confidence),
            contract: Contract::try_from(&config.contract)?,
            transforms: TransformTree::default(),
            mount: parameter.map_or_else(Mount::default, |laser_pose| laser_pose.mount(0.0)),
            mount_source: if parameter.is_some() { MountSource::Parameter } else { MountSource::Assumed },
            converter: ScanConverter::new(&config.scan),
            last_mount: None,
            mount_jumped: false,
            first_assumed: None,
            warnings: Vec::new(),
            config: config.clone(),
        })
    }

    /// The contract for a scan that arrived when the clock read `arrival`; processing starts now.
    pub(super) fn scan_contract(&self, arrival: Duration) -> ScanContract {
        ScanContract { contract: self.contract, arrival, started: self.clock.now() }
    }

    /// A contract without limits, for other work.
    pub(super) fn unlimited_contract(&self) -> ScanContract {
        let now = self.clock.now();
        ScanContract { contract: Contract::default(), arrival: now, started: now }
    }

    /// Converts a scan message with the current mount of its laser.
    pub(super) fn scan(&mut self, message: &LaserScan) -> Result<Scan, UnusableScan> {
        self.update_mount(&message.header);
        self.mount.check_level(&self.config.frames.base_frame, &message.header.frame_id)?;
        let scan = self.converter.convert(message, self.mount.upside_down);
        self.warnings.extend(self.converter.take_warnings().iter().map(ToString::to_string));
        Ok(scan?.reject_uniform()?)
    }

    /// Converts a point cloud with the current mount of its sensor.
    pub(super) fn cloud(&mut self, message: &PointCloud2) -> Result<Scan, UnusableScan> {
        self.update_mount(&message.header);
        let scan = cloud::scan(message, &self.config.cloud, &self.mount.level_from_laser)?;
        Ok(scan.masked(self.converter.mask())?.reject_uniform()?)
    }

    /// Converts a message again that has been read before.
    pub(super) fn scan_again(&mut self, message: &SensorMessage) -> Option<Scan> {
        message.scan(&mut self.converter, &self.config.cloud, &self.mount)
    }

    /// Returns the time from the scan's `arrival` until now, when its answer has been published. If refinement ended when the
    /// clock read `refined`, the cost of everything after it is learned; `size` is as for [`Phase::Closing`].
    pub(super) fn conclude(&mut self, arrival: Duration, refined: Option<Duration>, size: Option<usize>) -> Duration {
        if let Some(size) = size {
            self.clock.work_done(Phase::Closing, size);
        }
        let now = self.clock.now();
        if let (Some(size), Some(refined)) = (size, refined) {
            self.costs.observe(Phase::Closing, size, now.saturating_sub(refined));
        }
        now.saturating_sub(arrival)
    }

    /// Whether the first scan, which has this header, should wait for the transform of its laser: both may be on their way.
    pub(super) fn awaits_mount(&self, header: &Header) -> bool {
        let mount = || self.transforms.laser_mount(&self.config.frames.base_frame, &header.frame_id, header.stamp.into(), None);
        self.mount_source == MountSource::Assumed && self.first_assumed.is_none() && mount().is_none()
    }

    /// How long to wait for odometry or transforms before processing a scan; `None`: do not wait.
    pub(super) fn max_wait(&self) -> Option<Duration> {
        let wait = self.contract.max_wait(Duration::from_secs_f64(self.config.odometry.max_wait.0));
        (!wait.is_zero()).then_some(wait)
    }

    /// Handles transforms, static or not.
    pub(super) fn on_transforms(&mut self, message: &TFMessage) -> Result<(), InputError> {
        let count = self.transforms.add(message);
        if count == 0 { Ok(()) } else { Err(InputError::BadTransforms { count }) }
    }

    /// Converts an odometry message to a sample of the base.
    pub(super) fn wheel_sample(&self, message: &Odometry) -> Result<WheelSample, InputError> {
        wheel_sample(message, &self.transforms, &self.config.frames)
    }

    /// Takes the warnings about unusual messages; each kind is reported once.
    pub(super) fn take_warnings(&mut self) -> Vec<String> {
        std::mem::take(&mut self.warnings)
    }

    /// Updates the pose of this scan's laser on the base. It may change from scan to scan.
    fn update_mount(&mut self, header: &Header) {
        let laser_frame = header.frame_id.as_str();
        let parameter = self.config.odometry.laser_in_base;
        if let Some(mount) =
            self.transforms.laser_mount(&self.config.frames.base_frame, laser_frame, header.stamp.into(), parameter)
        {
            self.mount = mount;
            if parameter.is_none() && self.mount_source != MountSource::Transforms {
                self.mount_source = MountSource::Transforms;
                self.last_mount = None; // that pose was assumed
                self.warn_of_late_mount(header);
            }
        }
        if self.mount_source == MountSource::Assumed {
            self.first_assumed.get_or_insert(header.stamp.into());
        }
        self.warn_of_mount_jump(laser_frame);
    }

    fn warn_of_late_mount(&mut self, header: &Header) {
        let seconds = self.first_assumed.map_or(0.0, |first| Stamp::from(header.stamp).seconds_since(first));
        if seconds > MAX_MOUNT_DELAY {
            let laser_frame = &header.frame_id;
            self.warnings.push(format!(
                "no transform to the laser '{laser_frame}' came for {seconds:.1} s: until then it was assumed to be at the base's origin \
                 (set odometry.laser_in_base, or publish it on /tf_static)"
            ));
        }
    }

    fn warn_of_mount_jump(&mut self, laser_frame: &str) {
        let base_from_laser = self.mount.base_from_laser;
        let Some((_, before)) = self.last_mount.as_mut().filter(|(frame, _)| frame == laser_frame) else {
            self.last_mount = Some((laser_frame.into(), base_from_laser));
            return;
        };
        let motion = std::mem::replace(before, base_from_laser).between(&base_from_laser);
        if !self.mount_jumped && (motion.distance() > MAX_MOUNT_SHAKE || motion.theta.abs() > MAX_MOUNT_SHAKE) {
            self.mount_jumped = true;
            let (distance, degrees) = (motion.distance(), motion.theta.to_degrees());
            self.warnings.push(format!(
                "according to tf the laser '{laser_frame}' moved on the base by {distance:.3} m and {degrees:.1} degrees between two scans: \
                 the transform is used as published (does more than one node publish it?)"
            ));
        }
    }
}

/// Converts odometry to a sample of the base. Odometry of another frame, such as that of a tracking camera, is transformed to the
/// base in 3D; the two frames must be fixed to each other. An empty `child_frame_id` means the base.
fn wheel_sample(message: &Odometry, transforms: &TransformTree, frames: &FrameKnobs) -> Result<WheelSample, InputError> {
    let stamp = message.header.stamp.into();
    let (pose, twist) = (planar_pose(&message.pose.pose)?, &message.twist.twist);
    let (child, base) = (frame_name(&message.child_frame_id), frame_name(&frames.base_frame));
    if child.is_empty() || child == base {
        return Ok(WheelSample { stamp, pose, twist: planar_twist(twist) });
    }
    // A transform through the moving frames would only return what was estimated.
    let moving = [&*message.header.frame_id, &*frames.odom_frame, &*frames.map_frame].map(frame_name);
    let child_from_base = transforms
        .fixed_transform(child, base, &moving)
        .ok_or_else(|| InputError::OdometryOfAnotherFrame { child: child.into(), base: base.into() })?;
    let geometry_msgs::Pose { position: p, orientation } = &message.pose.pose;
    let odom_from_child = rigid_motion([p.x, p.y, p.z], orientation).ok_or(InputError::PoseNotFinite)?;
    let odom_from_base = odom_from_child * child_from_base;
    let (position, forward) = (odom_from_base.translation.vector, odom_from_base.rotation * Vector3::x());
    let pose = Pose2::new(position.x, position.y, forward.y.atan2(forward.x));
    Ok(WheelSample { stamp, pose, twist: planar_twist(&twist_of_base(twist, &child_from_base)) })
}

/// The velocity of the base from that of a child frame fixed to it, each in its own frame.
fn twist_of_base(of_child: &Twist, child_from_base: &Isometry3<f64>) -> Twist {
    let vector = |v: &geometry_msgs::Vector3| Vector3::new(v.x, v.y, v.z);
    let rotated = |v: Vector3<f64>| {
        let rotated = child_from_base.rotation.inverse() * v;
        geometry_msgs::Vector3 { x: rotated.x, y: rotated.y, z: rotated.z }
    };
    let (linear, angular) = (vector(&of_child.linear), vector(&of_child.angular));
    Twist { linear: rotated(linear + angular.cross(&child_from_base.translation.vector)), angular: rotated(angular) }
}
