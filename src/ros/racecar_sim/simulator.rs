//! The simulated car on the ROS graph.

use std::sync::Arc;
use std::sync::mpsc::{Receiver, channel};
use std::time::Duration;

use rand_pcg::Pcg64;
use rosrust::api::{Master, Ros};

use super::ground::Ground;
use super::{RacecarSimKnobs, face};
use crate::anytime::clock::{Clock, MonotonicClock};
use crate::anytime::timer::Timer;
use crate::app::planar_pose;
use crate::geometry::Pose2;
use crate::messages::Message as _;
use crate::messages::ackermann_msgs::AckermannDriveStamped;
use crate::messages::geometry_msgs::{Pose, PoseStamped, PoseWithCovarianceStamped, Twist};
use crate::messages::nav_msgs::Odometry;
use crate::messages::sensor_msgs::LaserScan;
use crate::messages::tf2_msgs::TFMessage;
use crate::ros::NodeError;
use crate::ros::log::Log;
use crate::ros::master::{MasterLink, MasterRegistration};
use crate::ros::output::Output;
use crate::ros::reader::Reader;
use crate::ros::shutdown::StopSignal;
use crate::ros::sink::{RawMessage, Topic};
use crate::ros::subscriptions::Subscriptions;
use crate::simulation::car::Car;
use crate::simulation::driver::Driver;
use crate::simulation::lidar::{Lidar, LidarKnobs};
use crate::simulation::vehicle::{Command, VehicleKnobs};
use crate::simulation::world::World;
use crate::time::Stamp;

/// What comes late by no more than this is made up for, and ROS's time is not looked at more closely.
const LONGEST_LAG: Duration = Duration::from_millis(20);
/// A machine that was asleep does not make the car drive on blindly for longer than this.
const LONGEST_STEP: Duration = Duration::from_millis(100);
/// From one look at the master to the next.
const MASTER_CHECKS: Duration = Duration::from_secs(1);
/// Slower than this a car that is told a yaw rate cannot turn, m/s.
const LEAST_TURNING_SPEED: f64 = 1e-3;

/// Its inputs.
#[derive(Clone, Copy, Debug)]
enum Input {
    Drive,
    Velocity,
    Pose,
    InitialPose,
}

impl Input {
    const ALL: [Self; 4] = [Self::Drive, Self::Velocity, Self::Pose, Self::InitialPose];

    fn topic(self) -> Topic {
        match self {
            Self::Drive => Topic::of::<AckermannDriveStamped>("drive"),
            Self::Velocity => Topic::of::<Twist>("cmd_vel"),
            Self::Pose => Topic::of::<PoseStamped>("pose"),
            Self::InitialPose => Topic::of::<PoseWithCovarianceStamped>("initialpose"),
        }
    }
}

/// Its outputs.
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

    fn registrations(&self) -> [MasterRegistration; 4] {
        [self.scan.registration(), self.odometry.registration(), self.truth.registration(), self.transforms.registration()]
    }
}

pub(super) struct Simulator<'a> {
    ros: &'a Ros,
    clock: Arc<dyn Clock>,
    /// ROS's time when the clock read zero.
    zero: Stamp,
    master: MasterLink<'a>,
    received: Receiver<(Input, RawMessage)>,
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
    /// Numbers of the last pose and scan, for the headers.
    numbers: (u32, u32),
    reader: Reader,
    // Dropping it ends the subscriptions.
    _subscriptions: Subscriptions<'a>,
}

impl<'a> Simulator<'a> {
    pub(super) fn start(
        ros: &'a Ros,
        master: &'a Master,
        knobs: &RacecarSimKnobs,
        (ground, vehicle, lidar): (&'a Ground, &'a VehicleKnobs, &'a LidarKnobs),
    ) -> Result<Self, NodeError> {
        let log = Log::new(ros)?;
        let clock: Arc<dyn Clock> = Arc::new(MonotonicClock::default());
        let publishers = Publishers::new(ros)?;
        let (sender, received) = channel();
        let subscriptions = Subscriptions::new(ros, &clock, &log)?;
        for input in Input::ALL {
            let sender = sender.clone();
            // Nobody listens any more when the node is ending.
            subscriptions.listen(input.topic(), move |raw| drop(sender.send((input, raw))))?;
        }
        let mut registrations: Vec<MasterRegistration> = Input::ALL.map(|input| input.topic().registration()).into();
        registrations.extend(publishers.registrations());
        registrations.push(MasterRegistration::ROSOUT);
        let master = MasterLink::new(ros, master, registrations, &log)?;
        let RacecarSimKnobs { world, rate, scan_rate, wheelbase, seed, .. } = knobs;
        log.info(&format!("simulates a racecar in {world}: poses at {rate} Hz, scans at {scan_rate} Hz"));
        let (now, reader) = (clock.now(), Reader::new(&clock, &log));
        let period = |rate: f64| Duration::from_secs_f64(rate.recip());
        Ok(Self {
            ros,
            clock,
            zero: Stamp::default(),
            master,
            received,
            publishers,
            world: ground.world.as_ref(),
            car: Car::new(ground.world.as_ref(), vehicle, ground.start()),
            lidar: Lidar::new(lidar, Pcg64::new((*seed).into(), 1)),
            base_from_laser: lidar.laser_in_base,
            wheelbase: *wheelbase,
            driver: ground.driver(knobs),
            command: Command::default(),
            poses: Timer::new(period(*rate), now),
            scans: Timer::new(period(*scan_rate), now),
            numbers: (0, 0),
            reader,
            _subscriptions: subscriptions,
        })
    }

    /// Runs until it is told to stop.
    pub(super) fn run(mut self, stop: &StopSignal) {
        let mut time = self.clock.now();
        let mut looks = Timer::new(MASTER_CHECKS, time);
        while !stop.wait(Duration::ZERO) && self.ros.is_ok() {
            let now = self.clock.now();
            self.catch_up(time, now);
            time = now;
            if looks.is_due(now) {
                self.master.check();
            }
            // The car drives on, however rarely something is published.
            let rest = self.rest(self.clock.now()).min(LONGEST_LAG / 2);
            if let Ok((input, raw)) = self.received.recv_timeout(rest) {
                self.handle(input, &raw);
            }
        }
    }

    /// From one moment at which something is due to the next, until now: the scheduler's delays leave no gaps in what is published.
    fn catch_up(&mut self, mut time: Duration, now: Duration) {
        self.look_at_ros_time(now);
        let lag = now.saturating_sub(time);
        if let Some(lost) = lag.checked_sub(LONGEST_LAG) {
            self.drive_on(lost.min(LONGEST_STEP));
            time += lost;
        }
        while time < now {
            let step = self.rest(time).min(now.saturating_sub(time));
            self.drive_on(step);
            time += step;
            self.publish(time);
        }
    }

    /// Somebody may have set its clock. Small differences are delays between two readings, and would turn stamps back.
    fn look_at_ros_time(&mut self, now: Duration) {
        let time = self.ros.now();
        let zero = Stamp::from_ros(time.sec, time.nsec).offset_by(-now.as_secs_f64());
        if zero.seconds_since(self.zero).abs() > LONGEST_LAG.as_secs_f64() {
            self.zero = zero;
        }
    }

    /// Time until something is due.
    fn rest(&self, time: Duration) -> Duration {
        self.poses.left(time).min(self.scans.left(time))
    }

    fn drive_on(&mut self, span: Duration) {
        if let Some(driver) = &mut self.driver {
            self.command = driver.command(&self.car.map_from_base(), self.car.twist().vx);
        }
        self.car.step(self.command, span.as_secs_f64());
    }

    /// What is due at a time, all of it with the same stamp.
    fn publish(&mut self, time: Duration) {
        let stamp = self.zero.offset_by(time.as_secs_f64());
        let (pose, twist) = (self.car.map_from_base(), self.car.twist());
        if self.poses.is_due(time) {
            self.numbers.0 = self.numbers.0.wrapping_add(1);
            let number = self.numbers.0;
            self.publishers.truth.send(|| face::ground_truth(number, pose));
            self.publishers.odometry.send(|| face::odometry(number, stamp, pose, twist));
            self.publishers.transforms.send(|| face::transforms(number, stamp, pose, self.base_from_laser));
        }
        if self.scans.is_due(time) {
            self.numbers.1 = self.numbers.1.wrapping_add(1);
            let (number, world, lidar) = (self.numbers.1, self.world, &mut self.lidar);
            self.publishers.scan.send(|| face::scan(number, lidar.scan(|_| world, |_| pose, stamp)));
        }
    }

    fn handle(&mut self, input: Input, raw: &RawMessage) {
        match input {
            Input::Drive => {
                if let Some(message) = self.reader.read::<AckermannDriveStamped>(AckermannDriveStamped::TYPE, raw) {
                    let curvature = f64::from(message.drive.steering_angle).tan() / self.wheelbase;
                    self.obey(Command { speed: message.drive.speed.into(), curvature });
                }
            }
            Input::Velocity => {
                if let Some(Twist { linear, angular }) = self.reader.read(Twist::TYPE, raw) {
                    let speed = linear.x;
                    let curvature = if speed.abs() < LEAST_TURNING_SPEED { 0.0 } else { angular.z / speed };
                    self.obey(Command { speed, curvature });
                }
            }
            Input::Pose => {
                if let Some(message) = self.reader.read::<PoseStamped>(PoseStamped::TYPE, raw) {
                    self.teleport(&message.pose);
                }
            }
            Input::InitialPose => {
                if let Some(message) = self.reader.read::<PoseWithCovarianceStamped>(PoseWithCovarianceStamped::TYPE, raw) {
                    self.teleport(&message.pose.pose);
                }
            }
        }
    }

    /// Who gives a command takes the wheel.
    fn obey(&mut self, command: Command) {
        if !(command.speed.is_finite() && command.curvature.is_finite()) {
            return self.reader.warn("drive", "the command has numbers that are not finite");
        }
        self.driver = None;
        self.command = command;
    }

    fn teleport(&mut self, pose: &Pose) {
        match planar_pose(pose) {
            Ok(map_from_base) => {
                self.car.teleport(map_from_base);
                if let Some(driver) = &mut self.driver {
                    driver.find(map_from_base.translation());
                }
            }
            Err(error) => self.reader.warn("pose", &error.to_string()),
        }
    }
}
