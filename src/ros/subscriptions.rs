//! What the node hears.

use std::sync::Arc;

use super::NodeError;
use super::inlet::{Letter, Topic, listen};
use super::interrupts::Interrupts;
use super::links::Links;
use super::mailbox::{Event, Mailbox};
use super::numbering::Numbering;
use crate::messages::geometry_msgs::{PoseWithCovarianceStamped, Twist, TwistStamped};
use crate::messages::nav_msgs::Odometry;
use crate::messages::own::Contract;
use crate::messages::sensor_msgs::{Imu, LaserScan, PointCloud2};
use crate::messages::std_msgs::Empty;
use crate::messages::tf2_msgs::TFMessage;

/// A topic the node listens to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum Input {
    Scan,
    Cloud,
    Odometry,
    Imu,
    Velocity,
    StampedVelocity,
    Contract,
    Interrupt,
    InitialPose,
    Transforms,
    StaticTransforms,
}

impl Input {
    pub(super) const ALL: [Self; 11] = [
        Self::Scan,
        Self::Cloud,
        Self::Odometry,
        Self::Imu,
        Self::Velocity,
        Self::StampedVelocity,
        Self::Contract,
        Self::Interrupt,
        Self::InitialPose,
        Self::Transforms,
        Self::StaticTransforms,
    ];

    /// Its name before remapping.
    pub(super) fn name(self) -> &'static str {
        self.topic().name
    }

    pub(super) fn topic(self) -> Topic {
        match self {
            Self::Scan => Topic::vital::<LaserScan>("scan"),
            Self::Cloud => Topic::vital::<PointCloud2>("cloud"),
            Self::Odometry => Topic::of::<Odometry>("odom"),
            Self::Imu => Topic::of::<Imu>("imu/data"),
            Self::Velocity => Topic::of::<Twist>("vel"),
            Self::StampedVelocity => Topic::of::<TwistStamped>("vel"),
            Self::Contract => Topic::of::<Contract>("icp_contract"),
            Self::Interrupt => Topic::of::<Empty>("icp_interrupt"),
            Self::InitialPose => Topic::of::<PoseWithCovarianceStamped>("initialpose"),
            Self::Transforms => Topic::of::<TFMessage>("/tf"),
            Self::StaticTransforms => Topic::of::<TFMessage>("/tf_static"),
        }
    }
}

/// Subscribes to `input`; what comes goes into the mailbox.
pub(super) fn subscribe(
    links: &Links,
    input: Input,
    mailbox: &Arc<Mailbox>,
    interrupts: &Arc<Interrupts>,
) -> Result<(), NodeError> {
    let (mailbox, interrupts) = (Arc::clone(mailbox), Arc::clone(interrupts));
    let mut numbering = Numbering::default();
    let receive = move |letter: Letter| match input {
        Input::Scan | Input::Cloud => {
            mailbox.count_lost_scans(numbering.lost_before(&letter).into());
            mailbox.put_scan(letter);
        }
        Input::Interrupt => interrupts.request(),
        input => mailbox.put_event(Event::Message(input, letter)),
    };
    listen(links, input.topic(), receive)
}
