//! A simulated drive, as the messages a robot would have recorded.

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

/// When every drive begins.
pub const START: Stamp = Stamp::from_nanoseconds(1_700_000_000_000_000_000);
/// The frame of the world.
pub const MAP_FRAME: &str = "map";
/// Time from the last ray of a scan to its arrival, s: drivers take some milliseconds.
const SCAN_LATENCY: f64 = 0.005;

knobs! {
    /// The simulated drive.
    pub struct DriveKnobs {
        /// How long it takes, the first second of it at rest.
        duration: Seconds = Seconds(20.0), in 0.1 to 36000, unit "s";
        /// Another seed: other noise and, in a map, another start. The same seed: the same drive, bit for bit.
        seed: u32 = 1;
    }
}

/// Everything there is to set of a simulation.
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
    /// Who else is there.
    pub traffic: TrafficKnobs,
}

/// A message of the simulated robot.
#[derive(Clone, Debug, PartialEq)]
#[allow(clippy::large_enum_variant)] // one at a time, handed on at once
pub enum SimulatedMessage {
    /// Where the laser sits, once at the start; latched.
    Mount(TFMessage),
    /// What the wheels say.
    Odometry(Odometry),
    /// Where the car is: at the stamp of every scan. [`truth_message`] is its wire form.
    Truth {
        /// Stamp of the scan.
        stamp: Stamp,
        /// Where `base_link` is.
        map_from_base: Pose2,
    },
    /// What the laser sees.
    Scan(LaserScan),
}

/// A moment at which a message is due. The order of the variants is that of messages recorded at the same time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Due {
    Mount,
    Odometry(u32),
    Truth(u32),
    Scan(u32),
}

/// Drives through a scene and hands each message to `record` with the time at which it would be recorded, in the order of these
/// times. An error of `record` ends the drive.
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

    let scan_delay = lidar.sweep_time() + SCAN_LATENCY;
    let mut agenda = vec![(START, Due::Mount)];
    agenda.extend(times_until(drive.duration, odometry_time).map(|(k, t)| (START.offset_by(t), Due::Odometry(k))));
    agenda.extend(times_until(drive.duration, scan_time).map(|(k, t)| (START.offset_by(t), Due::Truth(k))));
    agenda.extend(times_until(drive.duration, scan_time).map(|(k, t)| (START.offset_by(t + scan_delay), Due::Scan(k))));
    agenda.sort_unstable();

    for (time, due) in agenda {
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

/// Counts up, as long as the time of the count is within `duration`.
fn times_until(duration: Seconds, time: impl Fn(u32) -> f64) -> impl Iterator<Item = (u32, f64)> {
    (0..).map(move |k| (k, time(k))).take_while(move |(_, time)| *time < duration.0)
}

/// Where the laser sits as a message.
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
