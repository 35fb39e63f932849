//! What scans, transforms, odometry and contracts come in by, for all that answers scans: laser odometry and the particle filter.

use std::sync::Arc;
use std::time::Duration;

use nalgebra::{Isometry3, Vector3};
use thiserror::Error;

use super::sensed::Sensed;
use super::{InputError, MountSource, planar_pose, planar_twist};
use crate::anytime::Task;
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
use crate::odometry::wheel::WheelSample;
use crate::scan::{Scan, ScanConverter, ScanError};
use crate::time::Stamp;
use crate::transforms::{Mount, TiltedMount, TransformTree, frame_name, rigid_motion};

/// A mount that moves by more than this (m, rad) between two scans is worth a remark: no laser shakes that much on its bracket.
const MOUNT_JUMP: f64 = 0.02;
/// A start during which transforms are on their way takes less, s.
const LATE_MOUNT: f64 = 2.0;

/// Why a scan cannot be used.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum Unusable {
    /// The message is malformed.
    #[error("malformed scan: {0}")]
    Malformed(#[from] ScanError),
    /// The cloud is malformed, or holds nothing at the right height.
    #[error("malformed scan: {0}")]
    MalformedCloud(#[from] CloudError),
    /// The laser does not look along the floor.
    #[error(transparent)]
    Tilted(#[from] TiltedMount),
}

/// What is known beside the scans, and what scans are read by.
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
    /// The frame of the last scan, and where on the base it was.
    last_mount: Option<(String, Pose2)>,
    mount_jumped: bool,
    /// The first scan while nobody had said where the laser is.
    first_assumed: Option<Stamp>,
    remarks: Vec<String>,
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
            mount: parameter.map_or_else(Mount::default, |place| place.mount(0.0)),
            mount_source: if parameter.is_some() { MountSource::Parameter } else { MountSource::Assumed },
            converter: ScanConverter::new(&config.scan),
            last_mount: None,
            mount_jumped: false,
            first_assumed: None,
            remarks: Vec::new(),
            config: config.clone(),
        })
    }

    /// The task of answering a scan that arrived when the clock read `arrival`, and is taken up now.
    pub(super) fn task(&self, arrival: Duration) -> Task {
        Task { contract: self.contract, arrival, taken_up: self.clock.now() }
    }

    /// Work for which there is as much time as it takes.
    pub(super) fn task_without_limit(&self) -> Task {
        let now = self.clock.now();
        Task { contract: Contract::default(), arrival: now, taken_up: now }
    }

    /// The scan of a message, as the laser of the mount of now sees it.
    pub(super) fn scan(&mut self, message: &LaserScan) -> Result<Scan, Unusable> {
        self.update_mount(&message.header);
        self.mount.check_level(&self.config.frames.base_frame, &message.header.frame_id)?;
        let scan = self.converter.convert(message, self.mount.upside_down);
        self.remarks.extend(self.converter.take_oddities().iter().map(ToString::to_string));
        Ok(scan?.of_surroundings()?)
    }

    /// The same of a point cloud.
    pub(super) fn cloud(&mut self, message: &PointCloud2) -> Result<Scan, Unusable> {
        self.update_mount(&message.header);
        let scan = cloud::scan(message, &self.config.cloud, &self.mount.level_from_laser)?;
        Ok(scan.masked(self.converter.mask())?.of_surroundings()?)
    }

    /// The scan of a message that has been read before.
    pub(super) fn scan_again(&mut self, message: &Sensed) -> Option<Scan> {
        message.scan(&mut self.converter, &self.config.cloud, &self.mount)
    }

    /// Takes the time of an answer that has been handed over: from the scan's `arrival`. Where the work on it was over when the clock read
    /// `refined`, what came after it is learned from: `size` as for [`Phase::Closing`].
    pub(super) fn conclude(&mut self, arrival: Duration, refined: Option<Duration>, size: Option<usize>) -> Duration {
        if let Some(size) = size {
            self.clock.worked(Phase::Closing, size);
        }
        let now = self.clock.now();
        if let (Some(size), Some(refined)) = (size, refined) {
            self.costs.observe(Phase::Closing, size, now.saturating_sub(refined));
        }
        now.saturating_sub(arrival)
    }

    /// How long an answer may be held back for odometry.
    pub(super) fn patience(&self) -> Option<Duration> {
        let wait = self.contract.patience(Duration::from_secs_f64(self.config.odometry.max_wait.0));
        (!wait.is_zero()).then_some(wait)
    }

    /// Takes transforms, static or not.
    pub(super) fn on_transforms(&mut self, message: &TFMessage) -> Result<(), InputError> {
        let count = self.transforms.add(message);
        if count == 0 { Ok(()) } else { Err(InputError::BadTransforms { count }) }
    }

    /// The sample of the base from odometry.
    pub(super) fn wheel_sample(&self, message: &Odometry) -> Result<WheelSample, InputError> {
        wheel_sample(message, &self.transforms, &self.config.frames)
    }

    /// Remarks on oddities of the messages; each kind is reported once.
    pub(super) fn take_remarks(&mut self) -> Vec<String> {
        std::mem::take(&mut self.remarks)
    }

    /// Where the laser of this scan is on the base: every scan has its own place, which may move.
    fn update_mount(&mut self, header: &Header) {
        let laser_frame = header.frame_id.as_str();
        let parameter = self.config.odometry.laser_in_base;
        if let Some(mount) =
            self.transforms.laser_mount(&self.config.frames.base_frame, laser_frame, header.stamp.into(), parameter)
        {
            self.mount = mount;
            if parameter.is_none() && self.mount_source != MountSource::Transforms {
                self.mount_source = MountSource::Transforms;
                self.last_mount = None; // it was none
                self.note_late_mount(header);
            }
        }
        if self.mount_source == MountSource::Assumed {
            self.first_assumed.get_or_insert(header.stamp.into());
        }
        self.note_mount_jump(laser_frame);
    }

    fn note_late_mount(&mut self, header: &Header) {
        let seconds = self.first_assumed.map_or(0.0, |first| Stamp::from(header.stamp).seconds_since(first));
        if seconds > LATE_MOUNT {
            let laser_frame = &header.frame_id;
            self.remarks.push(format!(
                "no transform to the laser '{laser_frame}' came for {seconds:.1} s: until then it was taken to be at the base's origin \
                 (set odometry.laser_in_base, or publish it on /tf_static)"
            ));
        }
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

/// What odometry says of the base. That of another frame, such as a tracking camera's, is turned into the base's by the transforms, in
/// space; the two frames must be fixed to one another. An empty `child_frame_id` is taken for the base's.
fn wheel_sample(message: &Odometry, transforms: &TransformTree, frames: &FrameKnobs) -> Result<WheelSample, InputError> {
    let stamp = message.header.stamp.into();
    let (pose, twist) = (planar_pose(&message.pose.pose)?, &message.twist.twist);
    let (child, base) = (frame_name(&message.child_frame_id), frame_name(&frames.base_frame));
    if child.is_empty() || child == base {
        return Ok(WheelSample { stamp, pose, twist: planar_twist(twist) });
    }
    // Through the frames that it moves in, a transform would only say what was estimated.
    let moving = [&*message.header.frame_id, &*frames.odom_frame, &*frames.map_frame].map(frame_name);
    let child_from_base = transforms
        .fixed(child, base, &moving)
        .ok_or_else(|| InputError::OdometryOfAnotherFrame { child: child.into(), base: base.into() })?;
    let geometry_msgs::Pose { position: p, orientation } = &message.pose.pose;
    let odom_from_child = rigid_motion([p.x, p.y, p.z], orientation).ok_or(InputError::PoseNotFinite)?;
    let odom_from_base = odom_from_child * child_from_base;
    let (place, forward) = (odom_from_base.translation.vector, odom_from_base.rotation * Vector3::x());
    let pose = Pose2::new(place.x, place.y, forward.y.atan2(forward.x));
    Ok(WheelSample { stamp, pose, twist: planar_twist(&twist_of_base(twist, &child_from_base)) })
}

/// The velocity of a base that is fixed to a child whose velocity this is, each in its own frame.
fn twist_of_base(of_child: &Twist, child_from_base: &Isometry3<f64>) -> Twist {
    let vector = |v: &geometry_msgs::Vector3| Vector3::new(v.x, v.y, v.z);
    let turned = |v: Vector3<f64>| {
        let turned = child_from_base.rotation.inverse() * v;
        geometry_msgs::Vector3 { x: turned.x, y: turned.y, z: turned.z }
    };
    let (linear, angular) = (vector(&of_child.linear), vector(&of_child.angular));
    Twist { linear: turned(linear + angular.cross(&child_from_base.translation.vector)), angular: turned(angular) }
}
