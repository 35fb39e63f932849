//! The node's XML-RPC server, which other nodes, the master and `rosnode` call: <http://wiki.ros.org/ROS/Slave_API>.
//!
//! rosrust has such a server, but it does not list the node's connections (`rosnode info` fails), and it does not pass on the
//! master's `publisherUpdate`. So this module is a proxy on both sides of rosrust. rosrust uses the proxy as its master; the
//! proxy forwards every call to the real master and replaces rosrust's own address by that of this server. This server answers
//! what rosrust cannot, and forwards the other calls to rosrust.
//!
//! ```text
//!  master <---- master proxy <---- rosrust       other nodes, master ----> node's server ----> rosrust
//! ```
//!
//! There is one instance per process, since a process runs one node.

use std::env;
use std::net::{SocketAddr, ToSocketAddrs as _};
use std::sync::{Arc, Mutex, OnceLock, Weak};

use rosrust::api::resolve;
use rosrust::{Message, Publisher};
use xml_rpc::{Fault, Params, Response, Server, Url, Value};

use super::NodeError;
use super::threads::spawn;
use crate::parallel::lock;

/// Environment variable from which rosrust reads the master's address, unless [`MASTER_ARGUMENT`] is given.
const MASTER: &str = "ROS_MASTER_URI";
/// Command-line argument that overrides the master's address.
const MASTER_ARGUMENT: &str = "__master:=";
/// Methods of the master that rosrust calls. The master proxy forwards them.
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
/// Methods of the node that are only forwarded to rosrust.
const NODE_CALLS: [&str; 5] = ["shutdown", "getPid", "getPublications", "paramUpdate", "requestTopic"];

static NODE: OnceLock<NodeApi> = OnceLock::new();

/// Addresses and connections of the node.
struct NodeApi {
    uri: String,
    master: Url,
    /// Address of rosrust's own server, known after its first registration.
    rosrust: OnceLock<String>,
    subscription_info: Mutex<Option<Weak<dyn SubscriptionInfo>>>,
    published_topics: Mutex<Vec<PublishedTopic>>,
}

/// Information about the node's subscriptions.
pub(super) trait SubscriptionInfo: Send + Sync {
    /// Subscribed topics and their types.
    fn topics(&self) -> Vec<(String, String)>;
    /// Subscribed topics and the publishers that they are connected to, one pair per connection.
    fn connections(&self) -> Vec<(String, String)>;
    /// Called when the master reports that the publishers of a topic have changed.
    fn on_publisher_update(&self);
}

/// Returns the names of a topic's subscribers, or `None` if the topic is no longer published.
type SubscriberNames = Box<dyn Fn() -> Option<Vec<String>> + Send>;

struct PublishedTopic {
    topic: String,
    subscribers: SubscriberNames,
}

/// Starts the servers. Call this before rosrust starts and while no other thread reads the environment. If a command-line
/// argument gives the master's address, nothing is started: rosrust would bypass the proxy.
#[allow(unsafe_code)]
pub(super) fn start() -> Result<(), NodeError> {
    if env::args().any(|argument| argument.starts_with(MASTER_ARGUMENT)) || NODE.get().is_some() {
        return Ok(());
    }
    let (master, host) = (resolve::master(), resolve::hostname());
    let url = master.parse().map_err(|problem| NodeError::ros(format!("use the ROS master address '{master}'"), &problem))?;
    let proxy = serve(master_proxy(), "localhost")?;
    let is_local = host == "localhost" || host.starts_with("127.");
    let server = serve(node_server(), if is_local { &host } else { "0.0.0.0" })?;
    let uri = format!("http://{host}:{}/", server.port());
    let _ = NODE.set(NodeApi {
        uri,
        master: url,
        rosrust: OnceLock::new(),
        subscription_info: Mutex::default(),
        published_topics: Mutex::default(),
    });
    // SAFETY: The threads that exist by now wait for signals and connections, and do not read the environment.
    unsafe { env::set_var(MASTER, format!("http://localhost:{}/", proxy.port())) };
    Ok(())
}

/// The master's address.
pub(super) fn master_uri() -> String {
    NODE.get().map_or_else(resolve::master, |node| node.master.to_string())
}

/// The node's XML-RPC address; `rosrusts` is that of rosrust's server, which is used if no server was started here.
pub(super) fn uri(rosrusts: &str) -> &str {
    NODE.get().map_or(rosrusts, |node| &node.uri)
}

/// Sets the source of information about the node's subscriptions.
pub(super) fn set_subscription_info(subscription_info: &Arc<impl SubscriptionInfo + 'static>) {
    if let Some(node) = NODE.get() {
        let subscription_info = Arc::downgrade(subscription_info);
        *lock(&node.subscription_info) = Some(subscription_info);
    }
}

/// Makes `rosnode info` list a publisher for as long as it lives.
pub(super) fn list_publisher<T: Message>(topic: String, publisher: Publisher<T>) -> Arc<Publisher<T>> {
    let publisher = Arc::new(publisher);
    if let Some(node) = NODE.get() {
        let weak = Arc::downgrade(&publisher);
        let subscribers = Box::new(move || Some(weak.upgrade()?.subscriber_names()));
        lock(&node.published_topics).push(PublishedTopic { topic, subscribers });
    }
    publisher
}

impl NodeApi {
    fn subscription_info(&self) -> Option<Arc<dyn SubscriptionInfo>> {
        lock(&self.subscription_info).as_ref()?.upgrade()
    }

    /// Published topics and the names of their subscribers.
    fn published_topics(&self) -> Vec<(String, Vec<String>)> {
        let mut found = Vec::new();
        lock(&self.published_topics).retain(|PublishedTopic { topic, subscribers }| {
            let subscribers = subscribers();
            let is_published = subscribers.is_some();
            found.extend(subscribers.map(|subscribers| (topic.clone(), subscribers)));
            is_published
        });
        found
    }

    /// Every connection: number, the other node, direction, transport, topic, whether it is connected.
    fn bus_info(&self) -> Value {
        let inward = self.subscription_info().map(|subscription_info| subscription_info.connections()).unwrap_or_default();
        let outward = self
            .published_topics()
            .into_iter()
            .flat_map(|(topic, nodes)| nodes.into_iter().map(move |node| (topic.clone(), node)));
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

    /// Published and subscribed topics. Bytes and messages per connection are not counted.
    fn bus_stats(&self) -> Value {
        let none = || Value::Array(Vec::new());
        let published = |topic: String| Value::Array(vec![Value::String(topic), Value::Int(0), none()]);
        let subscribed = |topic: String| Value::Array(vec![Value::String(topic), none()]);
        let topics = self.subscription_info().map(|subscription_info| subscription_info.topics()).unwrap_or_default();
        let outward = self.published_topics().into_iter().map(|(topic, _)| published(topic)).collect();
        let inward = topics.into_iter().map(|(topic, _)| subscribed(topic)).collect();
        let services = Value::Array(vec![Value::Int(0), Value::Int(0), Value::Int(0)]);
        Value::Array(vec![Value::Array(outward), Value::Array(inward), services])
    }

    fn subscriptions(&self) -> Value {
        let topics = self.subscription_info().map(|subscription_info| subscription_info.topics()).unwrap_or_default();
        let pair = |(topic, kind)| Value::Array(vec![Value::String(topic), Value::String(kind)]);
        Value::Array(topics.into_iter().map(pair).collect())
    }

    /// Forwards a call of rosrust to the master, with the address of the node's server instead of rosrust's.
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

/// The proxy that rosrust uses as its master.
fn master_proxy() -> Server {
    let mut server = Server::new();
    for method in MASTER_CALLS {
        server.register_value(method, move |arguments| with_node(|node| node.call_master(method, arguments)));
    }
    server
}

/// The node's XML-RPC server.
fn node_server() -> Server {
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
            if let Some(subscription_info) = node.subscription_info() {
                subscription_info.on_publisher_update();
            }
            node.call_rosrust("publisherUpdate", arguments) // rosrust has its own subscription to /clock
        })
    });
    server
}

fn with_node(act: impl FnOnce(&NodeApi) -> Response) -> Response {
    NODE.get().map_or_else(|| Err(Fault::new(503, "the node is not ready yet")), act)
}

/// The response to a successful call: code, message, value.
fn answer(value: Value) -> Params {
    vec![Value::Array(vec![Value::Int(1), Value::String(String::new()), value])]
}

fn call(url: &Url, method: &str, arguments: Params) -> Response {
    xml_rpc::call_value(url, method, arguments).unwrap_or_else(|problem| Err(Fault::new(502, format!("{url}: {problem}"))))
}

/// Starts a server on a free port and returns its address.
fn serve(server: Server, host: &str) -> Result<SocketAddr, NodeError> {
    let failed = |problem: String| NodeError::ros(format!("start an XML-RPC server at {host}"), &problem);
    let address = (host, 0).to_socket_addrs().map_err(|error| failed(error.to_string()))?.next();
    let address = address.ok_or_else(|| failed("the host name has no address".into()))?;
    let bound = server.bind(&address).map_err(|error| failed(error.to_string()))?;
    let address = bound.local_addr();
    spawn("interface", move || bound.run())?;
    Ok(address)
}

/// The caller's XML-RPC address among the arguments of a registration: the only argument that is an HTTP URL.
fn address(arguments: &[Value]) -> Option<String> {
    arguments.iter().find_map(|argument| match argument {
        Value::String(address) if address.starts_with("http://") => Some(address.clone()),
        Value::Array(inner) => address(inner),
        _ => None,
    })
}

/// Replaces the text `old` by `new`, also in nested arrays.
fn replace(arguments: &mut [Value], old: &str, new: &str) {
    for argument in arguments {
        match argument {
            Value::String(text) if text == old => new.clone_into(text),
            Value::Array(inner) => replace(inner, old, new),
            _ => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn registrations_carry_the_address_of_the_node_server_instead_of_rosrusts() {
        let text = |text: &str| Value::String(text.into());
        let mut arguments = vec![Value::Array(vec![text("/node"), text("/scan"), text("type"), text("http://here:1/")])];
        assert_eq!(address(&arguments).as_deref(), Some("http://here:1/"));
        replace(&mut arguments, "http://here:1/", "http://here:2/");
        assert_eq!(address(&arguments).as_deref(), Some("http://here:2/"));
        assert_eq!(address(&[text("/node"), text("http://here:4/"), text("/use_sim_time")]).as_deref(), Some("http://here:4/"));
        assert_eq!(address(&[text("/node"), text("rosrpc://here:3")]), None);
    }
}
