//! The services of the node, all of them `std_srvs/Trigger`: nothing that comes from the network says what to do in detail, nor names a
//! file.

use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use rosrust::Service;
use rosrust::api::Ros;
use rosrust_msg::std_srvs::{Trigger, TriggerRes};

use super::NodeError;
use super::mailbox::{Event, Mailbox};
use super::master::Role;

const RESET: &str = "~reset";
const SAVE_PROFILE: &str = "~save_profile";
/// Longest wait for the matching thread, which may be amid a long match.
const PATIENCE: Duration = Duration::from_secs(5);

/// What came of a call, in words.
pub(super) type Reply = Result<String, String>;

/// The services, and the way back from the matching thread.
pub(super) struct Services {
    mailbox: Arc<Mailbox>,
    replies: Arc<Mutex<Receiver<Reply>>>,
    // Dropping these ends them.
    offered: Vec<Service>,
}

impl Services {
    /// None is offered yet. The matching thread is to answer [`Event::SaveProfile`] by the sender.
    pub(super) fn new(mailbox: &Arc<Mailbox>) -> (Self, Sender<Reply>) {
        let (sender, replies) = channel();
        let replies = Arc::new(Mutex::new(replies));
        (Self { mailbox: Arc::clone(mailbox), replies, offered: Vec::new() }, sender)
    }

    /// Offers all of them.
    pub(super) fn offer(&mut self, ros: &Ros) -> Result<(), NodeError> {
        let mailbox = Arc::clone(&self.mailbox);
        let reset = move || {
            mailbox.put_event(Event::Reset);
            Ok("the next scan is the first one, at the initial pose".into())
        };
        let (mailbox, replies) = (Arc::clone(&self.mailbox), Arc::clone(&self.replies));
        let save = move || {
            let replies = replies.lock().unwrap_or_else(PoisonError::into_inner);
            while replies.try_recv().is_ok() {} // those that nobody waited for
            mailbox.put_event(Event::SaveProfile);
            replies.recv_timeout(PATIENCE).unwrap_or_else(|_| Err("the matching is too busy: try again".into()))
        };
        self.offered.extend([trigger(ros, RESET, reset)?, trigger(ros, SAVE_PROFILE, save)?]);
        Ok(())
    }

    /// How they stand in the master's books, once they are offered.
    pub(super) fn roles(&self, ros: &Ros) -> Result<[Role; 2], NodeError> {
        Ok([Role::of_service(ros, RESET)?, Role::of_service(ros, SAVE_PROFILE)?])
    }
}

fn trigger(ros: &Ros, name: &str, act: impl Fn() -> Reply + Send + Sync + 'static) -> Result<Service, NodeError> {
    let handle = move |_| {
        let reply = act();
        Ok(TriggerRes { success: reply.is_ok(), message: reply.unwrap_or_else(|problem| problem) })
    };
    ros.service::<Trigger, _>(name, handle).map_err(|error| NodeError::ros(format!("offer the service '{name}'"), &error))
}
