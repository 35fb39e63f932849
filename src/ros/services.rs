//! The services of the nodes, nearly all of them `std_srvs/Trigger`: nothing that comes from the network says what to do in detail,
//! nor names a file. The others hand maps out.

use std::sync::mpsc::{Sender, SyncSender, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use rosrust::RosMsg as _;
use rosrust::api::Ros;
use rosrust_msg::nav_msgs::{GetMap, GetMapRes};
use rosrust_msg::std_srvs::{Trigger, TriggerRes};

use super::NodeError;
use super::mailbox::{Event, Mailbox, Request};
use super::master::{MasterRegistration, note};
use crate::messages::{encode, nav_msgs};

/// Longest wait for the matching thread, which may be amid a long match.
const TIMEOUT: Duration = Duration::from_secs(5);

/// What came of a call, in words.
pub(super) type Reply = Result<String, String>;

/// A service that can be called until this is dropped.
pub(super) struct Service {
    _offered: rosrust::Service,
    _registration: Arc<MasterRegistration>,
}

impl Service {
    fn offer(ros: &Ros, name: &'static str, act: impl Fn() -> Reply + Send + Sync + 'static) -> Result<Self, NodeError> {
        let handle = move |_| {
            let reply = act();
            Ok(TriggerRes { success: reply.is_ok(), message: reply.unwrap_or_else(|problem| problem) })
        };
        Self::of(ros, name, ros.service::<Trigger, _>(name, handle))
    }

    fn of<E: std::fmt::Display>(ros: &Ros, name: &'static str, offered: Result<rosrust::Service, E>) -> Result<Self, NodeError> {
        let failed = |error| NodeError::ros(format!("offer the service '{name}'"), &error);
        let offered = offered.map_err(failed)?;
        Ok(Self { _offered: offered, _registration: note(ros, MasterRegistration::of_service(ros, name)?)? })
    }
}

/// A service that puts [`Request::Reset`] into the mailbox and answers in these words.
pub(super) fn reset(
    ros: &Ros,
    (name, answer): (&'static str, &'static str),
    mailbox: &Arc<Mailbox>,
) -> Result<Service, NodeError> {
    let mailbox = Arc::clone(mailbox);
    Service::offer(ros, name, move || {
        mailbox.put_event(Event::Request(Request::Reset));
        Ok(answer.into())
    })
}

/// A service that answers with this map.
pub(super) fn static_map(ros: &Ros, name: &'static str, answer: GetMapRes) -> Result<Service, NodeError> {
    Service::of(ros, name, ros.service::<GetMap, _>(name, move |_| Ok(answer.clone())))
}

/// The map that was made last, if there is one yet.
pub(super) type LastMap = Arc<Mutex<Option<nav_msgs::OccupancyGrid>>>;

/// A service that answers with the map that was made last.
pub(super) fn map(ros: &Ros, name: &'static str, last: LastMap) -> Result<Service, NodeError> {
    let answer = move |_| {
        let last = last.lock().unwrap_or_else(PoisonError::into_inner).clone();
        map_response(&last.ok_or("there is no map yet: no scan has been drawn")?)
    };
    Service::of(ros, name, ros.service::<GetMap, _>(name, answer))
}

/// The same message in rosrust's own type, by way of the wire form that they share.
pub(super) fn map_response(message: &nav_msgs::OccupancyGrid) -> Result<GetMapRes, String> {
    let bytes = encode(message).map_err(|error| error.to_string())?;
    rosrust_msg::nav_msgs::OccupancyGrid::decode(&bytes[..]).map(|map| GetMapRes { map }).map_err(|error| error.to_string())
}

/// A service that gives an order to another thread and answers with what came of it.
pub(super) fn ordered<O: Send + 'static>(
    ros: &Ros,
    name: &'static str,
    orders: SyncSender<O>,
    order: fn(Sender<Reply>) -> O,
) -> Result<Service, NodeError> {
    let orders = Mutex::new(orders);
    Service::offer(ros, name, move || {
        let (sender, reply) = channel();
        let orders = orders.lock().unwrap_or_else(PoisonError::into_inner).clone();
        orders.send(order(sender)).map_err(|_| "the node is ending")?;
        reply.recv().unwrap_or_else(|_| Err("the node is ending".into()))
    })
}

/// The service that puts [`Request::SaveProfile`] into the mailbox, and by what it is to be answered.
pub(super) fn save_profile(ros: &Ros, mailbox: &Arc<Mailbox>) -> Result<(Service, Sender<Reply>), NodeError> {
    let (mailbox, (sender, replies)) = (Arc::clone(mailbox), channel());
    let replies = Mutex::new(replies);
    let save = move || {
        let replies = replies.lock().unwrap_or_else(PoisonError::into_inner);
        while replies.try_recv().is_ok() {} // late replies to earlier calls
        mailbox.put_event(Event::Request(Request::SaveProfile));
        replies.recv_timeout(TIMEOUT).unwrap_or_else(|_| Err("the matching is too busy: try again".into()))
    };
    Ok((Service::offer(ros, "~save_profile", save)?, sender))
}
