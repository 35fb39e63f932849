//! The ROS master: waiting for it, and what to do when it goes away and comes back.

use std::sync::{Arc, Mutex, PoisonError, Weak};
use std::time::Duration;

use rosrust::api::{Master, Ros};

use super::NodeError;
use super::log::{self, Log, print};
use super::node_api;
use super::shutdown::StopSignal;
use super::sockets;
use super::tcpros::request_topic;

const RETRY_PERIOD: Duration = Duration::from_millis(500);

/// Waits until there is a master for the program `name`. `false`: the node is to stop instead.
pub(super) fn wait_for_master(name: &str, stop: &StopSignal) -> Result<bool, NodeError> {
    let uri = node_api::master_uri();
    let master = connect(&format!("/{name}"), "")?;
    let mut told = false;
    while let Err(error) = master.get_uri() {
        if !told {
            print(&format!("{name}: there is no ROS master at {uri} yet ({error}): waiting for it"));
            told = true;
        }
        if stop.wait(RETRY_PERIOD) {
            return Ok(false);
        }
    }
    Ok(true)
}

/// The master as seen by the node of this name; `node_uri`: where rosrust answers for it.
pub(super) fn connect(node: &str, node_uri: &str) -> Result<Master, NodeError> {
    let uri = node_api::master_uri();
    Master::new(&uri, node, node_api::uri(node_uri))
        .map_err(|error| NodeError::ros(format!("use the ROS master's address '{uri}'"), &error))
}

/// `name` in full: in its namespace and remapped.
pub(super) fn resolved(ros: &Ros, name: &str) -> Result<String, NodeError> {
    let problem = "it is no valid name";
    ros.param(name)
        .map(|parameter| parameter.name().into())
        .ok_or_else(|| NodeError::ros(format!("use the name '{name}'"), &problem))
}

/// What the node has registered with the master, in the order of time. There is one list for the process, as there is one node.
static REGISTERED: Mutex<Vec<Weak<MasterRegistration>>> = Mutex::new(Vec::new());

/// Notes that something is registered with the master, until the result is dropped, and sets the options of its socket.
pub(super) fn note(ros: &Ros, registration: MasterRegistration) -> Result<Arc<MasterRegistration>, NodeError> {
    sockets::tune(&registration.port(ros)?.into_iter().collect());
    let registration = Arc::new(registration);
    REGISTERED.lock().unwrap_or_else(PoisonError::into_inner).push(Arc::downgrade(&registration));
    Ok(registration)
}

/// An entry in the registry of the master.
pub(super) enum MasterRegistration {
    Publisher { topic: &'static str, message_type: &'static str },
    Subscriber { topic: &'static str, message_type: &'static str },
    Service { name: &'static str, uri: String },
}

impl MasterRegistration {
    /// That of every node's log.
    const ROSOUT: Self = Self::Publisher { topic: log::ROSOUT, message_type: "rosgraph_msgs/Log" };

    /// Of a service that has been offered; rosrust does not say where, but it has told the master.
    pub(super) fn of_service(ros: &Ros, name: &'static str) -> Result<Self, NodeError> {
        let uri = connect(ros.name(), ros.uri())?.lookup_service(&resolved(ros, name)?);
        uri.map(|uri| Self::Service { name, uri }).map_err(|error| NodeError::ros(format!("offer the service '{name}'"), &error))
    }

    /// The port it is reached by, if there is one of its own. Whoever subscribes is told.
    fn port(&self, ros: &Ros) -> Result<Option<u16>, NodeError> {
        match self {
            Self::Publisher { topic, .. } => {
                let address = request_topic(ros.uri(), ros.name(), &resolved(ros, topic)?);
                address.map(|(_, port)| Some(port)).map_err(|error| NodeError::ros(format!("find the port of '{topic}'"), &error))
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

/// Keeps the node known to the master. A master that was started again knows nothing of the nodes of its predecessor, whose links to
/// each other live on: those must not be cut.
pub(super) struct MasterLink<'a> {
    ros: &'a Ros,
    master: &'a Master,
    /// That of the node's log.
    _rosout: Arc<MasterRegistration>,
    present: bool,
    log: Log,
}

impl<'a> MasterLink<'a> {
    pub(super) fn new(ros: &'a Ros, master: &'a Master, log: &Log) -> Result<Self, NodeError> {
        Ok(Self { ros, master, _rosout: note(ros, MasterRegistration::ROSOUT)?, present: true, log: log.clone() })
    }

    /// Whether the master answered when it was last asked.
    pub(super) fn is_present(&self) -> bool {
        self.present
    }

    /// Looks whether the master is there and knows this node, and registers again where it does not.
    pub(super) fn check(&mut self) {
        let known = self.master.lookup_node(self.ros.name());
        let answers = known.is_ok() || self.master.get_uri().is_ok();
        match (std::mem::replace(&mut self.present, answers), answers) {
            (true, false) => self.log.warn("the ROS master does not answer: going on with the connections there are"),
            (_, true) if known.is_err() => self.return_to_master(),
            _ => {}
        }
    }

    fn return_to_master(&mut self) {
        let mut registered = REGISTERED.lock().unwrap_or_else(PoisonError::into_inner);
        registered.retain(|registration| registration.strong_count() > 0);
        let standing: Vec<_> = registered.iter().filter_map(Weak::upgrade).collect();
        drop(registered);
        match standing.iter().try_for_each(|registration| registration.register(self.ros, self.master)) {
            Ok(()) => self.log.info("the ROS master was started again: registered again"),
            Err(error) => {
                self.log.warn(&format!("the ROS master was started again: {error}"));
                self.present = false;
            }
        }
    }
}
