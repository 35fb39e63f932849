//! `/initialpose` in a simulator: the same message also moves the car, and the order of its receivers is unknown.

use std::sync::Arc;
use std::time::Duration;

use anytime_scan_matcher::anytime::clock::VirtualClock;
use anytime_scan_matcher::anytime::interrupt::NeverInterrupt;
use anytime_scan_matcher::app::{App, ScanProcessor as _};
use anytime_scan_matcher::config::Config;
use anytime_scan_matcher::geometry::Pose2;
use anytime_scan_matcher::messages::geometry_msgs::PoseWithCovarianceStamped;
use anytime_scan_matcher::messages::nav_msgs::Odometry;
use anytime_scan_matcher::simulation::built_in::BuiltIn;
use anytime_scan_matcher::simulation::car::Car;
use anytime_scan_matcher::simulation::driver::Driver;
use anytime_scan_matcher::simulation::lidar::{Lidar, LidarKnobs};
use anytime_scan_matcher::simulation::scene::Scene;
use anytime_scan_matcher::simulation::vehicle::VehicleKnobs;
use anytime_scan_matcher::time::Stamp;
use rand::{RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64;

const TRIALS: u64 = 40;
const SCANS_BEFORE: u32 = 10;
const SCANS_AFTER: u32 = 12;
/// Delay from a scan to its arrival, s.
const LATENCY: f64 = 0.002;
const START: f64 = 1000.0;

/// One trial at a scan rate, Hz.
struct Try {
    rate: f64,
    with_odometry: bool,
    is_stamped: bool,
    /// Time by which the matcher receives the pose before the car is moved, s; negative: after.
    lead: f64,
    seed: u64,
}

impl Try {
    fn error(&self, scene: &Scene) -> Pose2 {
        let mut random = Pcg64::seed_from_u64(self.seed);
        let vehicle = VehicleKnobs { speed: 2.0, ..VehicleKnobs::default() };
        let lidar_knobs = LidarKnobs { beams: 181, field_of_view: 360.0, rate: self.rate, ..LidarKnobs::default() };
        let mut lidar = Lidar::new(&lidar_knobs, Pcg64::seed_from_u64(self.seed));
        let mut driver = Driver::new(&scene.route, &vehicle);
        let mut car = Car::new(scene.world.as_ref(), &vehicle, driver.start());
        let place = |index: usize| {
            let (here, next) = (scene.route.point(index), scene.route.point(index + 1));
            Pose2::new(here.x, here.y, (next.y - here.y).atan2(next.x - here.x))
        };
        for _ in 0..50 {
            car.step(driver.command(&car.map_from_base(), car.twist().vx), 0.02); // gets going
        }
        let target = if self.seed.is_multiple_of(4) {
            car.map_from_base() * Pose2::new(random.random_range(-0.4..0.4), random.random_range(-0.3..0.3), 0.3)
        } else {
            place(random.random_range(0..scene.route.points().len()))
        };
        let period = self.rate.recip();
        let moved_at = START + f64::from(SCANS_BEFORE) * period + random.random::<f64>() * period;
        let told_at = moved_at - self.lead;
        let settled = moved_at.max(told_at) + 2.0 * LATENCY;

        let mut config = Config::default();
        config.odometry.laser_in_base = Some(lidar_knobs.laser_in_base.into());
        config.odometry.initial_pose = car.map_from_base();
        let mut app = App::new(&config, Arc::new(VirtualClock::new(Duration::from_micros(1)))).unwrap();
        let mut message = PoseWithCovarianceStamped::default();
        message.pose.pose = target.into();
        if self.is_stamped {
            message.header.stamp = Stamp::from_seconds(told_at.min(moved_at) - 0.001).into();
        }
        let arrival = |seconds: f64| Duration::from_secs_f64(seconds);
        let (mut is_told, mut is_moved, mut after, mut number, mut time) = (false, false, 0, 0_u32, START);
        loop {
            number += 1;
            let next = START + f64::from(number) * period;
            let step = |car: &mut Car, driver: &mut Driver, seconds: f64| {
                let command = driver.command(&car.map_from_base(), car.twist().vx);
                car.step(command, seconds);
            };
            if !is_moved && next >= moved_at {
                step(&mut car, &mut driver, moved_at - time);
                car.teleport(target);
                driver.find(target.translation());
                (is_moved, time) = (true, moved_at);
            }
            step(&mut car, &mut driver, next - time);
            time = next;
            let (stamp, truth) = (Stamp::from_seconds(next), car.map_from_base());
            let scan = lidar.scan(|_| scene.world.as_ref(), |_| truth, stamp);
            if !is_told && next + LATENCY >= told_at {
                app.on_initial_pose(&message, arrival(told_at)).unwrap();
                is_told = true;
            }
            if self.with_odometry {
                let mut odometry = Odometry::default();
                odometry.header.stamp = stamp.into();
                odometry.pose.pose = truth.into();
                app.on_odometry(&odometry).unwrap();
            }
            let mut estimate = app.on_scan(&scan, arrival(next + LATENCY));
            app.conclude(&mut estimate);
            app.maintain(&NeverInterrupt);
            after += u32::from(next > settled);
            if after == SCANS_AFTER {
                return truth.between(&estimate.registration.map_from_base());
            }
        }
    }
}

#[test]
fn the_pose_is_right_whoever_receives_it_first() {
    let scene = Scene::built_in(BuiltIn::Corridor).unwrap();
    for rate in [40.0, 200.0, 1000.0] {
        let mut wrong = Vec::new();
        let mut worst = (0.0_f64, 0.0_f64);
        for seed in 0..TRIALS {
            let mut random = Pcg64::seed_from_u64(1000 + seed);
            let with_odometry = seed.is_multiple_of(2);
            let is_stamped = random.random();
            // Simulators take up to some periods of their loop to move the car; a late subscriber receives the message late.
            let lead = if seed.is_multiple_of(3) {
                -random.random_range(0.0..0.01)
            } else {
                random.random_range(0.0..0.05_f64).min(15.0 / rate)
            };
            let error = Try { rate, with_odometry, is_stamped, lead, seed }.error(&scene);
            worst = (worst.0.max(error.distance()), worst.1.max(error.theta.abs().to_degrees()));
            // The car drives at 2 m/s, and it is unknown when it was moved between two scans.
            let bound = 0.05 + 2.0 * 1.0 / rate;
            if error.distance() > bound || error.theta.abs().to_degrees() > 3.0 {
                wrong.push((seed, lead, is_stamped, with_odometry, error));
            }
        }
        eprintln!("{rate} Hz: off by at most {:.3} m, {:.2} degrees; wrong: {wrong:?}", worst.0, worst.1);
        assert!(wrong.is_empty(), "{rate} Hz: {wrong:?}");
    }
}
