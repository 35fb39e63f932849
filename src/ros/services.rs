//! The services of the nodes. Nearly all are `std_srvs/Trigger`, so requests from the network carry no arguments and name no
//! files. The others return maps.

use std::sync::mpsc::{Sender, SyncSender, channel};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use rosrust::RosMsg as _;
use rosrust::api::Ros;
use rosrust_msg::nav_msgs::{GetMap, GetMapRes};
use rosrust_msg::std_srvs::{Trigger, TriggerRes};

use super::NodeError;
use super::mailbox::{Event, Mailbox, Request};
use super::master::{MasterRegistration, track_registration};
use crate::messages::{encode, nav_msgs};
use crate::parallel::lock;

/// Maximum wait for the matching thread, which may be busy with a long match.
const TIMEOUT: Duration = Duration::from_secs(5);

/// The outcome of a call as a text for the caller.
pub(super) type Reply = Result<String, String>;

/// An advertised service. Dropping this ends it.
pub(super) struct Service {
    _service: rosrust::Service,
    _registration: Arc<MasterRegistration>,
}

impl Service {
    fn advertise(ros: &Ros, name: &'static str, act: impl Fn() -> Reply + Send + Sync + 'static) -> Result<Self, NodeError> {
        let handle = move |_| {
            let reply = act();
            Ok(TriggerRes { success: reply.is_ok(), message: reply.unwrap_or_else(|problem| problem) })
        };
        Self::of(ros, name, ros.service::<Trigger, _>(name, handle))
    }

    fn of<E: std::fmt::Display>(ros: &Ros, name: &'static str, service: Result<rosrust::Service, E>) -> Result<Self, NodeError> {
        let failed = |error| NodeError::ros(format!("advertise the service '{name}'"), &error);
        let service = service.map_err(failed)?;
        Ok(Self { _service: service, _registration: track_registration(ros, MasterRegistration::of_service(ros, name)?)? })
    }
}

/// A service that puts [`Request::Reset`] into the mailbox and returns the text `answer`.
pub(super) fn reset(
    ros: &Ros,
    (name, answer): (&'static str, &'static str),
    mailbox: &Arc<Mailbox>,
) -> Result<Service, NodeError> {
    let mailbox = Arc::clone(mailbox);
    Service::advertise(ros, name, move || {
        mailbox.put_event(Event::Request(Request::Reset));
        Ok(answer.into())
    })
}

/// A service that returns a fixed map.
pub(super) fn static_map(ros: &Ros, name: &'static str, answer: GetMapRes) -> Result<Service, NodeError> {
    Service::of(ros, name, ros.service::<GetMap, _>(name, move |_| Ok(answer.clone())))
}

/// The latest map, if there is one yet.
pub(super) type LastMap = Arc<Mutex<Option<nav_msgs::OccupancyGrid>>>;

/// A service that returns the latest map.
pub(super) fn map(ros: &Ros, name: &'static str, last: LastMap) -> Result<Service, NodeError> {
    let answer = move |_| {
        let last = lock(&last).clone();
        map_response(&last.ok_or("there is no map yet: no scan has been added to it")?)
    };
    Service::of(ros, name, ros.service::<GetMap, _>(name, answer))
}

/// Converts a map to rosrust's message type through the serialized form, which is the same.
pub(super) fn map_response(message: &nav_msgs::OccupancyGrid) -> Result<GetMapRes, String> {
    let bytes = encode(message).map_err(|error| error.to_string())?;
    rosrust_msg::nav_msgs::OccupancyGrid::decode(&bytes[..]).map(|map| GetMapRes { map }).map_err(|error| error.to_string())
}

/// A service that sends a command to another thread and returns that thread's reply.
pub(super) fn delegated<O: Send + 'static>(
    ros: &Ros,
    name: &'static str,
    commands: SyncSender<O>,
    command: fn(Sender<Reply>) -> O,
) -> Result<Service, NodeError> {
    let commands = Mutex::new(commands);
    Service::advertise(ros, name, move || {
        let (sender, reply) = channel();
        let commands = lock(&commands).clone();
        commands.send(command(sender)).map_err(|_| "the node is shutting down")?;
        reply.recv().unwrap_or_else(|_| Err("the node is shutting down".into()))
    })
}

/// The service that puts [`Request::SaveProfile`] into the mailbox, and the channel that takes the matching thread's reply.
pub(super) fn save_profile(ros: &Ros, mailbox: &Arc<Mailbox>) -> Result<(Service, Sender<Reply>), NodeError> {
    let (mailbox, (sender, replies)) = (Arc::clone(mailbox), channel());
    let replies = Mutex::new(replies);
    let save = move || {
        let replies = lock(&replies);
        while replies.try_recv().is_ok() {} // late replies to earlier calls that timed out
        mailbox.put_event(Event::Request(Request::SaveProfile));
        replies
            .recv_timeout(TIMEOUT)
            .unwrap_or_else(|_| Err(format!("the matching thread has not answered within {TIMEOUT:?}: try again")))
    };
    Ok((Service::advertise(ros, "~save_profile", save)?, sender))
}
