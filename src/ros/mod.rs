//! The ROS 1 nodes: the scan matcher, with a map (`mapper`) or without, the particle filter, a controller, a follower of paths, and a
//! simulator. Nothing else in this project knows of rosrust.
//!
//! ```text
//!  reader threads             working thread                       main thread
//!  subscriptions --> mailbox --> worker: algorithm --> publishers   node: signals, diagnostics at 1 Hz, the master
//! ```
//!
//! A node has a folder: its `worker::Algorithm`, its list of `input::Input`, its publishers. The files beside the folders are what all
//! nodes share.
//!
//! Invariants: callbacks only note the arrival and fill the `mailbox`, so that nothing that is slow ever delays reception; a scan is
//! either answered or counted as dropped; messages leave with the stamp of the scan they are about; nothing waits on ROS time, which
//! may stand still.

mod context;
pub mod contract_demo;
mod convert;
mod diagnostics;
mod input;
mod interrupts;
mod live_params;
mod log;
mod mailbox;
mod mapper;
mod markers;
mod master;
mod node;
mod node_api;
mod numbering;
mod output;
mod params;
pub mod particle_filter;
pub mod path_follower;
mod priority;
pub mod racecar_sim;
mod reader;
mod scan_matcher;
mod services;
mod shutdown;
mod sink;
mod sockets;
mod subscriptions;
mod tcpros;
mod topic_subscription;
mod transform_output;
mod worker;

pub use scan_matcher::{run, run_as_laser_scan_matcher, run_mapper};

use thiserror::Error;

use crate::anytime::contract::ContractError;
use crate::app::StartError;
use crate::config::ConfigError;
use crate::io::map_file::MapError;
use crate::shared_memory::SharedMemoryError;
use crate::simulation::planner::NoLoop;

/// Why the node cannot run.
#[derive(Debug, Error)]
pub enum NodeError {
    /// A parameter is wrong.
    #[error("{problem}\nParameters stay on the master until they are deleted: rosparam delete {node}")]
    Parameters {
        /// Full name of the node.
        node: String,
        /// Which one, and what would be right.
        problem: ConfigError,
    },
    /// The parameters give an invalid contract.
    #[error(transparent)]
    Contract(#[from] ContractError),
    /// A file that the configuration names is unusable.
    #[error(transparent)]
    Start(#[from] StartError),
    /// The shared memory cannot be had.
    #[error(transparent)]
    SharedMemory(#[from] SharedMemoryError),
    /// The map cannot be used.
    #[error(transparent)]
    Map(#[from] MapError),
    /// There is no way to drive on and on in the world.
    #[error(transparent)]
    Route(#[from] NoLoop),
    /// A file of comma-separated values cannot be written.
    #[error("cannot write {problem}")]
    Csv {
        /// The file, and the system's reason.
        problem: String,
    },
    /// The ROS graph refused something.
    #[error("cannot {action}: {problem}")]
    Ros {
        /// What was tried.
        action: String,
        /// rosrust's or the master's reason.
        problem: String,
    },
    /// The operating system refused something.
    #[error("cannot {action}: {problem}")]
    System {
        /// What was tried.
        action: &'static str,
        /// The system's reason.
        problem: std::io::Error,
    },
}

impl NodeError {
    fn ros(action: impl Into<String>, problem: &impl ToString) -> Self {
        Self::Ros { action: action.into(), problem: problem.to_string() }
    }
}
