//! The ROS master: waiting for it, and what to do when it goes away and comes back.

use std::time::Duration;

use rosrust::api::{Master, Ros, resolve};
use rosrust::{RawMessage, error::ResponseError};

use super::NodeError;
use super::log::{Log, print};
use super::shutdown::StopSignal;

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
    /// A node that is registered under these roles; tells the master the types of the topics it subscribes to.
    pub(super) fn new(ros: &'a Ros, master: &'a Master, roles: Vec<Role>, log: &Log) -> Result<Self, NodeError> {
        let link = Self { ros, master, roles, present: true, log: log.clone() };
        for role in &link.roles {
            link.register(role)?;
        }
        Ok(link)
    }

    /// From now on it has this role too.
    pub(super) fn add(&mut self, role: Role) {
        self.roles.push(role);
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
        let outcome = self.roles.iter().try_for_each(|role| {
            self.reconnect(role)?;
            self.register(role)
        });
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

    /// Connects to the publishers that the new master knows of. rosrust does so for every new subscriber of a topic; the one made here
    /// shares its links with the one there is and leaves them behind.
    fn reconnect(&self, role: &Role) -> Result<(), NodeError> {
        if let Role::Subscriber { topic, .. } = role {
            let extra = self.ros.subscribe::<RawMessage, _>(topic, 1, |_| ());
            drop(extra.map_err(|error| NodeError::ros(format!("subscribe to '{topic}' again"), &error))?);
        }
        Ok(())
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
