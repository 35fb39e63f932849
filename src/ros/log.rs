//! The log of a node, on stderr and on `/rosout`.

use std::collections::HashMap;
use std::io::Write as _;
use std::sync::Arc;
use std::time::Duration;

use rosrust::Publisher;
use rosrust::api::Ros;
use rosrust_msg::rosgraph_msgs;

use super::NodeError;
use super::node_api::list_publisher;

/// Topic of the logs of all nodes.
pub(super) const ROSOUT: &str = "/rosout";
/// Queue size of the `/rosout` publisher.
const QUEUE: usize = 100;
/// Minimum time between two warnings about the same subject.
const WARNING_PERIOD: Duration = Duration::from_secs(1);

/// Writes log lines. Write errors are ignored: a closed stderr must not end the node.
#[derive(Clone)]
pub(super) struct Log {
    node: String,
    rosout: Arc<Publisher<rosgraph_msgs::Log>>,
}

impl Log {
    pub(super) fn new(ros: &Ros) -> Result<Self, NodeError> {
        let rosout = ros.publish(ROSOUT, QUEUE).map_err(|error| NodeError::ros("publish /rosout", &error))?;
        Ok(Self { node: ros.name().into(), rosout: list_publisher(ROSOUT.into(), rosout) })
    }

    pub(super) fn info(&self, text: &str) {
        self.write("INFO", rosgraph_msgs::Log::INFO, text);
    }

    pub(super) fn warn(&self, text: &str) {
        self.write("WARN", rosgraph_msgs::Log::WARN, text);
    }

    pub(super) fn error(&self, text: &str) {
        self.write("ERROR", rosgraph_msgs::Log::ERROR, text);
    }

    fn write(&self, level_name: &str, level: i8, text: &str) {
        print(&format!("[{level_name}] {}: {text}", self.node));
        let message = rosgraph_msgs::Log { level, name: self.node.clone(), msg: text.into(), ..Default::default() };
        let _ = self.rosout.send(message); // only queues
    }
}

/// Prints a line on stderr. Use it directly only before there is a [`Log`].
pub(super) fn print(line: &str) {
    let _ = writeln!(std::io::stderr(), "{line}");
}

/// Limits the warnings about each subject to one per second.
#[derive(Default)]
pub(super) struct Throttle {
    last: HashMap<&'static str, Duration>,
}

impl Throttle {
    /// Whether a warning about `subject` may be logged at the time `now`.
    pub(super) fn allows(&mut self, subject: &'static str, now: Duration) -> bool {
        let allowed = self.last.get(subject).is_none_or(|last| now.saturating_sub(*last) >= WARNING_PERIOD);
        if allowed {
            self.last.insert(subject, now);
        }
        allowed
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_subject_warns_once_a_second() {
        let mut throttle = Throttle::default();
        let at = Duration::from_millis;
        assert!(throttle.allows("scan", at(0)) && throttle.allows("odom", at(0)));
        assert!(!throttle.allows("scan", at(999)) && throttle.allows("scan", at(1000)) && !throttle.allows("scan", at(1001)));
    }
}
