//! What all nodes have in common: how they begin and end.

use rosrust::api::{Master, Ros};

use super::NodeError;
use super::master::{connect, wait_for_master};
use super::node_api;
use super::shutdown::StopSignal;

/// Runs `serve` as the ROS node `name` once there is a master; returns early when the node is to stop before. The arguments of the
/// process are ROS's: remappings and parameters.
pub(super) fn run(name: &str, serve: impl FnOnce(&Ros, &Master, &StopSignal) -> Result<(), NodeError>) -> Result<(), NodeError> {
    let stop = StopSignal::install()?;
    node_api::start()?;
    if !wait_for_master(name, &stop)? {
        return Ok(());
    }
    let ros = Ros::new(name).map_err(|error| NodeError::ros("start as a ROS node", &error))?;
    let outcome = connect(ros.name(), ros.uri()).and_then(|master| serve(&ros, &master, &stop));
    ros.shutdown_sender().shutdown(); // removes the last registration with the master: rosrust's own publisher of /rosout
    outcome
}
