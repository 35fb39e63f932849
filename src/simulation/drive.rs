//! A simulated drive as a sequence of recorded ROS messages.

use rand_pcg::Pcg64;

use crate::geometry::Pose2;
use crate::knobs;
use crate::knobs::Seconds;
use crate::messages::geometry_msgs::{PoseStamped, TransformStamped};
use crate::messages::nav_msgs::Odometry;
use crate::messages::sensor_msgs::LaserScan;
use crate::messages::std_msgs::Header;
use crate::messages::tf2_msgs::TFMessage;
use crate::time::Stamp;

use super::lidar::{LASER_FRAME, Lidar, LidarKnobs};
use super::motion::Motion;
use super::odometer::{BASE_FRAME, Odometer, OdometerKnobs};
use super::scene::Scene;
use super::traffic::{Traffic, TrafficKnobs};
use super::vehicle::VehicleKnobs;

/// Start time of every drive.
pub const START: Stamp = Stamp::from_nanoseconds(1_700_000_000_000_000_000);
/// Frame of the world.
pub const MAP_FRAME: &str = "map";
/// Time from the last ray of a scan to its arrival, ms: laser drivers take some milliseconds.
pub const SCAN_LATENCY_MS: u32 = 5;

knobs! {
    /// The simulated drive.
    pub struct DriveKnobs {
        /// Duration, including a first second at rest.
        duration: Seconds = Seconds(20.0), in 0.1 to 36000, unit "s";
        /// Seed of the noise and, in a map, of start and direction. Drives with the same seed are bitwise identical.
        seed: u32 = 1;
    }
}

/// All parameters of a simulation.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Settings {
    /// The drive.
    pub drive: DriveKnobs,
    /// The car.
    pub vehicle: VehicleKnobs,
    /// The laser scanner.
    pub lidar: LidarKnobs,
    /// The wheel odometry.
    pub odometer: OdometerKnobs,
    /// Moving people and other cars.
    pub traffic: TrafficKnobs,
}

/// A message of the simulated robot.
#[derive(Clone, Debug, PartialEq)]
#[allow(clippy::large_enum_variant)] // only one exists at a time
pub enum SimulatedMessage {
    /// Transform from `base_link` to the laser, once at the start; latched.
    Mount(TFMessage),
    /// Wheel odometry.
    Odometry(Odometry),
    /// True pose at the stamp of every scan. [`truth_message`] converts it to a message.
    Truth {
        /// Stamp of the scan.
        stamp: Stamp,
        /// True pose of `base_link`.
        map_from_base: Pose2,
    },
    /// Laser scan.
    Scan(LaserScan),
}

/// A scheduled message. The order of the variants is the recording order of messages with the same time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Due {
    Mount,
    Odometry(u32),
    Truth(u32),
    Scan(u32),
}

/// Simulates a drive through a scene. Calls `record` for each message with the time at which it would be recorded, in order of
/// these times. An error of `record` ends the drive.
pub fn simulate<E>(
    settings: &Settings,
    scene: &Scene,
    mut record: impl FnMut(Stamp, SimulatedMessage) -> Result<(), E>,
) -> Result<(), E> {
    let Settings { drive, vehicle, lidar, odometer, traffic } = settings;
    let random = |stream| Pcg64::new(drive.seed.into(), stream);
    let (scan_time, odometry_time) = (|k| f64::from(k) / lidar.rate, |k| f64::from(k) / odometer.rate);
    let mut lidar = Lidar::new(lidar, random(1));
    let motion = Motion::drive(&scene.route, vehicle, drive.duration.0 + lidar.sweep_time());
    let mut odometer = Odometer::new(odometer, motion.pose_at(0.0), random(2));
    let traffic = Traffic::new(traffic, &scene.route, scene.world.as_ref(), &motion, random(3));

    let scan_delay = lidar.sweep_time() + f64::from(SCAN_LATENCY_MS) * 1e-3;
    let mut schedule = vec![(START, Due::Mount)];
    schedule.extend(times_until(drive.duration, odometry_time).map(|(k, t)| (START.offset_by(t), Due::Odometry(k))));
    schedule.extend(times_until(drive.duration, scan_time).map(|(k, t)| (START.offset_by(t), Due::Truth(k))));
    schedule.extend(times_until(drive.duration, scan_time).map(|(k, t)| (START.offset_by(t + scan_delay), Due::Scan(k))));
    schedule.sort_unstable();

    for (time, due) in schedule {
        let message = match due {
            Due::Mount => SimulatedMessage::Mount(mount_message(START, settings.lidar.laser_in_base)),
            Due::Odometry(k) => SimulatedMessage::Odometry(odometer.read(motion.pose_at(odometry_time(k)), time)),
            Due::Truth(k) => SimulatedMessage::Truth { stamp: time, map_from_base: motion.pose_at(scan_time(k)) },
            Due::Scan(k) => {
                let world = |after| traffic.at(scene.world.as_ref(), scan_time(k) + after);
                let map_from_base = |after| motion.pose_at(scan_time(k) + after);
                SimulatedMessage::Scan(lidar.scan(world, map_from_base, START.offset_by(scan_time(k))))
            }
        };
        record(time, message)?;
    }
    Ok(())
}

/// Indices with their times, as long as the time is less than `duration`.
fn times_until(duration: Seconds, time: impl Fn(u32) -> f64) -> impl Iterator<Item = (u32, f64)> {
    (0..).map(move |k| (k, time(k))).take_while(move |(_, time)| *time < duration.0)
}

/// The static transform from `base_link` to the laser as a message.
pub fn mount_message(stamp: Stamp, laser_in_base: Pose2) -> TFMessage {
    let header = Header { stamp: stamp.into(), frame_id: BASE_FRAME.into(), ..Header::default() };
    let transform = laser_in_base.into();
    TFMessage { transforms: vec![TransformStamped { header, child_frame_id: LASER_FRAME.into(), transform }] }
}

/// A true pose as a message.
pub fn truth_message(stamp: Stamp, map_from_base: Pose2) -> PoseStamped {
    let header = Header { stamp: stamp.into(), frame_id: MAP_FRAME.into(), ..Header::default() };
    PoseStamped { header, pose: map_from_base.into() }
}
