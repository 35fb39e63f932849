//! The ROS 1 nodes: the scan matcher with mapping (`mapper`) or without, the particle filter, a demo controller, a path follower,
//! and a simulator. No other module of this project uses rosrust.
//!
//! ```text
//!  reader threads             working thread                       main thread
//!  subscriptions --> mailbox --> worker: algorithm --> publishers   node: signals, diagnostics at 1 Hz, the master
//! ```
//!
//! Each node has a folder with its `worker::Algorithm`, its list of `input::Input` and its publishers. The files beside the
//! folders are shared by all nodes.
//!
//! Invariants: callbacks only record the arrival time and fill the `mailbox`, so slow work never delays reception; every scan
//! either gets an answer or is counted as dropped; outgoing messages carry the stamp of the scan they belong to; nothing waits on
//! ROS time, which may stand still.

mod context;
pub mod contract_demo;
mod convert;
mod diagnostics;
mod input;
mod interrupts;
mod live_params;
mod log;
mod mailbox;
mod map_output;
mod mapper;
mod markers;
mod master;
mod node;
mod node_api;
mod output;
mod params;
pub mod particle_filter;
pub mod path_follower;
mod priority;
pub mod racecar_sim;
mod reader;
mod scan_matcher;
mod sequence;
mod services;
mod shutdown;
mod sink;
mod sockets;
mod subscriptions;
mod tcpros;
mod threads;
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

/// Why a node cannot run.
#[derive(Debug, Error)]
pub enum NodeError {
    /// A parameter is invalid.
    #[error("{problem}\nParameters stay on the parameter server until they are deleted: rosparam delete {node}")]
    Parameters {
        /// Fully resolved name of the node.
        node: String,
        /// The parameter, and what a valid value would be.
        problem: ConfigError,
    },
    /// The parameters give an invalid contract.
    #[error(transparent)]
    Contract(#[from] ContractError),
    /// A file that the configuration names is unusable.
    #[error(transparent)]
    Start(#[from] StartError),
    /// The shared memory cannot be opened.
    #[error(transparent)]
    SharedMemory(#[from] SharedMemoryError),
    /// The map cannot be used.
    #[error(transparent)]
    Map(#[from] MapError),
    /// The world has no closed loop to drive.
    #[error(transparent)]
    Route(#[from] NoLoop),
    /// The CSV file cannot be written.
    #[error("cannot write {problem}")]
    Csv {
        /// The file and the error of the operating system.
        problem: String,
    },
    /// An operation on the ROS graph failed.
    #[error("cannot {action}: {problem}")]
    Ros {
        /// The operation that failed.
        action: String,
        /// The error of rosrust or of the master.
        problem: String,
    },
    /// A system call failed.
    #[error("cannot {action}: {problem}")]
    System {
        /// The operation that failed.
        action: &'static str,
        /// The error of the operating system.
        problem: std::io::Error,
    },
}

impl NodeError {
    fn ros(action: impl Into<String>, problem: &impl ToString) -> Self {
        Self::Ros { action: action.into(), problem: problem.to_string() }
    }
}
