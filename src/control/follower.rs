//! Follows a path by poses that come late: what the node and the closed loop have in common.

use std::time::Duration;

use super::delay::{CommandHistory, Motion};
use super::laws::{Law, View};
use super::path::{Path, PathError, Projection, Waypoint};
use super::progress::{Arrival, Progress};
use super::safety::{Footprint, StopReason};
use super::speed::{SpeedLimits, SpeedProfile};
use super::trim::Trim;
use crate::geometry::{Point, Pose2};
use crate::knobs;
use crate::knobs::Seconds;
use crate::simulation::racecar;
use crate::simulation::vehicle::{Command, VehicleKnobs};
use crate::time::Stamp;

knobs! {
    /// How a path is followed, and by what car.
    pub struct FollowerKnobs {
        /// How the car is steered.
        law: Law = Law::Stanley;
        /// Top speed; a path with speeds may ask for less, and curves do.
        speed: f64 = 2.0, in 0.1 to 20, unit "m/s";
        /// Lateral acceleration in curves, which limits the speed there.
        lateral_acceleration: f64 = 4.0, in 0.1 to 20, unit "m/s^2";
        /// Acceleration and braking along the path.
        acceleration: f64 = 3.0, in 0.1 to 20, unit "m/s^2";
        /// Braking when something is wrong.
        braking: f64 = 6.0, in 0.1 to 20, unit "m/s^2";
        /// The look-ahead grows by this much with each m/s.
        lookahead_time: Seconds = Seconds(0.25), in 0 to 5, unit "s";
        /// The look-ahead at rest.
        lookahead_distance: f64 = 0.3, in 0.05 to 10, unit "m";
        /// The least look-ahead.
        min_lookahead: f64 = 0.6, in 0.05 to 10, unit "m";
        /// The greatest look-ahead.
        max_lookahead: f64 = 4.0, in 0.1 to 50, unit "m";
        /// Whether poses are carried from their stamps to the moment at which the command acts.
        compensate_delay: bool = true;
        /// Time from a command to its effect on wheels and motor.
        actuation_delay: Seconds = Seconds(0.0), in 0 to 1, unit "s";
        /// The car brakes when the pose is older than this.
        max_pose_age: Seconds = Seconds(0.5), in 0.01 to 10, unit "s";
        /// The car brakes when scans have come and the last is older than this; 0: it drives on.
        max_scan_age: Seconds = Seconds(1.0), in 0 to 10, unit "s";
        /// The car brakes when the standard deviation of the position is greater than this; 0: whatever it is.
        max_position_error: f64 = 0.5, in 0 to 100, unit "m";
        /// The car brakes when the path is farther away than this.
        max_path_distance: f64 = 1.0, in 0.05 to 100, unit "m";
        /// The car brakes, and stays, when by the scan it would hit something sooner than this; 0: never.
        min_time_to_collision: Seconds = Seconds(0.25), in 0 to 5, unit "s";
        /// Distance between the axles.
        wheelbase: f64 = racecar::WHEELBASE, in 0.05 to 5, unit "m";
        /// From the rear axle to the front bumper.
        front: f64 = 0.45, in 0.05 to 10, unit "m";
        /// Width of the car.
        width: f64 = 0.3, in 0.05 to 5, unit "m";
        /// Greatest steering angle.
        max_steering: f64 = racecar::MAX_STEERING, in 0.05 to 1.4, unit "rad";
        /// Greatest change of the steering angle.
        steering_rate: f64 = racecar::STEERING_RATE, in 0.1 to 20, unit "rad/s";
        /// Greatest acceleration of the car, commanded or not.
        max_acceleration: f64 = racecar::MAX_ACCELERATION, in 0.1 to 50, unit "m/s^2";
    }
}

/// The car is at the end of the path when it is no farther away than this, m.
const AT_END: f64 = 0.05;
/// Up to there it goes on at this speed at least, m/s: braking to the point would take for ever.
const CREEP: f64 = 0.2;
/// Slower than this a car stands, m/s.
const STANDING: f64 = 0.05;
/// Slower than this a car turns by too little for its steering to show, m/s.
const ROLLING: f64 = 0.5;
/// A clock that goes back, or on by more than this between two commands, has jumped, s.
const JUMP: f64 = 2.0;
/// Commands follow each other in no more than this, s; one that comes later is not made up for.
const LONGEST_PERIOD: f64 = 0.1;
/// A pose of the future by less than this is one of clocks that agree, s.
const AHEAD: f64 = 0.1;

impl FollowerKnobs {
    /// The car.
    pub fn car(&self) -> VehicleKnobs {
        VehicleKnobs {
            speed: self.speed,
            acceleration: self.max_acceleration,
            wheelbase: self.wheelbase,
            max_steering: self.max_steering,
            steering_rate: self.steering_rate,
            ..VehicleKnobs::default()
        }
    }

    /// The distance ahead to look at a speed, m.
    pub fn lookahead(&self, speed: f64) -> f64 {
        let wanted = self.lookahead_time.0 * speed.abs() + self.lookahead_distance;
        wanted.max(self.min_lookahead).min(self.max_lookahead)
    }

    fn limits(&self) -> SpeedLimits {
        SpeedLimits { top: self.speed, lateral_acceleration: self.lateral_acceleration, braking: self.acceleration }
    }
}

/// A pose as an estimator gives it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseReading {
    /// When the car was there.
    pub stamp: Stamp,
    /// In the frame of the path.
    pub pose: Pose2,
    /// Forward speed, where it is known, m/s.
    pub speed: Option<f64>,
    /// Standard deviation of the position, m; 0: not told.
    pub deviation: f64,
}

/// A command and how it came about.
#[derive(Clone, Copy, Debug)]
pub struct Step {
    /// What the car is to do.
    pub command: Command,
    /// Steering angle of that, rad.
    pub steering: f64,
    /// Why the car brakes or stands; `None`: it drives.
    pub stop: Option<StopReason>,
    /// Where it is on the path when the command acts.
    pub place: Option<Projection>,
    /// Where it is then, if that is known.
    pub pose: Option<Pose2>,
    /// The distance ahead that is looked at, m.
    pub lookahead: f64,
    /// Age of the pose when the command acts, s.
    pub pose_age: Option<f64>,
    /// Age of the path, s.
    pub path_age: Option<f64>,
}

/// Someone at the wheel who reads paths and poses.
#[derive(Clone, Debug)]
pub struct Follower {
    knobs: FollowerKnobs,
    history: CommandHistory,
    trim: Trim,
    progress: Option<Progress>,
    profile: Option<SpeedProfile>,
    pose: Option<PoseReading>,
    scan: Option<(Stamp, Vec<Point>)>,
    last: Option<(Stamp, Command)>,
    /// Why the car stays where it is until it is told to go on.
    latched: Option<StopReason>,
    clock_jumped: bool,
}

impl Follower {
    /// Nothing is known yet.
    pub fn new(knobs: FollowerKnobs) -> Self {
        Self {
            history: CommandHistory::new(knobs.car()),
            trim: Trim::default(),
            knobs,
            progress: None,
            profile: None,
            pose: None,
            scan: None,
            last: None,
            latched: None,
            clock_jumped: false,
        }
    }

    /// How it follows.
    pub fn knobs(&self) -> &FollowerKnobs {
        &self.knobs
    }

    /// The path followed, and the progress on it.
    pub fn progress(&self) -> Option<&Progress> {
        self.progress.as_ref()
    }

    /// A path of points comes. One that is empty, or in one place, ends the drive: the car stops. One with numbers that are none is
    /// refused, and the one before stays.
    pub fn on_path(&mut self, waypoints: &[Waypoint], stamp: Stamp) -> Result<Arrival, PathError> {
        match Path::closed_if_loop(waypoints) {
            Ok(path) => Ok(self.take_path(path, stamp)),
            Err(problem @ PathError::NotFinite { .. }) => Err(problem),
            Err(problem) => {
                if self.progress.as_ref().is_none_or(|progress| stamp >= progress.stamp()) {
                    (self.progress, self.profile) = (None, None);
                }
                Err(problem)
            }
        }
    }

    /// A path comes.
    pub fn take_path(&mut self, path: Path, stamp: Stamp) -> Arrival {
        let arrival = match &mut self.progress {
            Some(progress) => progress.offer(path, stamp),
            none => {
                *none = Some(Progress::new(path, stamp));
                Arrival::Taken
            }
        };
        if arrival == Arrival::Taken {
            self.profile = self.progress.as_ref().map(|progress| SpeedProfile::new(progress.path(), &self.knobs.limits()));
        }
        arrival
    }

    /// A pose comes; one that is older than the last is of no use.
    pub fn on_pose(&mut self, reading: PoseReading) {
        if reading.pose.is_finite() && self.pose.is_none_or(|last| last.stamp <= reading.stamp) {
            if let Some(last) = self.pose.replace(reading) {
                self.learn_trim(&last, &reading);
            }
            self.clock_jumped = false;
        }
    }

    /// From one pose to the next the car was to turn as commanded; not if it rolls though it is told to stand: somebody else drives.
    fn learn_trim(&mut self, last: &PoseReading, next: &PoseReading) {
        if self.last.is_none_or(|(_, command)| command.speed < ROLLING) {
            return;
        }
        let carried = self.history.carry(last.pose, last.stamp, last.speed, next.stamp);
        let way = carried.speed * next.stamp.seconds_since(last.stamp);
        if carried.speed.abs() > ROLLING {
            self.trim.learn(carried.pose.between(&next.pose).theta, way, self.knobs.wheelbase);
        }
    }

    /// What the laser sees, from the rear axle.
    pub fn on_scan(&mut self, stamp: Stamp, points: Vec<Point>) {
        self.scan = Some((stamp, points));
    }

    /// Somebody says that the car may go on after it has stopped before an obstacle.
    pub fn resume(&mut self) {
        self.latched = None;
    }

    /// What to do now.
    pub fn command(&mut self, now: Stamp) -> Step {
        self.look_at_clock(now);
        let acts = now.offset_by(self.knobs.actuation_delay.0);
        let before = self.last.map_or(Command::default(), |(_, command)| command);
        let period = self.last.map_or(0.0, |(last, _)| now.seconds_since(last)).min(LONGEST_PERIOD);
        let motion = self.motion(acts);
        let speed = motion.map_or(before.speed, |motion| motion.speed);
        let place = self.look(motion, period);
        let lookahead = self.knobs.lookahead(speed);
        let curvature = self.steer(motion, place, lookahead).unwrap_or(before.curvature);
        let stop = self.stop_reason(now, place, speed, curvature);
        let wanted = match stop {
            None => self.speed(place, speed, period).min(before.speed.max(speed) + self.knobs.acceleration * period),
            Some(_) => (before.speed - self.knobs.braking * period).max(0.0),
        };
        let command = Command { speed: wanted, curvature };
        self.history.record(acts, command);
        self.last = Some((now, command));
        self.latched = stop.filter(StopReason::is_latched);
        // The history has what the car is to do: what it is told to that end is another matter.
        let straight = (self.knobs.wheelbase * curvature).atan();
        let steering = (straight - self.trim.angle()).clamp(-self.knobs.max_steering, self.knobs.max_steering);
        Step {
            command: Command { curvature: steering.tan() / self.knobs.wheelbase, ..command },
            steering,
            stop,
            place,
            pose: motion.map(|motion| motion.pose),
            lookahead,
            pose_age: self.pose.map(|pose| acts.seconds_since(pose.stamp)),
            path_age: self.progress.as_ref().map(|progress| now.seconds_since(progress.stamp())),
        }
    }

    /// After a jump nothing that was stamped before it is of use.
    fn look_at_clock(&mut self, now: Stamp) {
        let Some((last, _)) = self.last else { return };
        if (0.0..=JUMP).contains(&now.seconds_since(last)) {
            return;
        }
        self.history.clear();
        (self.pose, self.scan, self.clock_jumped) = (None, None, true);
        if let Some(progress) = &mut self.progress {
            progress.restamp(now);
        }
    }

    /// Where the car is at a time, as far as that is known.
    pub fn pose_at(&self, now: Stamp) -> Option<Pose2> {
        self.motion(now).map(|motion| motion.pose)
    }

    /// The car when the command acts.
    fn motion(&self, acts: Stamp) -> Option<Motion> {
        let PoseReading { stamp, pose, speed, .. } = self.pose?;
        let until = if self.knobs.compensate_delay { acts.max(stamp) } else { stamp };
        Some(self.history.carry(pose, stamp, speed, until))
    }

    fn look(&mut self, motion: Option<Motion>, period: f64) -> Option<Projection> {
        let (progress, motion) = (self.progress.as_mut()?, motion?);
        let place = progress.look(&motion.pose, motion.speed.abs() * period);
        let is_far = place.is_none_or(|place| place.distance > self.knobs.max_path_distance);
        if is_far && motion.speed.abs() < STANDING {
            // It has been put somewhere else, or its pose has been corrected.
            progress.forget();
            return progress.look(&motion.pose, 0.0);
        }
        place
    }

    fn steer(&self, motion: Option<Motion>, place: Option<Projection>, lookahead: f64) -> Option<f64> {
        let (motion, place, progress) = (motion?, place?, self.progress.as_ref()?);
        let path = progress.path();
        let view = View { path, place, pose: motion.pose, speed: motion.speed, lookahead, wheelbase: self.knobs.wheelbase };
        let most = self.knobs.max_steering.tan() / self.knobs.wheelbase;
        Some(self.knobs.law.curvature(&view))
            .filter(|curvature| curvature.is_finite())
            .map(|curvature| curvature.clamp(-most, most))
    }

    /// The speed that the path allows.
    fn speed(&self, place: Option<Projection>, speed: f64, period: f64) -> f64 {
        let (Some(place), Some(profile), Some(progress)) = (place, &self.profile, &self.progress) else { return 0.0 };
        let allowed = profile.at(place.along + speed.max(0.0) * period);
        if progress.path().remaining(place.along).is_finite() { allowed.max(CREEP) } else { allowed }
    }

    fn stop_reason(&self, now: Stamp, place: Option<Projection>, speed: f64, curvature: f64) -> Option<StopReason> {
        let knobs = &self.knobs;
        if let Some(seconds) = self.seconds_to_collision(now, speed, curvature)
            && seconds < knobs.min_time_to_collision.0
        {
            return Some(StopReason::Collision(seconds));
        }
        if self.latched.is_some() {
            return self.latched;
        }
        let Some(progress) = &self.progress else { return Some(StopReason::NoPath) };
        let Some(pose) = self.pose else {
            return Some(if self.clock_jumped { StopReason::ClockJumped } else { StopReason::NoPose });
        };
        let age = now.seconds_since(pose.stamp);
        if age > knobs.max_pose_age.0 || age < -AHEAD {
            return Some(StopReason::PoseAge(age));
        }
        if knobs.max_position_error > 0.0 && (pose.deviation > knobs.max_position_error || pose.deviation.is_nan()) {
            return Some(StopReason::PoseUncertain(pose.deviation));
        }
        if let Some((stamp, _)) = self.scan
            && let age = now.seconds_since(stamp)
            && knobs.max_scan_age.0 > 0.0
            && age > knobs.max_scan_age.0
        {
            return Some(StopReason::ScanAge(age));
        }
        let Some(place) = place else { return Some(StopReason::WrongWay) };
        let remaining = progress.path().remaining(place.along);
        match place.distance {
            _ if remaining <= AT_END => Some(StopReason::Arrived),
            distance if distance > knobs.max_path_distance => Some(StopReason::PathFar(distance)),
            _ => None,
        }
    }

    /// `None`: there is no scan, or the car stands.
    fn seconds_to_collision(&self, now: Stamp, speed: f64, curvature: f64) -> Option<f64> {
        let (stamp, points) = self.scan.as_ref()?;
        if self.knobs.min_time_to_collision.0 == 0.0 || speed < STANDING {
            return None;
        }
        let footprint = Footprint { front: self.knobs.front, width: self.knobs.width };
        let age = now.seconds_since(*stamp).clamp(0.0, self.knobs.max_scan_age.0);
        Some(footprint.free_way(points, curvature) / speed - age)
    }

    /// How often a command is due at least for its speed to be as smooth as the plan.
    pub const PERIOD: Duration = Duration::from_millis(20);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::path::tests::waypoints;
    use crate::simulation::vehicle::Vehicle;

    /// A car, its follower, and a clock.
    struct Drive {
        knobs: VehicleKnobs,
        /// Steering angle of the wheels when they are told to be straight, rad.
        offset: f64,
        follower: Follower,
        pose: Pose2,
        speed: f64,
        steering: f64,
        now: f64,
        poses: bool,
    }

    impl Drive {
        fn new(knobs: FollowerKnobs) -> Self {
            let car = knobs.car();
            Self {
                knobs: car,
                offset: 0.0,
                follower: Follower::new(knobs),
                pose: Pose2::IDENTITY,
                speed: 0.0,
                steering: 0.0,
                now: 100.0,
                poses: true,
            }
        }

        fn on(points: &[(f64, f64)]) -> Self {
            let mut drive = Self::new(FollowerKnobs::default());
            drive.give(points, 100.0).unwrap();
            drive
        }

        fn give(&mut self, points: &[(f64, f64)], stamp: f64) -> Result<Arrival, PathError> {
            self.follower.on_path(&waypoints(points), Stamp::from_seconds(stamp))
        }

        /// The lateral error to the path followed, m.
        fn line(&self) -> f64 {
            let path = self.follower.progress().unwrap().path();
            path.project(&self.pose, 0.0, path.length()).unwrap().lateral_error
        }

        fn tick(&mut self) -> Step {
            let stamp = Stamp::from_seconds(self.now);
            if self.poses {
                self.follower.on_pose(PoseReading { stamp, pose: self.pose, speed: Some(self.speed), deviation: 0.01 });
            }
            let step = self.follower.command(stamp);
            let mut vehicle = Vehicle::moving(&self.knobs, self.speed, self.steering);
            let curvature = (step.steering + self.offset).tan() / self.knobs.wheelbase;
            self.pose = self.pose * vehicle.step(Command { curvature, ..step.command }, 0.02).motion(0.02);
            (self.speed, self.steering) = (vehicle.speed(), vehicle.turn());
            self.now += 0.02;
            step
        }

        /// The last step.
        fn run(&mut self, seconds: f64) -> Step {
            let end = self.now + seconds;
            while self.now < end - 0.021 {
                self.tick();
            }
            self.tick()
        }
    }

    const LINE: [(f64, f64); 3] = [(0.0, 0.0), (5.0, 0.0), (10.0, 0.0)];

    #[test]
    fn it_stops_at_the_end_of_the_path_and_on_it() {
        let mut drive = Drive::on(&LINE);
        let step = drive.run(12.0);
        assert_eq!(step.stop, Some(StopReason::Arrived));
        assert!((drive.pose.x - 10.0).abs() < 0.06 && drive.pose.y.abs() < 0.01 && drive.speed < 1e-9, "{:?}", drive.pose);
        // Another path: it goes on.
        drive.give(&[(9.0, 0.0), (15.0, 0.0)], 113.0).unwrap();
        assert_eq!(drive.run(1.0).stop, None);
    }

    #[test]
    fn a_path_shorter_than_the_lookahead_is_followed_to_its_end() {
        let mut drive = Drive::on(&[(0.0, 0.0), (0.3, 0.0)]);
        assert_eq!(drive.run(4.0).stop, Some(StopReason::Arrived));
        assert!((drive.pose.x - 0.3).abs() < 0.06, "{:?}", drive.pose);
    }

    #[test]
    fn waypoints_with_speed_zero_do_not_stall_the_start() {
        let mut drive = Drive::new(FollowerKnobs::default());
        let speeds = [0.0, 0.0, 1.0, 1.5, 0.0];
        let points: Vec<_> = (0_u32..)
            .zip(speeds)
            .map(|(i, speed)| Waypoint { point: Point::new(f64::from(i), 0.0), speed: Some(speed) })
            .collect();
        drive.follower.on_path(&points, Stamp::from_seconds(100.0)).unwrap();
        drive.run(8.0);
        assert!((drive.pose.x - 4.0).abs() < 0.06, "{:?}", drive.pose);
    }

    #[test]
    fn it_brakes_when_poses_end_and_goes_on_when_they_come_again() {
        let mut drive = Drive::on(&[(0.0, 0.0), (100.0, 0.0)]);
        assert_eq!(drive.run(2.0).stop, None);
        assert!(drive.speed > 1.9);
        drive.poses = false;
        let step = drive.run(1.5);
        assert!(matches!(step.stop, Some(StopReason::PoseAge(_))) && drive.speed < 1e-9, "{step:?}");
        assert!(step.stop.unwrap().to_string().contains("s old"));
        drive.poses = true;
        assert_eq!(drive.run(1.0).stop, None);
        assert!(drive.speed > 1.0);
    }

    #[test]
    fn it_stops_for_no_path_one_far_away_and_a_pose_that_nobody_knows() {
        let mut drive = Drive::new(FollowerKnobs::default());
        assert_eq!(drive.run(0.1).stop, Some(StopReason::NoPath));
        drive.give(&[(0.0, 5.0), (10.0, 5.0)], 100.0).unwrap();
        assert!(matches!(drive.run(0.1).stop, Some(StopReason::PathFar(_))));
        drive.give(&[(10.0, 0.0), (0.0, 0.0)], 101.0).unwrap();
        assert_eq!(drive.run(0.1).stop, Some(StopReason::WrongWay));
        drive.give(&LINE, 102.0).unwrap();
        assert_eq!(drive.run(1.0).stop, None);
        for nothing in [&[][..], &[(1.0, 1.0)]] {
            assert!(drive.give(nothing, 103.0).is_err());
            assert_eq!(drive.run(1.0).stop, Some(StopReason::NoPath));
            assert!(drive.speed < 1e-9);
            drive.give(&LINE, 103.0).unwrap();
            assert_eq!(drive.run(0.2).stop, None);
        }
        assert!(drive.give(&[(0.0, 0.0), (f64::NAN, 0.0)], 104.0).is_err());
        assert_eq!(drive.run(0.2).stop, None, "the path before stays");
        let stamp = Stamp::from_seconds(drive.now);
        drive.follower.on_pose(PoseReading { stamp, pose: drive.pose, speed: None, deviation: 2.0 });
        assert_eq!(drive.follower.command(stamp).stop, Some(StopReason::PoseUncertain(2.0)));
    }

    #[test]
    fn wheels_that_are_not_straight_do_not_keep_the_car_beside_the_path() {
        let mut drive = Drive::new(FollowerKnobs { speed: 7.0, ..FollowerKnobs::default() });
        drive.offset = 0.02;
        drive.give(&[(0.0, 0.0), (200.0, 0.0)], 100.0).unwrap();
        drive.run(2.0);
        drive.run(4.0);
        assert!(drive.pose.x > 20.0 && drive.line().abs() < 0.005, "{} m beside the path", drive.line());
    }

    #[test]
    fn a_clock_that_jumps_stops_it_until_the_next_pose() {
        let mut drive = Drive::on(&[(0.0, 0.0), (100.0, 0.0)]);
        drive.run(1.0);
        drive.poses = false;
        drive.now -= 50.0;
        assert_eq!(drive.tick().stop, Some(StopReason::ClockJumped));
        drive.poses = true;
        assert_eq!(drive.tick().stop, None);
        assert_eq!(drive.give(&LINE, drive.now), Ok(Arrival::Taken), "older than the one before, by the clock of before");
    }

    #[test]
    fn it_stays_before_an_obstacle_until_told_to_go_on() {
        let mut drive = Drive::on(&[(0.0, 0.0), (100.0, 0.0)]);
        drive.run(2.0);
        let scan = |drive: &mut Drive, x: f64| {
            let stamp = Stamp::from_seconds(drive.now);
            drive.follower.on_scan(stamp, [-0.1, 0.0, 0.1].map(|y| Point::new(x, y)).to_vec());
        };
        scan(&mut drive, 3.0);
        assert_eq!(drive.tick().stop, None);
        scan(&mut drive, 0.8);
        assert!(matches!(drive.tick().stop, Some(StopReason::Collision(_))));
        for _ in 0..50 {
            scan(&mut drive, 9.0);
            assert!(matches!(drive.tick().stop, Some(StopReason::Collision(_))));
        }
        assert!(drive.speed < 1e-9);
        drive.follower.resume();
        assert_eq!(drive.tick().stop, None);
        drive.run(1.5);
        assert!(matches!(drive.tick().stop, Some(StopReason::ScanAge(_))));
    }

    #[test]
    fn paths_that_come_late_and_shuffled_leave_no_stop_and_no_step_in_the_line() {
        // Every one 2 s late, and 0 to 2 s by turns: the newer ones overtake.
        for lateness in [[2.0, 2.0, 2.0], [2.0, 0.0, 1.0]] {
            let mut drive = Drive::new(FollowerKnobs { speed: 7.0, ..FollowerKnobs::default() });
            let wave = |x: f64| 2.0 * (0.15 * x).sin();
            let planned = |x: f64| (0..=400).map(|i| x + 0.1 * f64::from(i)).map(|x| (x, wave(x))).collect::<Vec<_>>();
            let mut waiting = Vec::new();
            drive.pose = Pose2::new(0.0, 0.0, 0.3);
            drive.give(&planned(0.0), 100.0).unwrap();
            for tick in 0..600_u32 {
                if tick % 10 == 0 {
                    let late = lateness[tick as usize / 10 % 3];
                    waiting.push((drive.now + late, drive.now, planned(drive.pose.x)));
                }
                waiting.retain(|(due, stamp, path)| {
                    let is_due = *due <= drive.now;
                    if is_due {
                        let before = drive.line();
                        drive.follower.on_path(&waypoints(path), Stamp::from_seconds(*stamp)).unwrap();
                        assert!((drive.line() - before).abs() < 0.05, "at {tick}: from {before} to {} m", drive.line());
                    }
                    !is_due
                });
                let step = drive.tick();
                assert_eq!(step.stop, None, "at {tick}");
                assert!((drive.pose.y - wave(drive.pose.x)).abs() < 0.12, "at {tick}: {:?}", drive.pose);
            }
            assert!(drive.speed > 4.0 && drive.pose.x > 50.0, "{:?}", drive.pose);
        }
    }
}
