//! Follows paths on the ROS graph: poses and paths in, `drive` out.
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
use crate::transforms::LaserPlace;

const NAME: &str = "path_follower";

crate::knobs! {
    /// The node.
    pub struct PathFollowerKnobs {
        /// A CSV file of waypoints x, y[, speed], in the map's frame, to be followed from the start; unset: paths come by topic.
        path_file: Option<String> = None;
        /// The YAML file of a map to plan on; unset: the map of the topic `map`.
        map_file: Option<String> = None;
        /// Whether to plan a way round the map of `map_file` and follow it until another path comes.
        drive_round: bool = false;
        /// The frame of the waypoints of `path_file`, and of the map.
        map_frame: String = "map".into();
        /// The robot's frame.
        base_frame: String = "base_link".into();
        /// Where the laser is on the robot, `[x, y, yaw]`, or with its roll as a fourth number; unset: from `/tf`.
        laser_in_base: Option<LaserPlace> = None, unit "m, m, rad";
        /// Commands per second.
        rate: f64 = 50.0, in 1 to 1000, unit "Hz";
    }
}

/// All parameters of the node, in one namespace.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct AllKnobs {
    /// Of the node.
    pub node: PathFollowerKnobs,
    /// Of the follower.
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

/// Runs the node `path_follower` until SIGINT, SIGTERM or the master ends it. The arguments of the process are ROS's: remappings and
/// parameters.
pub fn run() -> Result<(), NodeError> {
    super::node::run(NAME, serve)
}

fn serve(ros: &Ros, master: &Master, stop: &StopSignal) -> Result<(), NodeError> {
    let knobs: AllKnobs = params::read_group(master, ros.name())?;
    node::build(ros, master, knobs)?.run(stop, || ())
}
