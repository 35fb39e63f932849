//! What the node hears.

use std::collections::HashMap;
use std::sync::Arc;

use super::NodeError;
use super::inlet::{Letter, Topic, listen};
use super::interrupts::Interrupts;
use super::links::Links;
use super::mailbox::{Event, Mailbox};
use crate::messages::geometry_msgs::{PoseWithCovarianceStamped, Twist, TwistStamped};
use crate::messages::nav_msgs::Odometry;
use crate::messages::own::Contract;
use crate::messages::sensor_msgs::{Imu, LaserScan, PointCloud2};
use crate::messages::std_msgs::Empty;
use crate::messages::tf2_msgs::TFMessage;

/// Gaps in the numbering of scans that are longer than this are no losses but another numbering.
const MAX_GAP: u32 = 100;

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
            Self::Scan => Topic::of::<LaserScan>("scan"),
            Self::Cloud => Topic::of::<PointCloud2>("cloud"),
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

/// Watches the `header.seq` of each sender's scans: in a burst a publisher loses messages on the way to us and does not say so.
#[derive(Default)]
struct Numbering {
    last: HashMap<String, u32>,
}

impl Numbering {
    /// How many numbers were left out before this message. Every message with a header begins with its number.
    fn lost_before(&mut self, letter: &Letter) -> u32 {
        let Some(number) = letter.bytes.first_chunk().map(|bytes| u32::from_le_bytes(*bytes)) else { return 0 };
        let Some(last) = self.last.insert(letter.sender.clone(), number) else { return 0 };
        let lost = number.wrapping_sub(last).saturating_sub(1);
        if lost <= MAX_GAP { lost } else { 0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[test]
    fn gaps_in_the_numbering_of_a_sender_are_losses() {
        let mut numbering = Numbering::default();
        let mut lost = |sender: &str, number: u32| {
            let bytes = number.to_le_bytes().to_vec();
            numbering.lost_before(&Letter { arrival: Duration::ZERO, sender: sender.into(), bytes })
        };
        assert_eq!([lost("/a", 7), lost("/a", 8), lost("/a", 11)], [0, 0, 2]);
        assert_eq!([lost("/b", 0), lost("/b", 0), lost("/b", 0)], [0, 0, 0], "a sender that does not count");
        assert_eq!([lost("/a", 3), lost("/a", 4)], [0, 0], "a bag that starts again");
        assert_eq!(lost("/a", 1_000_000), 0, "another numbering");
    }
}
