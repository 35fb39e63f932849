//! The ROS master: waiting for it, and what to do when it goes away and comes back.

use std::collections::HashSet;
use std::time::Duration;

use rosrust::api::{Master, Ros, resolve};
use rosrust::error::ResponseError;

use super::NodeError;
use super::log::{Log, print};
use super::shutdown::StopSignal;
use super::sockets;
use super::tcpros::request_topic;

const RETRY_PERIOD: Duration = Duration::from_millis(500);

/// Waits until there is a master for the program `name`. `false`: the node is to stop instead.
pub(super) fn wait_for_master(name: &str, stop: &StopSignal) -> Result<bool, NodeError> {
    let uri = resolve::master();
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

/// The master as seen by the node of this name, which answers at `node_uri`.
pub(super) fn connect(node: &str, node_uri: &str) -> Result<Master, NodeError> {
    let uri = resolve::master();
    Master::new(&uri, node, node_uri).map_err(|error| NodeError::ros(format!("use the ROS master's address '{uri}'"), &error))
}

/// `name` in full: in its namespace and remapped.
pub(super) fn resolved(ros: &Ros, name: &str) -> Result<String, NodeError> {
    let problem = "it is no valid name";
    ros.param(name)
        .map(|parameter| parameter.name().into())
        .ok_or_else(|| NodeError::ros(format!("use the name '{name}'"), &problem))
}

/// The port that a service of the node is called at.
pub(super) fn service_port(ros: &Ros, name: &str) -> Result<u16, NodeError> {
    let failed = |problem: &dyn ToString| NodeError::ros(format!("find the port of '{name}'"), &problem.to_string());
    let uri = connect(ros.name(), ros.uri())?.lookup_service(&resolved(ros, name)?).map_err(|error| failed(&error))?;
    let port = uri.trim_end_matches('/').rsplit(':').next().and_then(|port| port.parse().ok());
    port.ok_or_else(|| failed(&format!("the master says '{uri}'")))
}

/// An entry in the master's books.
pub(super) enum Role {
    Publisher { topic: &'static str, message_type: String },
    Subscriber { topic: &'static str, message_type: String },
}

/// What became of the link to the master since it was last looked at.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Change {
    None,
    /// It does not answer any more.
    Lost,
    /// There is one again, and it knows the topics again; services have to be offered anew.
    Returned,
}

/// Keeps the node known to the master. A master that was started again knows nothing of the nodes of its predecessor, whose links to
/// each other live on: those must not be cut.
pub(super) struct MasterLink<'a> {
    ros: &'a Ros,
    master: &'a Master,
    roles: Vec<Role>,
    present: bool,
    log: Log,
}

impl<'a> MasterLink<'a> {
    /// A node that is registered under these roles. Its publishers are as they shall be from now on.
    pub(super) fn new(ros: &'a Ros, master: &'a Master, roles: Vec<Role>, log: &Log) -> Result<Self, NodeError> {
        let link = Self { ros, master, roles, present: true, log: log.clone() };
        sockets::tune(&link.ports()?);
        Ok(link)
    }

    /// The ports that the node publishes by. rosrust does not say; whoever subscribes is told.
    fn ports(&self) -> Result<HashSet<u16>, NodeError> {
        let port = |topic: &str| {
            let address = request_topic(self.ros.uri(), self.ros.name(), &resolved(self.ros, topic)?);
            address.map(|(_, port)| port).map_err(|error| NodeError::ros(format!("find the port of '{topic}'"), &error))
        };
        let published = self.roles.iter().filter_map(|role| match role {
            Role::Publisher { topic, .. } => Some(*topic),
            Role::Subscriber { .. } => None,
        });
        published.map(port).collect()
    }

    /// Whether the master answered when it was last asked.
    pub(super) fn is_present(&self) -> bool {
        self.present
    }

    /// Looks whether the master is there and knows this node, and registers again where it does not.
    pub(super) fn check(&mut self) -> Change {
        let known = self.master.lookup_node(self.ros.name());
        let answers = known.is_ok() || self.master.get_uri().is_ok();
        match (std::mem::replace(&mut self.present, answers), answers) {
            (true, false) => {
                self.log.warn("the ROS master does not answer: going on with the connections there are");
                Change::Lost
            }
            (_, true) if known.is_err() => self.return_to_master(),
            _ => Change::None,
        }
    }

    fn return_to_master(&mut self) -> Change {
        let outcome = self.roles.iter().try_for_each(|role| self.register(role));
        match outcome {
            Ok(()) => {
                self.log.info("the ROS master was started again: registered again");
                Change::Returned
            }
            Err(error) => {
                self.log.warn(&format!("the ROS master was started again: {error}"));
                self.present = false;
                Change::None
            }
        }
    }

    fn register(&self, role: &Role) -> Result<(), NodeError> {
        let failed = |topic: &str, error: ResponseError| NodeError::ros(format!("register '{topic}'"), &error);
        let done = match role {
            Role::Publisher { topic, message_type } => {
                self.master.register_publisher(&resolved(self.ros, topic)?, message_type).map_err(|error| failed(topic, error))
            }
            Role::Subscriber { topic, message_type } => {
                self.master.register_subscriber(&resolved(self.ros, topic)?, message_type).map_err(|error| failed(topic, error))
            }
        };
        done.map(|_peers| ())
    }
}
