//! `rosbag play` that starts when all subscribers are connected.

use std::path::Path;
use std::time::Duration;

use anytime_scan_matcher::io::bag::Bag;
use serde::de::DeserializeOwned;

use super::graph::{Graph, Process, TIMEOUT, eventually, within};

const NAME: &str = "/play";
/// Maximum wait for subscribers: one that expects another message type never connects.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(4);

/// The master's registration of a topic or service: its name, and the names of nodes.
type Named = Vec<(String, Vec<String>)>;
/// A connection as roscpp reports it: number, the node at the other end, direction, protocol, topic, whether it is connected, and text.
type Connection = (i32, String, String, String, String, bool, String);

impl Graph {
    /// Plays a bag to its end.
    pub fn play(&self, bag: &Path, arguments: &[&str]) {
        let mut player = self.start_playing(bag, arguments);
        assert_eq!(player.exit_code(6 * TIMEOUT), Some(0), "{}", player.log());
    }

    pub fn start_playing(&self, bag: &Path, arguments: &[&str]) -> Process {
        let name = format!("__name:={}", &NAME[1..]);
        let player = self.spawn("rosbag", &[&["play", "--quiet", "--pause", bag.to_str().unwrap(), &name], arguments].concat());
        let topics: Vec<String> =
            Bag::open(bag).unwrap().connections().iter().map(|connection| connection.topic.clone()).collect();
        assert!(eventually(|| self.subscribers(&topics).is_some()), "{}", player.log());
        within(CONNECT_TIMEOUT, || self.are_connected(&topics));
        // Resume playback.
        self.request(&format!("{NAME}/pause_playback"), "std_srvs/SetBool", "09fb03525b03e7ea1fd3992bafd87e16", &[0]);
        player
    }

    /// Topic and node name of all subscribers of the player's topics. `None` until the player publishes all of them.
    fn subscribers(&self, topics: &[String]) -> Option<Vec<(String, String)>> {
        let (publishers, subscribers, services): (Named, Named, Named) = ask(&self.master_address(), "getSystemState")?;
        let of = |nodes: &Named, topic: &String| nodes.iter().find(|(name, _)| name == topic).map(|(_, nodes)| nodes.clone());
        let is_published = |topic| of(&publishers, topic).is_some_and(|nodes| nodes.iter().any(|node| node == NAME));
        let can_go_on = services.iter().any(|(name, _)| name.strip_prefix(NAME) == Some("/pause_playback"));
        (can_go_on && topics.iter().all(is_published)).then(|| {
            let listeners = topics.iter().map(|topic| (topic, of(&subscribers, topic).unwrap_or_default()));
            listeners.flat_map(|(topic, nodes)| nodes.into_iter().map(|node| (topic.clone(), node))).collect()
        })
    }

    fn are_connected(&self, topics: &[String]) -> bool {
        let connections: Vec<Connection> = ask(&self.node_address(NAME), "getBusInfo").unwrap_or_default();
        let is_connected =
            |(topic, node): &(String, String)| connections.iter().any(|link| link.1 == *node && link.4 == *topic && link.5);
        self.subscribers(topics).is_some_and(|subscribers| subscribers.iter().all(is_connected))
    }
}

/// The value returned by an XML-RPC call without arguments.
fn ask<T: DeserializeOwned>(address: &str, question: &str) -> Option<T> {
    let url = format!("http://{address}/").parse().unwrap();
    let answer: (i32, String, T) = xml_rpc::call(&url, question, ("/test",)).ok()?.ok()?;
    Some(answer.2)
}
