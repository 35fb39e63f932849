//! A replacement for F1TENTH's `racecar_simulator` with the same topics, frames, rates and peculiarities, so that nodes which
//! work with the one work with the other.
//!
//! ```text
//!  drive, cmd_vel ---> car ---> odom, gt_pose, /tf, scan (by the lidar)
//!  pose, initialpose ---^  teleports
//! ```
//!
//! The peculiarities are in `convert`. Sideslip and the transforms of the wheels are left out.

mod convert;
mod environment;
mod simulator;

use rosrust::api::{Master, Ros};

use self::environment::Environment;
use super::shutdown::StopSignal;
use super::{NodeError, node, params};
use crate::geometry::Pose2;
use crate::simulation::lidar::LidarKnobs;
use crate::simulation::racecar;
use crate::simulation::vehicle::VehicleKnobs;

const NAME: &str = "racecar_sim";

crate::knobs! {
    /// The car, its laser and its world. Parameters that `racecar_simulator` also has have the same names.
    pub struct RacecarSimKnobs {
        /// `corridor`, `room`, or the YAML file of a map.
        world: String = "corridor".into();
        /// Start pose of the car, `[x, y, yaw]`; unset: on a loop through the world, or at the origin if there is no loop.
        initial_pose: Option<Pose2> = None, unit "m, m, rad";
        /// Whether the car drives a loop by itself until the first command arrives.
        autopilot: bool = false;
        /// Poses and transforms per second.
        rate: f64 = 1000.0, in 1 to 2000, unit "Hz";
        /// Scans per second.
        scan_rate: f64 = 1000.0, in 0.1 to 1000, unit "Hz";
        /// Rays of a scan; the first and the last both point backwards.
        scan_beams: u32 = 1080, in 10 to 10000;
        /// Standard deviation of the range noise.
        scan_std_dev: f64 = 0.01, in 0 to 1, unit "m";
        /// Distance of the laser ahead of the rear axle.
        scan_distance_to_base_link: f64 = 0.275, in -10 to 10, unit "m";
        /// Distance between the axles.
        wheelbase: f64 = racecar::WHEELBASE, in 0.05 to 5, unit "m";
        /// Top speed.
        max_speed: f64 = 7.0, in 0.1 to 20, unit "m/s";
        /// Acceleration and braking.
        max_accel: f64 = racecar::MAX_ACCELERATION, in 0.1 to 20, unit "m/s^2";
        /// Maximum steering angle.
        max_steering_angle: f64 = racecar::MAX_STEERING, in 0.05 to 1.4, unit "rad";
        /// Maximum rate of change of the steering angle.
        max_steering_vel: f64 = racecar::STEERING_RATE, in 0.1 to 20, unit "rad/s";
        /// Top speed of the autopilot.
        autopilot_speed: f64 = 2.0, in 0.1 to 20, unit "m/s";
        /// Seed of the noise and, in a map, of the choice of the loop.
        seed: u32 = 1;
    }
}

/// Maximum range of the laser, m.
const RANGE_MAX: f64 = 100.0;

impl RacecarSimKnobs {
    fn lidar(&self) -> LidarKnobs {
        LidarKnobs {
            beams: self.scan_beams,
            field_of_view: 360.0,
            overlap: true,
            rate: self.scan_rate,
            range_min: 0.0,
            range_max: RANGE_MAX,
            noise: self.scan_std_dev,
            range_resolution: 0.0,
            laser_in_base: Pose2::new(self.scan_distance_to_base_link, 0.0, 0.0),
            ..LidarKnobs::default()
        }
    }

    fn vehicle(&self) -> VehicleKnobs {
        VehicleKnobs {
            speed: self.max_speed,
            acceleration: self.max_accel,
            wheelbase: self.wheelbase,
            max_steering: self.max_steering_angle,
            steering_rate: self.max_steering_vel,
            ..VehicleKnobs::default()
        }
    }

    /// The limits that the autopilot keeps to.
    fn autopilot(&self) -> VehicleKnobs {
        let car = VehicleKnobs::default();
        VehicleKnobs {
            speed: self.autopilot_speed.min(self.max_speed),
            acceleration: car.acceleration.min(self.max_accel),
            ..car
        }
    }
}

/// Runs the node `racecar_sim` until SIGINT, SIGTERM or the master ends it. The process arguments are those of ROS: remappings
/// and private parameters.
pub fn run() -> Result<(), NodeError> {
    node::run(NAME, serve)
}

fn serve(ros: &Ros, master: &Master, stop: &StopSignal) -> Result<(), NodeError> {
    let knobs: RacecarSimKnobs = params::read_group(master, ros.name())?;
    let environment = Environment::new(&knobs)?;
    let (vehicle, lidar) = (knobs.vehicle(), knobs.lidar());
    simulator::build(ros, master, &knobs, (&environment, &vehicle, &lidar))?.run(stop, || ())
}
