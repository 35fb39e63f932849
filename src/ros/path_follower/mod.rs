//! The path follower node: it subscribes to poses and paths and publishes commands on `drive`.
//!
//! ```text
//!  path, a file, or move_base_simple/goal + map ──► follower ──► drive, follower/report, follower/viz
//!  pose, scan, /tf ──────────────────────────────────┘
//! ```

mod convert;
mod intake;
mod node;

use rosrust::api::{Master, Ros};

use super::shutdown::StopSignal;
use super::{NodeError, params};
use crate::control::follower::FollowerKnobs;
use crate::knobs::{KnobGroup, KnobInfo, Value};
use crate::transforms::LaserPose;

const NAME: &str = "path_follower";

crate::knobs! {
    /// Parameters of the node.
    pub struct PathFollowerKnobs {
        /// CSV file of waypoints x, y[, speed] in the map frame, followed from the start; unset: paths arrive on the topic.
        path_file: Option<String> = None;
        /// YAML file of a map to plan on; unset: the map from the topic `map`.
        map_file: Option<String> = None;
        /// Whether to plan a loop through the map of `map_file` and follow it until a path arrives.
        drive_round: bool = false;
        /// Frame of the map and of the waypoints of `path_file`.
        map_frame: String = "map".into();
        /// Frame of the robot.
        base_frame: String = "base_link".into();
        /// Mount of the laser on the robot, `[x, y, yaw]`, or with its roll as a fourth number; unset: from `/tf`.
        laser_in_base: Option<LaserPose> = None, unit "m, m, rad";
        /// Commands per second.
        rate: f64 = 50.0, in 1 to 1000, unit "Hz";
    }
}

/// All parameters of the node, in one namespace.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct AllKnobs {
    /// Parameters of the node.
    pub node: PathFollowerKnobs,
    /// Parameters of the follower.
    pub follower: FollowerKnobs,
}

impl KnobGroup for AllKnobs {
    fn table(&self) -> Vec<KnobInfo> {
        [self.node.table(), self.follower.table()].concat()
    }

    fn get(&self, name: &str) -> Option<Value> {
        self.node.get(name).or_else(|| self.follower.get(name))
    }

    fn set(&mut self, name: &str, value: &Value) -> Option<Result<(), String>> {
        self.node.set(name, value).or_else(|| self.follower.set(name, value))
    }
}

/// Runs the node `path_follower` until SIGINT, SIGTERM or the master ends it. The process arguments are those of ROS: remappings
/// and private parameters.
pub fn run() -> Result<(), NodeError> {
    super::node::run(NAME, serve)
}

fn serve(ros: &Ros, master: &Master, stop: &StopSignal) -> Result<(), NodeError> {
    let knobs: AllKnobs = params::read_group(master, ros.name())?;
    node::build(ros, master, knobs)?.run(stop, || ())
}
