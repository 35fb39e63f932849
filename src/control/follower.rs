//! Path follower with delay compensation, shared by the node and the closed-loop simulation.

use std::time::Duration;

use super::delay::{CommandHistory, VehicleState};
use super::laws::{Law, LawInput};
use super::path::{Path, PathError, Projection, Waypoint};
use super::progress::{PathUpdate, Progress};
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
    /// Path following, and the car that follows.
    pub struct FollowerKnobs {
        /// Control law for the steering.
        law: Law = Law::Stanley;
        /// Top speed; curves, and speeds given with the path, may reduce it.
        speed: f64 = 2.0, in 0.1 to 20, unit "m/s";
        /// Maximum lateral acceleration; limits the speed in curves.
        lateral_acceleration: f64 = 4.0, in 0.1 to 20, unit "m/s^2";
        /// Acceleration and deceleration along the path.
        acceleration: f64 = 3.0, in 0.1 to 20, unit "m/s^2";
        /// Deceleration of a safety stop.
        braking: f64 = 6.0, in 0.1 to 20, unit "m/s^2";
        /// Increase of the lookahead distance per m/s of speed.
        lookahead_time: Seconds = Seconds(0.25), in 0 to 5, unit "s";
        /// Lookahead distance at rest, before its limits apply.
        lookahead_distance: f64 = 0.3, in 0.05 to 10, unit "m";
        /// Minimum lookahead distance.
        min_lookahead: f64 = 0.6, in 0.05 to 10, unit "m";
        /// Maximum lookahead distance.
        max_lookahead: f64 = 4.0, in 0.1 to 50, unit "m";
        /// Predict poses from their stamps to the time at which the command takes effect.
        compensate_delay: bool = true;
        /// Delay from a command to its effect on steering and motor.
        actuation_delay: Seconds = Seconds(0.0), in 0 to 1, unit "s";
        /// The car brakes if the pose is older than this.
        max_pose_age: Seconds = Seconds(0.5), in 0.01 to 10, unit "s";
        /// The car brakes if scans were received and the last one is older than this; 0: never.
        max_scan_age: Seconds = Seconds(1.0), in 0 to 10, unit "s";
        /// The car brakes if the standard deviation of the position is greater than this; 0: never.
        max_position_error: f64 = 0.5, in 0 to 100, unit "m";
        /// The car brakes if the path is farther away than this.
        max_path_distance: f64 = 1.0, in 0.05 to 100, unit "m";
        /// Emergency brake: the car stops, until resumed, if the time to collision by the scan is less than this; 0: never.
        min_time_to_collision: Seconds = Seconds(0.25), in 0 to 5, unit "s";
        /// Distance between the axles.
        wheelbase: f64 = racecar::WHEELBASE, in 0.05 to 5, unit "m";
        /// Distance from the rear axle to the front bumper.
        front: f64 = 0.45, in 0.05 to 10, unit "m";
        /// Width of the car.
        width: f64 = 0.3, in 0.05 to 5, unit "m";
        /// Maximum steering angle.
        max_steering: f64 = racecar::MAX_STEERING, in 0.05 to 1.4, unit "rad";
        /// Maximum rate of the steering angle.
        steering_rate: f64 = racecar::STEERING_RATE, in 0.1 to 20, unit "rad/s";
        /// Maximum acceleration that the car is capable of.
        max_acceleration: f64 = racecar::MAX_ACCELERATION, in 0.1 to 50, unit "m/s^2";
    }
}

/// The car has arrived if the rest of the path is no longer than this, m.
const ARRIVAL_DISTANCE: f64 = 0.05;
/// Minimum speed until arrival, m/s: at the planned speed the car would approach the end ever more slowly.
const CREEP_SPEED: f64 = 0.2;
/// Below this speed the car counts as standing, m/s.
const STANDSTILL_SPEED: f64 = 0.05;
/// Minimum speed for learning the steering trim, m/s: a slower car turns too little.
const MIN_LEARNING_SPEED: f64 = 0.5;
/// The clock has jumped if it goes back, or forward by more than this between two commands, s.
const MAX_CLOCK_STEP: f64 = 2.0;
/// Maximum command period that acceleration limits use, s: a longer gap between commands allows no larger change of speed.
const MAX_PERIOD: f64 = 0.1;
/// Poses may be stamped at most this far in the future, s: clocks are never exactly synchronized.
const MAX_FUTURE: f64 = 0.1;

impl FollowerKnobs {
    /// Parameters of the vehicle model.
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

    /// Lookahead distance at a speed, m.
    pub fn lookahead(&self, speed: f64) -> f64 {
        let wanted = self.lookahead_time.0 * speed.abs() + self.lookahead_distance;
        wanted.max(self.min_lookahead).min(self.max_lookahead)
    }

    /// Maximum age of a scan, s; infinite if there is no limit.
    fn scan_age_limit(&self) -> f64 {
        if self.max_scan_age.0 > 0.0 { self.max_scan_age.0 } else { f64::INFINITY }
    }

    fn limits(&self) -> SpeedLimits {
        SpeedLimits { top: self.speed, lateral_acceleration: self.lateral_acceleration, braking: self.acceleration }
    }
}

/// A pose from an estimator.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseReading {
    /// Time of the pose.
    pub stamp: Stamp,
    /// Pose of the rear axle in the frame of the path.
    pub pose: Pose2,
    /// Forward speed, m/s, if known.
    pub speed: Option<f64>,
    /// Standard deviation of the position, m; 0: unknown.
    pub deviation: f64,
}

/// A command, and the state that led to it.
#[derive(Clone, Copy, Debug)]
pub struct Step {
    /// The command for the car.
    pub command: Command,
    /// Steering angle of the command, rad.
    pub steering: f64,
    /// Why the car brakes or stands; `None` if it drives.
    pub stop: Option<StopReason>,
    /// Projection of the car onto the path at the time the command takes effect.
    pub projection: Option<Projection>,
    /// Predicted pose at that time, if known.
    pub pose: Option<Pose2>,
    /// Lookahead distance, m.
    pub lookahead: f64,
    /// Age of the pose when the command takes effect, s.
    pub pose_age: Option<f64>,
    /// Age of the path, s.
    pub path_age: Option<f64>,
}

/// The path follower: turns paths, poses and scans into commands.
#[derive(Clone, Debug)]
pub struct Follower {
    knobs: FollowerKnobs,
    history: CommandHistory,
    trim: Trim,
    progress: Option<Progress>,
    profile: Option<SpeedProfile>,
    pose: Option<PoseReading>,
    scan: Option<(Stamp, Vec<Point>)>,
    last_command: Option<(Stamp, Command)>,
    /// Reason of a stop that lasts until [`Self::resume`].
    latched: Option<StopReason>,
    clock_jumped: bool,
}

impl Follower {
    /// A follower without path and pose.
    pub fn new(knobs: FollowerKnobs) -> Self {
        Self {
            history: CommandHistory::new(knobs.car()),
            trim: Trim::default(),
            knobs,
            progress: None,
            profile: None,
            pose: None,
            scan: None,
            last_command: None,
            latched: None,
            clock_jumped: false,
        }
    }

    /// The parameters.
    pub fn knobs(&self) -> &FollowerKnobs {
        &self.knobs
    }

    /// The path followed, and the car's progress on it.
    pub fn progress(&self) -> Option<&Progress> {
        self.progress.as_ref()
    }

    /// Handles a path received as waypoints. A path that is empty or has no length stops the car. A path with non-finite numbers
    /// is rejected, and the previous one is kept.
    pub fn on_path(&mut self, waypoints: &[Waypoint], stamp: Stamp) -> Result<PathUpdate, PathError> {
        match Path::closed_if_loop(waypoints) {
            Ok(path) => Ok(self.follow_path(path, stamp)),
            Err(problem @ PathError::NotFinite { .. }) => Err(problem),
            Err(problem) => {
                if self.progress.as_ref().is_none_or(|progress| stamp >= progress.stamp()) {
                    (self.progress, self.profile) = (None, None);
                }
                Err(problem)
            }
        }
    }

    /// Follows a path from now on, unless it is outdated or the same as the current one.
    pub fn follow_path(&mut self, path: Path, stamp: Stamp) -> PathUpdate {
        let update = match &mut self.progress {
            Some(progress) => progress.update_path(path, stamp),
            none => {
                *none = Some(Progress::new(path, stamp));
                PathUpdate::Accepted
            }
        };
        if update == PathUpdate::Accepted {
            self.profile = self.progress.as_ref().map(|progress| SpeedProfile::new(progress.path(), &self.knobs.limits()));
        }
        update
    }

    /// Handles a pose; one that is older than the last is ignored.
    pub fn on_pose(&mut self, reading: PoseReading) {
        if reading.pose.is_finite() && self.pose.is_none_or(|last| last.stamp <= reading.stamp) {
            if let Some(last) = self.pose.replace(reading) {
                self.learn_trim(&last, &reading);
            }
            self.clock_jumped = false;
        }
    }

    /// Learns the steering trim from the heading change between two poses compared with the commanded one. A car that rolls
    /// although commanded to stand is driven by somebody else: nothing is learned.
    fn learn_trim(&mut self, last: &PoseReading, next: &PoseReading) {
        if self.last_command.is_none_or(|(_, command)| command.speed < MIN_LEARNING_SPEED) {
            return;
        }
        let predicted = self.history.predict(last.pose, last.stamp, last.speed, next.stamp);
        let distance = predicted.speed * next.stamp.seconds_since(last.stamp);
        if predicted.speed.abs() > MIN_LEARNING_SPEED {
            self.trim.learn(predicted.pose.between(&next.pose).theta, distance, self.knobs.wheelbase);
        }
    }

    /// Handles the points of a scan, in the frame of the rear axle.
    pub fn on_scan(&mut self, stamp: Stamp, points: Vec<Point>) {
        self.scan = Some((stamp, points));
    }

    /// Releases the stop in front of an obstacle.
    pub fn resume(&mut self) {
        self.latched = None;
    }

    /// Computes the command at a time.
    pub fn command(&mut self, now: Stamp) -> Step {
        self.check_clock(now);
        let effect_time = now.offset_by(self.knobs.actuation_delay.0);
        let before = self.last_command.map_or(Command::default(), |(_, command)| command);
        let period = self.last_command.map_or(0.0, |(last, _)| now.seconds_since(last)).min(MAX_PERIOD);
        let state = self.predicted_state(effect_time);
        let speed = state.map_or(before.speed, |state| state.speed);
        let projection = self.update_progress(state, period);
        let lookahead = self.knobs.lookahead(speed);
        let curvature = self.law_curvature(state, projection, lookahead).unwrap_or(before.curvature);
        let stop = self.stop_reason(now, projection, speed, curvature);
        let wanted = match stop {
            None => self.path_speed(projection, speed, period).min(before.speed.max(speed) + self.knobs.acceleration * period),
            Some(_) => (before.speed - self.knobs.braking * period).max(0.0),
        };
        let command = Command { speed: wanted, curvature };
        self.history.record(effect_time, command);
        self.last_command = Some((now, command));
        self.latched = stop.filter(StopReason::is_latched);
        // The history records the intended motion, without the trim that is subtracted from the steering angle.
        let intended = (self.knobs.wheelbase * curvature).atan();
        let steering = (intended - self.trim.angle()).clamp(-self.knobs.max_steering, self.knobs.max_steering);
        Step {
            command: Command { curvature: steering.tan() / self.knobs.wheelbase, ..command },
            steering,
            stop,
            projection,
            pose: state.map(|state| state.pose),
            lookahead,
            pose_age: self.pose.map(|pose| effect_time.seconds_since(pose.stamp)),
            path_age: self.progress.as_ref().map(|progress| now.seconds_since(progress.stamp())),
        }
    }

    /// Discards everything that was stamped before a clock jump.
    fn check_clock(&mut self, now: Stamp) {
        let Some((last, _)) = self.last_command else { return };
        if (0.0..=MAX_CLOCK_STEP).contains(&now.seconds_since(last)) {
            return;
        }
        self.history.clear();
        (self.pose, self.scan, self.clock_jumped) = (None, None, true);
        if let Some(progress) = &mut self.progress {
            progress.restamp(now);
        }
    }

    /// Predicted pose at a time, if known.
    pub fn pose_at(&self, now: Stamp) -> Option<Pose2> {
        self.predicted_state(now).map(|state| state.pose)
    }

    /// Predicted state of the car at the time a command takes effect; without delay compensation, at the stamp of the pose.
    fn predicted_state(&self, effect_time: Stamp) -> Option<VehicleState> {
        let PoseReading { stamp, pose, speed, .. } = self.pose?;
        let until = if self.knobs.compensate_delay { effect_time.max(stamp) } else { stamp };
        Some(self.history.predict(pose, stamp, speed, until))
    }

    fn update_progress(&mut self, state: Option<VehicleState>, period: f64) -> Option<Projection> {
        let (progress, state) = (self.progress.as_mut()?, state?);
        let projection = progress.update(&state.pose, state.speed.abs() * period);
        let is_far = projection.is_none_or(|projection| projection.distance > self.knobs.max_path_distance);
        if is_far && state.speed.abs() < STANDSTILL_SPEED {
            // The car was picked up and moved, or its pose was corrected: search the whole path.
            progress.reset();
            return progress.update(&state.pose, 0.0);
        }
        projection
    }

    fn law_curvature(&self, state: Option<VehicleState>, projection: Option<Projection>, lookahead: f64) -> Option<f64> {
        let (state, projection, progress) = (state?, projection?, self.progress.as_ref()?);
        let path = progress.path();
        let input =
            LawInput { path, projection, pose: state.pose, speed: state.speed, lookahead, wheelbase: self.knobs.wheelbase };
        let max_curvature = self.knobs.max_steering.tan() / self.knobs.wheelbase;
        Some(self.knobs.law.curvature(&input))
            .filter(|curvature| curvature.is_finite())
            .map(|curvature| curvature.clamp(-max_curvature, max_curvature))
    }

    /// The speed that the path allows.
    fn path_speed(&self, projection: Option<Projection>, speed: f64, period: f64) -> f64 {
        let (Some(projection), Some(profile), Some(progress)) = (projection, &self.profile, &self.progress) else { return 0.0 };
        let allowed = profile.at(projection.along + speed.max(0.0) * period);
        if progress.path().remaining(projection.along).is_finite() { allowed.max(CREEP_SPEED) } else { allowed }
    }

    fn stop_reason(&self, now: Stamp, projection: Option<Projection>, speed: f64, curvature: f64) -> Option<StopReason> {
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
        if age > knobs.max_pose_age.0 || age < -MAX_FUTURE {
            return Some(StopReason::PoseAge(age));
        }
        if knobs.max_position_error > 0.0 && (pose.deviation > knobs.max_position_error || pose.deviation.is_nan()) {
            return Some(StopReason::PoseUncertain(pose.deviation));
        }
        if let Some((stamp, _)) = self.scan
            && let age = now.seconds_since(stamp)
            && age > knobs.scan_age_limit()
        {
            return Some(StopReason::ScanAge(age));
        }
        let Some(projection) = projection else { return Some(StopReason::WrongWay) };
        let remaining = progress.path().remaining(projection.along);
        match projection.distance {
            _ if remaining <= ARRIVAL_DISTANCE => Some(StopReason::Arrived),
            distance if distance > knobs.max_path_distance => Some(StopReason::PathFar(distance)),
            _ => None,
        }
    }

    /// Time to collision by the last scan, s; `None` if there is no scan or the car stands.
    fn seconds_to_collision(&self, now: Stamp, speed: f64, curvature: f64) -> Option<f64> {
        let (stamp, points) = self.scan.as_ref()?;
        if self.knobs.min_time_to_collision.0 == 0.0 || speed < STANDSTILL_SPEED {
            return None;
        }
        let footprint = Footprint { front: self.knobs.front, width: self.knobs.width };
        let age = now.seconds_since(*stamp).clamp(0.0, self.knobs.scan_age_limit());
        Some(footprint.free_distance(points, curvature) / speed - age)
    }

    /// Recommended period of the commands: slower commands would follow the speed profile in visible steps.
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
        /// Steering angle of the wheels when commanded to be straight, rad.
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

        fn give(&mut self, points: &[(f64, f64)], stamp: f64) -> Result<PathUpdate, PathError> {
            self.follower.on_path(&waypoints(points), Stamp::from_seconds(stamp))
        }

        /// Lateral error to the followed path, m.
        fn lateral_error(&self) -> f64 {
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
            (self.speed, self.steering) = (vehicle.speed(), vehicle.steering_state());
            self.now += 0.02;
            step
        }

        /// Runs for some time, s; returns the last step.
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
    fn it_stops_at_the_end_of_the_path() {
        let mut drive = Drive::on(&LINE);
        let step = drive.run(12.0);
        assert_eq!(step.stop, Some(StopReason::Arrived));
        assert!((drive.pose.x - 10.0).abs() < 0.06 && drive.pose.y.abs() < 0.01 && drive.speed < 1e-9, "{:?}", drive.pose);
        // With another path it continues.
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
    fn it_brakes_without_poses_and_continues_when_they_return() {
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
    fn it_stops_without_path_far_from_it_and_with_an_uncertain_pose() {
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
        assert_eq!(drive.run(0.2).stop, None, "the previous path is kept");
        let stamp = Stamp::from_seconds(drive.now);
        drive.follower.on_pose(PoseReading { stamp, pose: drive.pose, speed: None, deviation: 2.0 });
        assert_eq!(drive.follower.command(stamp).stop, Some(StopReason::PoseUncertain(2.0)));
    }

    #[test]
    fn a_steering_offset_causes_no_lasting_lateral_error() {
        let mut drive = Drive::new(FollowerKnobs { speed: 7.0, ..FollowerKnobs::default() });
        drive.offset = 0.02;
        drive.give(&[(0.0, 0.0), (200.0, 0.0)], 100.0).unwrap();
        drive.run(2.0);
        drive.run(4.0);
        assert!(drive.pose.x > 20.0 && drive.lateral_error().abs() < 0.005, "{} m beside the path", drive.lateral_error());
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
        assert_eq!(
            drive.give(&LINE, drive.now),
            Ok(PathUpdate::Accepted),
            "its stamp is older than that of the path before the clock jump"
        );
    }

    #[test]
    fn it_stays_in_front_of_an_obstacle_until_resumed() {
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
    fn the_age_of_a_scan_counts_even_if_it_is_not_limited() {
        let mut drive = Drive::new(FollowerKnobs { max_scan_age: Seconds(0.0), ..FollowerKnobs::default() });
        drive.give(&[(0.0, 0.0), (100.0, 0.0)], 100.0).unwrap();
        drive.run(2.0);
        drive.follower.on_scan(Stamp::from_seconds(drive.now), vec![Point::new(2.0, 0.0); 3]);
        assert_eq!(drive.tick().stop, None, "the obstacle is 0.8 s ahead");
        assert!(matches!(drive.run(0.6).stop, Some(StopReason::Collision(_))), "and 0.2 s ahead after 0.6 s without a scan");
    }

    #[test]
    fn late_and_reordered_paths_cause_no_stop_and_no_jump() {
        // All paths 2 s late, and alternating between 0 and 2 s, so that newer ones overtake older ones.
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
                        let before = drive.lateral_error();
                        drive.follower.on_path(&waypoints(path), Stamp::from_seconds(*stamp)).unwrap();
                        assert!(
                            (drive.lateral_error() - before).abs() < 0.05,
                            "at {tick}: from {before} to {} m",
                            drive.lateral_error()
                        );
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
