//! The simulated car on the ROS graph.

use std::time::Duration;

use rand_pcg::Pcg64;
use rosrust::api::{Master, Ros};

use super::environment::Environment;
use super::{RacecarSimKnobs, convert};
use crate::anytime::timer::Timer;
use crate::app::{InputError, planar_pose};
use crate::geometry::Pose2;
use crate::messages::ackermann_msgs::AckermannDriveStamped;
use crate::messages::geometry_msgs::{Pose, PoseStamped, PoseWithCovarianceStamped, Twist};
use crate::messages::nav_msgs::Odometry;
use crate::messages::sensor_msgs::LaserScan;
use crate::messages::tf2_msgs::TFMessage;
use crate::ros::NodeError;
use crate::ros::context::Context;
use crate::ros::input::Input;
use crate::ros::node::{Node, NodeParts};
use crate::ros::output::Output;
use crate::ros::worker::Algorithm;
use crate::simulation::car::Car;
use crate::simulation::driver::Driver;
use crate::simulation::lidar::{Lidar, LidarKnobs};
use crate::simulation::vehicle::{Command, VehicleKnobs};
use crate::simulation::world::World;
use crate::time::Stamp;

/// Maximum delay for which skipped messages are still published, and maximum difference of ROS time that is ignored.
const MAX_LAG: Duration = Duration::from_millis(20);
/// Maximum time simulated without publishing, after the machine was suspended for example.
const MAX_STEP: Duration = Duration::from_millis(100);
/// Maximum delay of published messages.
const TICK: Duration = Duration::from_millis(1);
/// Minimum speed for which a commanded yaw rate has an effect, m/s.
const MIN_TURNING_SPEED: f64 = 1e-3;

/// The publishers of the node.
struct Publishers {
    scan: Output<LaserScan>,
    odometry: Output<Odometry>,
    truth: Output<PoseStamped>,
    transforms: Output<TFMessage>,
}

impl Publishers {
    fn new(ros: &Ros) -> Result<Self, NodeError> {
        Ok(Self {
            scan: Output::new(ros, "scan")?,
            odometry: Output::new(ros, "odom")?,
            truth: Output::new(ros, "gt_pose")?,
            transforms: Output::new(ros, "/tf")?,
        })
    }
}

/// The car, and the world it drives in.
pub(super) struct Simulator<'a> {
    ros: &'a Ros,
    /// ROS time at zero of the node's clock.
    zero: Stamp,
    /// Time on the node's clock up to which the car has been simulated.
    time: Duration,
    publishers: Publishers,
    world: &'a dyn World,
    car: Car<'a>,
    lidar: Lidar<'a>,
    base_from_laser: Pose2,
    wheelbase: f64,
    driver: Option<Driver<'a>>,
    command: Command,
    poses: Timer,
    scans: Timer,
    /// Sequence numbers of the last pose and the last scan.
    numbers: (u32, u32),
}

/// Builds the node.
pub(super) fn build<'a>(
    ros: &'a Ros,
    master: &'a Master,
    knobs: &RacecarSimKnobs,
    (environment, vehicle, lidar): (&'a Environment, &'a VehicleKnobs, &'a LidarKnobs),
) -> Result<Node<'a>, NodeError> {
    let parts = NodeParts::new(ros, master)?;
    let (publishers, now) = (Publishers::new(ros)?, parts.shared.clock.now());
    let RacecarSimKnobs { world, rate, scan_rate, wheelbase, seed, .. } = knobs;
    parts.shared.log.info(&format!("simulating a racecar in {world}: poses at {rate} Hz, scans at {scan_rate} Hz"));
    let period = |rate: f64| Duration::from_secs_f64(rate.recip());
    let simulator = Simulator {
        ros,
        zero: Stamp::default(),
        time: now,
        publishers,
        world: environment.world.as_ref(),
        car: Car::new(environment.world.as_ref(), vehicle, environment.start()),
        lidar: Lidar::new(lidar, Pcg64::new((*seed).into(), 1)),
        base_from_laser: lidar.laser_in_base,
        wheelbase: *wheelbase,
        driver: environment.driver(knobs),
        command: Command::default(),
        poses: Timer::new(period(*rate), now),
        scans: Timer::new(period(*scan_rate), now),
        numbers: (0, 0),
    };
    parts.build("simulating", simulator, Simulator::inputs(), Some(Timer::new(TICK, now)))
}

impl Simulator<'_> {
    /// The topics it subscribes to. The simulation catches up before a message takes effect.
    fn inputs() -> Vec<Input<Self>> {
        vec![
            Input::with_context("drive", |simulator: &mut Self, message: &AckermannDriveStamped, _, context| {
                simulator.catch_up(context.shared.clock.now());
                let curvature = f64::from(message.drive.steering_angle).tan() / simulator.wheelbase;
                simulator.apply(Command { speed: message.drive.speed.into(), curvature })
            }),
            Input::with_context("cmd_vel", |simulator: &mut Self, Twist { linear, angular }: &Twist, _, context| {
                simulator.catch_up(context.shared.clock.now());
                let speed = linear.x;
                let curvature = if speed.abs() < MIN_TURNING_SPEED { 0.0 } else { angular.z / speed };
                simulator.apply(Command { speed, curvature })
            }),
            Input::with_context("pose", |simulator: &mut Self, message: &PoseStamped, _, context| {
                simulator.catch_up(context.shared.clock.now());
                simulator.teleport(&message.pose)
            }),
            Input::with_context("initialpose", |simulator: &mut Self, message: &PoseWithCovarianceStamped, _, context| {
                simulator.catch_up(context.shared.clock.now());
                simulator.teleport(&message.pose.pose)
            }),
        ]
    }

    /// Simulates and publishes up to now, from one due time to the next, so that delays of the scheduler leave no gaps.
    fn catch_up(&mut self, now: Duration) {
        self.sync_ros_time(now);
        let mut time = std::mem::replace(&mut self.time, now);
        let lag = now.saturating_sub(time);
        if let Some(lost) = lag.checked_sub(MAX_LAG) {
            self.step_car(lost.min(MAX_STEP));
            time += lost;
        }
        while time < now {
            let step = self.time_until_due(time).min(now.saturating_sub(time));
            self.step_car(step);
            time += step;
            self.publish(time);
        }
    }

    /// Follows jumps of ROS time. Small differences are delays between reading the two clocks; following them could make stamps
    /// go back.
    fn sync_ros_time(&mut self, now: Duration) {
        let time = self.ros.now();
        let zero = Stamp::from_ros(time.sec, time.nsec).offset_by(-now.as_secs_f64());
        if zero.seconds_since(self.zero).abs() > MAX_LAG.as_secs_f64() {
            self.zero = zero;
        }
    }

    /// Time until the next message is due.
    fn time_until_due(&self, time: Duration) -> Duration {
        self.poses.left(time).min(self.scans.left(time))
    }

    fn step_car(&mut self, span: Duration) {
        if let Some(driver) = &mut self.driver {
            self.command = driver.command(&self.car.map_from_base(), self.car.twist().vx);
        }
        self.car.step(self.command, span.as_secs_f64());
    }

    /// Publishes all messages that are due, with the same stamp.
    fn publish(&mut self, time: Duration) {
        let stamp = self.zero.offset_by(time.as_secs_f64());
        let (pose, twist) = (self.car.map_from_base(), self.car.twist());
        if self.poses.is_due(time) {
            self.numbers.0 = self.numbers.0.wrapping_add(1);
            let number = self.numbers.0;
            self.publishers.truth.send(|| convert::ground_truth(number, pose));
            self.publishers.odometry.send(|| convert::odometry(number, stamp, pose, twist));
            self.publishers.transforms.send(|| convert::transforms(number, stamp, pose, self.base_from_laser));
        }
        if self.scans.is_due(time) {
            self.numbers.1 = self.numbers.1.wrapping_add(1);
            let (number, world, lidar) = (self.numbers.1, self.world, &mut self.lidar);
            self.publishers.scan.send(|| convert::scan(number, lidar.scan(|_| world, |_| pose, stamp)));
        }
    }

    /// Applies a command and switches the autopilot off.
    fn apply(&mut self, command: Command) -> Result<(), &'static str> {
        if !(command.speed.is_finite() && command.curvature.is_finite()) {
            return Err("the command is not finite");
        }
        self.driver = None;
        self.command = command;
        Ok(())
    }

    fn teleport(&mut self, pose: &Pose) -> Result<(), InputError> {
        let map_from_base = planar_pose(pose)?;
        self.car.teleport(map_from_base);
        if let Some(driver) = &mut self.driver {
            driver.find(map_from_base.translation());
        }
        Ok(())
    }
}

impl Algorithm for Simulator<'_> {
    fn on_timer(&mut self, context: &mut Context) {
        self.catch_up(context.shared.clock.now());
    }
}
