//! What the node hears.

use std::collections::{HashMap, HashSet};
use std::sync::Arc;

use rosrust::api::Ros;
use rosrust::{RawMessage, Subscriber, SubscriptionHandler};

use super::NodeError;
use super::interrupts::Interrupts;
use super::log::Log;
use super::mailbox::{Event, Letter, Mailbox};
use super::master::{Role, resolved};
use crate::anytime::clock::Clock;
use crate::messages::Message;
use crate::messages::geometry_msgs::PoseWithCovarianceStamped;
use crate::messages::nav_msgs::Odometry;
use crate::messages::own::Contract;
use crate::messages::sensor_msgs::LaserScan;
use crate::messages::std_msgs::Empty;
use crate::messages::tf2_msgs::TFMessage;

/// rosrust's own queue loses messages without a word when it is short. Ours only ever passes through it: the mailbox decides what is
/// kept.
const QUEUE: usize = 1000;
/// Gaps in the numbering of scans that are longer than this are no losses but another numbering.
const MAX_GAP: u32 = 100;

/// A topic the node listens to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum Input {
    Scan,
    Odometry,
    Contract,
    Interrupt,
    InitialPose,
    Transforms,
    StaticTransforms,
}

impl Input {
    pub(super) const ALL: [Self; 7] = [
        Self::Scan,
        Self::Odometry,
        Self::Contract,
        Self::Interrupt,
        Self::InitialPose,
        Self::Transforms,
        Self::StaticTransforms,
    ];

    /// Its name before remapping.
    pub(super) fn topic(self) -> &'static str {
        match self {
            Self::Scan => "scan",
            Self::Odometry => "odom",
            Self::Contract => "icp_contract",
            Self::Interrupt => "icp_interrupt",
            Self::InitialPose => "initialpose",
            Self::Transforms => "/tf",
            Self::StaticTransforms => "/tf_static",
        }
    }

    /// Type of its messages, and the checksum of their definition.
    fn message_type(self) -> (&'static str, &'static str) {
        fn of<T: Message>() -> (&'static str, &'static str) {
            (T::TYPE, T::MD5)
        }
        match self {
            Self::Scan => of::<LaserScan>(),
            Self::Odometry => of::<Odometry>(),
            Self::Contract => of::<Contract>(),
            Self::Interrupt => of::<Empty>(),
            Self::InitialPose => of::<PoseWithCovarianceStamped>(),
            Self::Transforms | Self::StaticTransforms => of::<TFMessage>(),
        }
    }

    /// How it stands in the master's books.
    pub(super) fn role(self) -> Role {
        Role::Subscriber { topic: self.topic(), message_type: self.message_type().0.into() }
    }
}

/// Subscribes to `input`; what comes goes into the mailbox.
///
/// Raw: rosrust would decode lengths it has not checked, and any publisher could make it take all memory there is.
pub(super) fn subscribe(
    ros: &Ros,
    input: Input,
    mailbox: &Arc<Mailbox>,
    interrupts: &Arc<Interrupts>,
    clock: &Arc<dyn Clock>,
    log: &Log,
) -> Result<Subscriber, NodeError> {
    let inlet = Inlet {
        input,
        topic: resolved(ros, input.topic())?,
        node: ros.name().into(),
        mailbox: Arc::clone(mailbox),
        interrupts: Arc::clone(interrupts),
        clock: Arc::clone(clock),
        log: log.clone(),
        refused: HashSet::new(),
        numbering: Numbering::default(),
    };
    ros.subscribe_with(input.topic(), QUEUE, inlet)
        .map_err(|error| NodeError::ros(format!("subscribe to '{}'", input.topic()), &error))
}

/// The receiving end of a topic.
struct Inlet {
    input: Input,
    topic: String,
    node: String,
    mailbox: Arc<Mailbox>,
    interrupts: Arc<Interrupts>,
    clock: Arc<dyn Clock>,
    log: Log,
    refused: HashSet<String>,
    numbering: Numbering,
}

impl SubscriptionHandler<RawMessage> for Inlet {
    fn connection(&mut self, headers: HashMap<String, String>) {
        let field = |name: &str| headers.get(name).map_or("", String::as_str);
        let (message_type, md5) = self.input.message_type();
        let sender = field("callerid");
        if [md5, "*"].contains(&field("md5sum")) {
            self.refused.remove(sender);
        } else if self.refused.insert(sender.into()) {
            let version = if field("type") == message_type { " of another version" } else { "" };
            self.log.error(&format!(
                "topic {}: {sender} publishes {}{version}, expected {message_type}: its messages are ignored",
                self.topic,
                field("type"),
            ));
        }
    }

    // A message may overtake the header of its connection. Of a wrong type, it is then refused by the decoder.
    fn message(&mut self, message: RawMessage, sender: &str) {
        let arrival = self.clock.now();
        if self.refused.contains(sender) {
            return;
        }
        let letter = Letter { arrival, sender: sender.into(), bytes: message.0 };
        match self.input {
            Input::Scan => {
                self.mailbox.count_lost_scans(self.numbering.lost_before(&letter).into());
                self.mailbox.put_scan(letter);
            }
            Input::Interrupt => self.interrupts.request(),
            Input::Transforms | Input::StaticTransforms if sender == self.node => {}
            input => self.mailbox.put_event(Event::Message(input, letter)),
        }
    }
}

/// Watches the `header.seq` of each sender's scans: in a burst rosrust loses messages on the way to us and does not say so.
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
