//! What the node answers other nodes, the master and `rosnode` by XML-RPC, <http://wiki.ros.org/ROS/Slave_API>.
//!
//! rosrust answers for the node, but does not say whom it is connected to (`rosnode info` fails), and it keeps to itself when the master
//! tells of a new publisher. So this stands in front of it: rosrust takes a stand-in for its master, which hands every call on to the
//! real one, but with this interface's address where rosrust gives its own. What comes here and is rosrust's business goes on to it.
//!
//! ```text
//!  master <---- stand-in <---- rosrust       other nodes, master ----> node's interface ----> rosrust
//! ```
//!
//! There is one for the process, as there is one node.

use std::env;
use std::net::{SocketAddr, ToSocketAddrs as _};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError, Weak};
use std::thread;

use rosrust::api::resolve;
use rosrust::{Message, Publisher};
use xml_rpc::{Fault, Params, Response, Server, Url, Value};

use super::NodeError;

/// Where rosrust looks for its master, unless an argument says otherwise.
const MASTER: &str = "ROS_MASTER_URI";
const MASTER_ARGUMENT: &str = "__master:=";
/// The calls that rosrust makes of its master.
const MASTER_CALLS: [&str; 20] = [
    "registerService",
    "unregisterService",
    "registerSubscriber",
    "unregisterSubscriber",
    "registerPublisher",
    "unregisterPublisher",
    "lookupNode",
    "getPublishedTopics",
    "getTopicTypes",
    "getSystemState",
    "getUri",
    "lookupService",
    "deleteParam",
    "setParam",
    "getParam",
    "searchParam",
    "subscribeParam",
    "unsubscribeParam",
    "hasParam",
    "getParamNames",
];
/// The calls of a node that are rosrust's business alone.
const NODE_CALLS: [&str; 5] = ["shutdown", "getPid", "getPublications", "paramUpdate", "requestTopic"];

static NODE: OnceLock<NodeApi> = OnceLock::new();

/// Addresses, and what the node is connected to.
struct NodeApi {
    uri: String,
    master: Url,
    /// rosrust's own address, once it has told it.
    rosrust: OnceLock<String>,
    inputs: Mutex<Option<Weak<dyn Inputs>>>,
    outputs: Mutex<Vec<Output>>,
}

/// What the node is subscribed to.
pub(super) trait Inputs: Send + Sync {
    /// Topics and their types.
    fn topics(&self) -> Vec<(String, String)>;
    /// Topics and the publishers they are connected to.
    fn connections(&self) -> Vec<(String, String)>;
    /// The master knows other publishers of a topic than before.
    fn look_again(&self);
}

/// Names of the nodes that listen to a topic; `None`: it is published no more.
type Listeners = Box<dyn Fn() -> Option<Vec<String>> + Send>;

struct Output {
    topic: String,
    listeners: Listeners,
}

/// Begins to answer for the node; to be called before rosrust starts, and while no other thread reads the environment. Where an argument
/// says where the master is, rosrust goes there by itself and answers as far as it can.
#[allow(unsafe_code)]
pub(super) fn start() -> Result<(), NodeError> {
    if env::args().any(|argument| argument.starts_with(MASTER_ARGUMENT)) || NODE.get().is_some() {
        return Ok(());
    }
    let (master, host) = (resolve::master(), resolve::hostname());
    let url = master.parse().map_err(|problem| NodeError::ros(format!("use the ROS master's address '{master}'"), &problem))?;
    let stand_in = serve(stand_in(), "localhost")?;
    let is_local = host == "localhost" || host.starts_with("127.");
    let interface = serve(interface(), if is_local { &host } else { "0.0.0.0" })?;
    let uri = format!("http://{host}:{}/", interface.port());
    let _ = NODE.set(NodeApi { uri, master: url, rosrust: OnceLock::new(), inputs: Mutex::default(), outputs: Mutex::default() });
    // SAFETY: The threads that there are wait for signals and connections, and do not read the environment.
    unsafe { env::set_var(MASTER, format!("http://localhost:{}/", stand_in.port())) };
    Ok(())
}

/// Where the master is.
pub(super) fn master_uri() -> String {
    NODE.get().map_or_else(resolve::master, |node| node.master.to_string())
}

/// The address that the node is known by, which rosrust takes to be `rosrusts`.
pub(super) fn uri(rosrusts: &str) -> &str {
    NODE.get().map_or(rosrusts, |node| &node.uri)
}

/// Sets what the node is subscribed to.
pub(super) fn set_inputs(inputs: &Arc<impl Inputs + 'static>) {
    if let Some(node) = NODE.get() {
        let inputs = Arc::downgrade(inputs);
        *lock(&node.inputs) = Some(inputs);
    }
}

/// A publisher that `rosnode info` lists as long as it lives.
pub(super) fn listed<T: Message>(topic: String, publisher: Publisher<T>) -> Arc<Publisher<T>> {
    let publisher = Arc::new(publisher);
    if let Some(node) = NODE.get() {
        let weak = Arc::downgrade(&publisher);
        let listeners = Box::new(move || Some(weak.upgrade()?.subscriber_names()));
        lock(&node.outputs).push(Output { topic, listeners });
    }
    publisher
}

impl NodeApi {
    fn inputs(&self) -> Option<Arc<dyn Inputs>> {
        lock(&self.inputs).as_ref()?.upgrade()
    }

    /// Topics that are published, with their listeners.
    fn outputs(&self) -> Vec<(String, Vec<String>)> {
        let mut found = Vec::new();
        lock(&self.outputs).retain(|Output { topic, listeners }| {
            let listeners = listeners();
            let is_there = listeners.is_some();
            found.extend(listeners.map(|listeners| (topic.clone(), listeners)));
            is_there
        });
        found
    }

    /// Every connection: number, the other node, direction, transport, topic, whether it is there.
    fn bus_info(&self) -> Value {
        let inward = self.inputs().map(|inputs| inputs.connections()).unwrap_or_default();
        let outward =
            self.outputs().into_iter().flat_map(|(topic, nodes)| nodes.into_iter().map(move |node| (topic.clone(), node)));
        let all = inward.into_iter().map(|connection| ("i", connection)).chain(outward.map(|connection| ("o", connection)));
        let line = |(number, (direction, (topic, node))): (i32, (&str, (String, String)))| {
            Value::Array(vec![
                Value::Int(number),
                Value::String(node),
                Value::String(direction.into()),
                Value::String("TCPROS".into()),
                Value::String(topic),
                Value::Bool(true),
            ])
        };
        Value::Array((1..).zip(all).map(line).collect())
    }

    /// Topics published and heard; what went through each connection is not counted.
    fn bus_stats(&self) -> Value {
        let none = || Value::Array(Vec::new());
        let published = |topic: String| Value::Array(vec![Value::String(topic), Value::Int(0), none()]);
        let heard = |topic: String| Value::Array(vec![Value::String(topic), none()]);
        let topics = self.inputs().map(|inputs| inputs.topics()).unwrap_or_default();
        let outward = self.outputs().into_iter().map(|(topic, _)| published(topic)).collect();
        let inward = topics.into_iter().map(|(topic, _)| heard(topic)).collect();
        let services = Value::Array(vec![Value::Int(0), Value::Int(0), Value::Int(0)]);
        Value::Array(vec![Value::Array(outward), Value::Array(inward), services])
    }

    fn subscriptions(&self) -> Value {
        let topics = self.inputs().map(|inputs| inputs.topics()).unwrap_or_default();
        let pair = |(topic, kind)| Value::Array(vec![Value::String(topic), Value::String(kind)]);
        Value::Array(topics.into_iter().map(pair).collect())
    }

    /// Hands a call on to the master, as if the node's interface had made it.
    fn call_master(&self, method: &str, mut arguments: Params) -> Response {
        if ["register", "subscribeParam"].iter().any(|start| method.starts_with(start))
            && let Some(address) = address(&arguments)
        {
            let _ = self.rosrust.set(address); // it does not change
        }
        if let Some(rosrust) = self.rosrust.get() {
            replace(&mut arguments, rosrust, &self.uri);
        }
        call(&self.master, method, arguments)
    }

    fn call_rosrust(&self, method: &str, arguments: Params) -> Response {
        match self.rosrust.get().map(|address| address.parse()) {
            Some(Ok(url)) => call(&url, method, arguments),
            _ => Err(Fault::new(503, "the node is not ready yet")),
        }
    }
}

/// The stand-in for the master.
fn stand_in() -> Server {
    let mut server = Server::new();
    for method in MASTER_CALLS {
        server.register_value(method, move |arguments| with_node(|node| node.call_master(method, arguments)));
    }
    server
}

/// The node's interface.
fn interface() -> Server {
    let mut server = Server::new();
    for method in NODE_CALLS {
        server.register_value(method, move |arguments| with_node(|node| node.call_rosrust(method, arguments)));
    }
    server.register_value("getMasterUri", |_| with_node(|node| Ok(answer(Value::String(node.master.to_string())))));
    server.register_value("getBusInfo", |_| with_node(|node| Ok(answer(node.bus_info()))));
    server.register_value("getBusStats", |_| with_node(|node| Ok(answer(node.bus_stats()))));
    server.register_value("getSubscriptions", |_| with_node(|node| Ok(answer(node.subscriptions()))));
    server.register_value("publisherUpdate", |arguments| {
        with_node(|node| {
            if let Some(inputs) = node.inputs() {
                inputs.look_again();
            }
            node.call_rosrust("publisherUpdate", arguments) // it hears ROS's time by itself
        })
    });
    server
}

fn with_node(act: impl FnOnce(&NodeApi) -> Response) -> Response {
    NODE.get().map_or_else(|| Err(Fault::new(503, "the node is not ready yet")), act)
}

/// A call that went well: code, message, value.
fn answer(value: Value) -> Params {
    vec![Value::Array(vec![Value::Int(1), Value::String(String::new()), value])]
}

fn call(url: &Url, method: &str, arguments: Params) -> Response {
    xml_rpc::call_value(url, method, arguments).unwrap_or_else(|problem| Err(Fault::new(502, format!("{url}: {problem}"))))
}

/// Starts a server on a free port; where it listens.
fn serve(server: Server, host: &str) -> Result<SocketAddr, NodeError> {
    let failed = |problem: String| NodeError::ros(format!("listen at {host}"), &problem);
    let address = (host, 0).to_socket_addrs().map_err(|error| failed(error.to_string()))?.next();
    let address = address.ok_or_else(|| failed("it has no address".into()))?;
    let bound = server.bind(&address).map_err(|error| failed(error.to_string()))?;
    let address = bound.local_addr();
    let spawned = thread::Builder::new().name("interface".into()).spawn(move || bound.run());
    spawned.map_err(|problem| NodeError::System { action: "start a thread", problem })?;
    Ok(address)
}

/// The caller's address among the arguments of a registration: the only one that is a page's.
fn address(arguments: &[Value]) -> Option<String> {
    arguments.iter().find_map(|argument| match argument {
        Value::String(address) if address.starts_with("http://") => Some(address.clone()),
        Value::Array(inner) => address(inner),
        _ => None,
    })
}

fn replace(arguments: &mut [Value], old: &str, new: &str) {
    for argument in arguments {
        match argument {
            Value::String(text) if text == old => new.clone_into(text),
            Value::Array(inner) => replace(inner, old, new),
            _ => {}
        }
    }
}

/// What is locked here is consistent at every moment, even if a thread has panicked while it held the lock.
fn lock<T: ?Sized>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn registrations_name_the_interface_in_the_place_of_rosrust() {
        let text = |text: &str| Value::String(text.into());
        let mut arguments = vec![Value::Array(vec![text("/node"), text("/scan"), text("type"), text("http://here:1/")])];
        assert_eq!(address(&arguments).as_deref(), Some("http://here:1/"));
        replace(&mut arguments, "http://here:1/", "http://here:2/");
        assert_eq!(address(&arguments).as_deref(), Some("http://here:2/"));
        assert_eq!(address(&[text("/node"), text("http://here:4/"), text("/use_sim_time")]).as_deref(), Some("http://here:4/"));
        assert_eq!(address(&[text("/node"), text("rosrpc://here:3")]), None);
    }
}
