//! The connection to the ROS master: waiting for it at the start, and registering again after it was restarted.

use std::sync::{Arc, Mutex, Weak};
use std::time::Duration;

use rosrust::api::{Master, Ros};

use super::NodeError;
use super::log::{self, Log, print};
use super::node_api;
use super::shutdown::StopSignal;
use super::sockets;
use super::tcpros::request_topic;
use crate::parallel::lock;

/// Time between two attempts to reach the master at the start.
const RETRY_PERIOD: Duration = Duration::from_millis(500);

/// Waits until the master answers. Returns `false` if a signal stops the node first. `name` is the name of the program.
pub(super) fn wait_for_master(name: &str, stop: &StopSignal) -> Result<bool, NodeError> {
    let uri = node_api::master_uri();
    let master = connect(&format!("/{name}"), "")?;
    let mut is_logged = false;
    while let Err(error) = master.get_uri() {
        if !is_logged {
            print(&format!("{name}: no ROS master at {uri} ({error}): waiting for it (start roscore, or check ROS_MASTER_URI)"));
            is_logged = true;
        }
        if stop.wait(RETRY_PERIOD) {
            return Ok(false);
        }
    }
    Ok(true)
}

/// A client of the master that acts for the node of this name. `node_uri`: the XML-RPC address of rosrust.
pub(super) fn connect(node: &str, node_uri: &str) -> Result<Master, NodeError> {
    let uri = node_api::master_uri();
    Master::new(&uri, node, node_api::uri(node_uri))
        .map_err(|error| NodeError::ros(format!("use the ROS master address '{uri}'"), &error))
}

/// The fully resolved name: with namespace and remapping.
pub(super) fn resolved(ros: &Ros, name: &str) -> Result<String, NodeError> {
    let problem = "not a valid ROS name";
    ros.param(name)
        .map(|parameter| parameter.name().into())
        .ok_or_else(|| NodeError::ros(format!("use the name '{name}'"), &problem))
}

/// The registrations of the node with the master, oldest first. One list per process is enough, since a process runs one node.
static REGISTERED: Mutex<Vec<Weak<MasterRegistration>>> = Mutex::new(Vec::new());

/// Keeps track of a registration with the master until the result is dropped, and sets the options of its socket.
pub(super) fn track_registration(ros: &Ros, registration: MasterRegistration) -> Result<Arc<MasterRegistration>, NodeError> {
    sockets::tune(&registration.port(ros)?.into_iter().collect());
    let registration = Arc::new(registration);
    lock(&REGISTERED).push(Arc::downgrade(&registration));
    Ok(registration)
}

/// A registration with the master.
pub(super) enum MasterRegistration {
    Publisher { topic: &'static str, message_type: &'static str },
    Subscriber { topic: &'static str, message_type: &'static str },
    Service { name: &'static str, uri: String },
}

impl MasterRegistration {
    /// Every node publishes its log on this topic.
    const ROSOUT: Self = Self::Publisher { topic: log::ROSOUT, message_type: "rosgraph_msgs/Log" };

    /// The registration of an advertised service. rosrust does not expose the service's URI, but the master knows it.
    pub(super) fn of_service(ros: &Ros, name: &'static str) -> Result<Self, NodeError> {
        let uri = connect(ros.name(), ros.uri())?.lookup_service(&resolved(ros, name)?);
        uri.map(|uri| Self::Service { name, uri })
            .map_err(|error| NodeError::ros(format!("advertise the service '{name}'"), &error))
    }

    /// The TCP port of a publisher or a service, as `requestTopic` and the service's URI give it. Subscribers have none.
    fn port(&self, ros: &Ros) -> Result<Option<u16>, NodeError> {
        match self {
            Self::Publisher { topic, .. } => {
                let address = request_topic(ros.uri(), ros.name(), &resolved(ros, topic)?);
                address
                    .map(|(_, port)| Some(port))
                    .map_err(|error| NodeError::ros(format!("look up the TCPROS port of '{topic}'"), &error))
            }
            Self::Subscriber { .. } => Ok(None),
            Self::Service { uri, .. } => Ok(uri.rsplit(':').next().and_then(|port| port.trim_end_matches('/').parse().ok())),
        }
    }

    fn register(&self, ros: &Ros, master: &Master) -> Result<(), NodeError> {
        let (name, outcome) = match self {
            Self::Publisher { topic, message_type } => {
                (topic, master.register_publisher(&resolved(ros, topic)?, message_type).map(|_peers| ()))
            }
            Self::Subscriber { topic, message_type } => {
                (topic, master.register_subscriber(&resolved(ros, topic)?, message_type).map(|_peers| ()))
            }
            Self::Service { name, uri } => (name, master.register_service(&resolved(ros, name)?, uri).map(|_ignored| ())),
        };
        outcome.map_err(|error| NodeError::ros(format!("register '{name}'"), &error))
    }
}

/// Keeps the node registered with the master. A restarted master does not know the nodes of its predecessor. The connections
/// between those nodes are still alive and must not be closed.
pub(super) struct MasterLink<'a> {
    ros: &'a Ros,
    master: &'a Master,
    /// Registration of the node's log.
    _rosout: Arc<MasterRegistration>,
    present: bool,
    log: Log,
}

impl<'a> MasterLink<'a> {
    pub(super) fn new(ros: &'a Ros, master: &'a Master, log: &Log) -> Result<Self, NodeError> {
        Ok(Self { ros, master, _rosout: track_registration(ros, MasterRegistration::ROSOUT)?, present: true, log: log.clone() })
    }

    /// Whether the master answered the last check.
    pub(super) fn is_present(&self) -> bool {
        self.present
    }

    /// Checks that the master answers and knows this node, and registers the node again if the master does not know it.
    pub(super) fn check(&mut self) {
        let known = self.master.lookup_node(self.ros.name());
        let answers = known.is_ok() || self.master.get_uri().is_ok();
        match (std::mem::replace(&mut self.present, answers), answers) {
            (true, false) => self.log.warn("the ROS master does not answer: keeping the existing connections"),
            (_, true) if known.is_err() => self.register_again(),
            _ => {}
        }
    }

    fn register_again(&mut self) {
        let mut registered = lock(&REGISTERED);
        registered.retain(|registration| registration.strong_count() > 0);
        let active: Vec<_> = registered.iter().filter_map(Weak::upgrade).collect();
        drop(registered);
        match active.iter().try_for_each(|registration| registration.register(self.ros, self.master)) {
            Ok(()) => self.log.info("the ROS master was restarted: registered again"),
            Err(error) => {
                self.log.warn(&format!("the ROS master was restarted, and registering again failed: {error}; trying again"));
                self.present = false;
            }
        }
    }
}
