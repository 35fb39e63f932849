//! A stand-in for F1TENTH's `racecar_simulator`: the same topics, frames, rates and oddities, so that whatever runs beside the one
//! runs beside the other.
//!
//! ```text
//!  drive, cmd_vel ---> car ---> odom, gt_pose, /tf, scan (by the lidar)
//!  pose, initialpose ---^  teleports
//! ```
//!
//! The oddities are in `convert`. Its sideslip and the wheels' transforms are left out.

mod convert;
mod ground;
mod simulator;

use rosrust::api::{Master, Ros};

use self::ground::Ground;
use super::shutdown::StopSignal;
use super::{NodeError, node, params};
use crate::geometry::Pose2;
use crate::simulation::lidar::LidarKnobs;
use crate::simulation::racecar;
use crate::simulation::vehicle::VehicleKnobs;

const NAME: &str = "racecar_sim";

crate::knobs! {
    /// The car, its laser and its world. Where `racecar_simulator` has the parameter too, it has the same name.
    pub struct RacecarSimKnobs {
        /// `corridor`, `room`, or the YAML file of a map.
        world: String = "corridor".into();
        /// Where the car is at the start, `[x, y, yaw]`; unset: on a way round the world, or, where there is none, at the origin.
        initial_pose: Option<Pose2> = None, unit "m, m, rad";
        /// Whether the car drives round by itself, until somebody else takes the wheel.
        autopilot: bool = false;
        /// Poses and transforms per second.
        rate: f64 = 1000.0, in 1 to 2000, unit "Hz";
        /// Scans per second.
        scan_rate: f64 = 1000.0, in 0.1 to 1000, unit "Hz";
        /// Rays of a scan; the first and the last look the same way, backwards.
        scan_beams: u32 = 1080, in 10 to 10000;
        /// Standard deviation of the ranges.
        scan_std_dev: f64 = 0.01, in 0 to 1, unit "m";
        /// The laser is this far ahead of the rear axle.
        scan_distance_to_base_link: f64 = 0.275, in -10 to 10, unit "m";
        /// Distance between the axles.
        wheelbase: f64 = racecar::WHEELBASE, in 0.05 to 5, unit "m";
        /// Top speed.
        max_speed: f64 = 7.0, in 0.1 to 20, unit "m/s";
        /// Acceleration and braking.
        max_accel: f64 = racecar::MAX_ACCELERATION, in 0.1 to 20, unit "m/s^2";
        /// Greatest steering angle.
        max_steering_angle: f64 = racecar::MAX_STEERING, in 0.05 to 1.4, unit "rad";
        /// Greatest change of the steering angle.
        max_steering_vel: f64 = racecar::STEERING_RATE, in 0.1 to 20, unit "rad/s";
        /// Top speed of the car that drives by itself.
        autopilot_speed: f64 = 2.0, in 0.1 to 20, unit "m/s";
        /// Another seed: other noise and, in a map, another way round.
        seed: u32 = 1;
    }
}

/// Farthest distance measured, m.
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

    /// The same car, as the one who drives it by itself sees it.
    fn autopilot(&self) -> VehicleKnobs {
        let car = VehicleKnobs::default();
        VehicleKnobs {
            speed: self.autopilot_speed.min(self.max_speed),
            acceleration: car.acceleration.min(self.max_accel),
            ..car
        }
    }
}

/// Runs the node `racecar_sim` until SIGINT, SIGTERM or the master ends it. The arguments of the process are ROS's: remappings and
/// parameters.
pub fn run() -> Result<(), NodeError> {
    node::run(NAME, serve)
}

fn serve(ros: &Ros, master: &Master, stop: &StopSignal) -> Result<(), NodeError> {
    let knobs: RacecarSimKnobs = params::read_group(master, ros.name())?;
    let ground = Ground::new(&knobs)?;
    let (vehicle, lidar) = (knobs.vehicle(), knobs.lidar());
    simulator::build(ros, master, &knobs, (&ground, &vehicle, &lidar))?.run(stop, || ())
}
