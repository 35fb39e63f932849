//! Nodes that speak the raw protocol and can do what no client library would.

use std::io::{self, BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::time::Duration;

use anytime_scan_matcher::messages::{self, Message};

use super::graph::{Graph, TIMEOUT, call, eventually};

/// Name of the scan matcher's node.
const NODE: &str = "/scan_matcher";

/// A publisher that is registered with the master and answers topic requests with its port; the rest is up to the test.
pub struct Publisher {
    name: String,
    topic: &'static str,
    message_type: &'static str,
    md5: &'static str,
    api: String,
    data: TcpListener,
}

impl Publisher {
    pub fn new<T: Message>(graph: &Graph, name: &str, topic: &'static str) -> Self {
        let (api, data) = (TcpListener::bind("localhost:0").unwrap(), TcpListener::bind("localhost:0").unwrap());
        data.set_nonblocking(true).unwrap();
        let (api_port, port) = (api.local_addr().unwrap().port(), data.local_addr().unwrap().port());
        std::thread::spawn(move || answer_requests(&api, port));
        let api = format!("http://localhost:{api_port}/");
        let publisher = Self { name: name.into(), topic, message_type: T::TYPE, md5: &T::definition().md5, api, data };
        publisher.register(graph);
        publisher
    }

    pub fn register(&self, graph: &Graph) {
        graph.call_master("registerPublisher", &[&self.name, self.topic, self.message_type, &self.api]);
    }

    pub fn unregister(&self, graph: &Graph) {
        graph.call_master("unregisterPublisher", &[&self.name, self.topic, &self.api]);
    }

    /// Accepts the next subscriber, without answering its header.
    pub fn accept(&self) -> TcpStream {
        let mut stream = None;
        assert!(
            eventually(|| {
                stream = self.data.accept().ok();
                stream.is_some()
            }),
            "nobody subscribes to {} of {}",
            self.topic,
            self.name
        );
        let (mut stream, _) = stream.unwrap();
        stream.set_nonblocking(false).unwrap();
        stream.set_nodelay(true).unwrap();
        stream.set_read_timeout(Some(TIMEOUT)).unwrap();
        read_block(&mut stream).unwrap();
        stream
    }

    /// Accepts the next subscriber, which is then ready for messages.
    pub fn link(&self) -> TcpStream {
        let mut stream = self.accept();
        let fields = [("callerid", &*self.name), ("type", self.message_type), ("md5sum", self.md5), ("topic", self.topic)];
        stream.write_all(&header(&fields)).unwrap();
        stream
    }
}

/// Publishes one message to this number of subscribers, once all of them are connected.
pub fn publish<T: Message>(graph: &Graph, topic: &'static str, message: &T, subscribers: usize) {
    let publisher = Publisher::new::<T>(graph, "/speaker", topic);
    let links: Vec<TcpStream> = (0..subscribers).map(|_| publisher.link()).collect();
    for mut link in links {
        link.write_all(&frame(&messages::encode(message).unwrap())).unwrap();
    }
    publisher.unregister(graph);
}

/// Answers every call with the port of the publisher.
fn answer_requests(api: &TcpListener, port: u16) {
    let body = format!(
        "<?xml version='1.0'?><methodResponse><params><param><value><array><data><value><int>1</int></value><value><string>\
         </string></value><value><array><data><value><string>TCPROS</string></value><value><string>localhost</string></value>\
         <value><int>{port}</int></value></data></array></value></data></array></value></param></params></methodResponse>"
    );
    for stream in api.incoming() {
        let mut stream = BufReader::new(stream.unwrap());
        let lines = stream.by_ref().lines().map_while(Result::ok).take_while(|line| !line.is_empty());
        let length = lines.filter_map(|line| line.to_lowercase().strip_prefix("content-length:")?.trim().parse().ok()).last();
        let _ = stream.read_exact(&mut vec![0; length.unwrap_or_default()]);
        let mut stream = stream.into_inner();
        let head = "HTTP/1.1 200 OK\r\nContent-Type: text/xml\r\nConnection: close";
        let _ = write!(stream, "{head}\r\nContent-Length: {}\r\n\r\n{body}", body.len());
    }
}

/// A subscriber to a topic of a node.
pub struct Listener {
    pub stream: TcpStream,
}

impl Listener {
    /// Subscribes to a topic of the scan matcher.
    pub fn new(graph: &Graph, topic: &str) -> Self {
        Self::of(graph, NODE, topic)
    }

    /// Connects to a node and sends the subscriber's header.
    pub fn of(graph: &Graph, node: &str, topic: &str) -> Self {
        let mut stream = connect_to(graph, node, topic);
        let fields = [("callerid", "/listener"), ("topic", topic), ("md5sum", "*"), ("type", "*"), ("tcp_nodelay", "1")];
        stream.write_all(&header(&fields)).unwrap();
        read_block(&mut stream).unwrap();
        std::thread::sleep(Duration::from_millis(200)); // for the node to add it to its subscribers
        Self { stream }
    }

    pub fn next<T: Message>(&mut self) -> T {
        messages::decode(&self.next_bytes().unwrap()).unwrap()
    }

    /// The next message for which `is_it` holds.
    pub fn find<T: Message>(&mut self, is_it: impl Fn(&T) -> bool) -> T {
        loop {
            let message = self.next();
            if is_it(&message) {
                return message;
            }
        }
    }

    pub fn next_bytes(&mut self) -> io::Result<Vec<u8>> {
        read_block(&mut self.stream)
    }
}

/// A connection to the port on which the scan matcher publishes `topic`, before any header is sent.
pub fn connect(graph: &Graph, topic: &str) -> TcpStream {
    connect_to(graph, NODE, topic)
}

fn connect_to(graph: &Graph, node: &str, topic: &str) -> TcpStream {
    let api = graph.node_address(node);
    let protocols =
        "<array><data><value><array><data><value><string>TCPROS</string></value></data></array></value></data></array>";
    let answer =
        call(&api, "requestTopic", &["<string>/test</string>".into(), format!("<string>{topic}</string>"), protocols.into()]);
    let mut numbers = answer.rsplit(|c: char| !c.is_ascii_digit()).filter_map(|word| word.parse::<u16>().ok());
    let port = numbers.find(|port| *port > 1024).unwrap();
    let stream = TcpStream::connect(("localhost", port)).unwrap();
    stream.set_read_timeout(Some(TIMEOUT)).unwrap();
    stream
}

/// `bytes` preceded by their length.
pub fn frame(bytes: &[u8]) -> Vec<u8> {
    [&u32::try_from(bytes.len()).unwrap().to_le_bytes()[..], bytes].concat()
}

fn header(fields: &[(&str, &str)]) -> Vec<u8> {
    frame(&fields.iter().flat_map(|(name, value)| frame(format!("{name}={value}").as_bytes())).collect::<Vec<_>>())
}

fn read_block(stream: &mut TcpStream) -> io::Result<Vec<u8>> {
    let mut length = [0; 4];
    stream.read_exact(&mut length)?;
    let mut bytes = vec![0; u32::from_le_bytes(length) as usize];
    stream.read_exact(&mut bytes)?;
    Ok(bytes)
}
