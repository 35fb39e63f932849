//! Pairs of scans taken shortly after each other, with the true motion between them, to measure the accuracy of a matcher.

use nalgebra::Matrix3;
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;

use crate::geometry::{Pose2, Twist2};
use crate::messages::sensor_msgs::LaserScan;
use crate::scan::{Scan, ScanConverter, ScanError};
use crate::time::Stamp;

use super::information;
use super::lidar::{Lidar, LidarKnobs};
use super::random_world::{RandomWorld, Surroundings};

/// RMS translation error of the initial guesses, m.
pub const GUESS_TRANSLATION: f64 = 0.015;
/// RMS rotation error of the initial guesses, deg.
pub const GUESS_ROTATION: f64 = 0.6;
/// Scan rate, Hz, maximum speed, m/s, and maximum yaw rate, rad/s, of the drives: a fast laser on a racecar and a slow laser on a
/// slow robot.
const DRIVES: [(f64, f64, f64); 2] = [(40.0, 7.0, 3.0), (10.0, 2.0, 1.0)];

/// Two scans and the motion between them.
#[derive(Clone, Debug)]
pub struct ScanPair {
    /// The earlier scan.
    pub reference: Scan,
    /// The later scan.
    pub sensed: Scan,
    /// True pose of the later laser in the frame of the earlier one.
    pub reference_from_sensed: Pose2,
    /// The true pose with normally distributed errors of [`GUESS_TRANSLATION`] and [`GUESS_ROTATION`].
    pub first_guess: Pose2,
    /// Fisher information of the later scan about its pose in a known world; see [`information::pair_covariance_bound`].
    pub information: Matrix3<f64>,
}

/// Samples pairs at random positions. Pairs with the same seed are bitwise identical.
#[derive(Debug)]
pub struct Pairs {
    world: RandomWorld,
    lidar: LidarKnobs,
    random: Pcg64,
    converter: ScanConverter,
}

impl Pairs {
    /// Pairs in a kind of world, with `beams` beams over 270 degrees and a range noise of 1 cm.
    pub fn new(world: RandomWorld, beams: u32, seed: u64) -> Self {
        let lidar = LidarKnobs { beams, range_resolution: 0.0, laser_in_base: Pose2::IDENTITY, ..LidarKnobs::default() };
        Self { world, lidar, random: Pcg64::seed_from_u64(seed), converter: ScanConverter::default() }
    }

    fn sample(&mut self) -> Result<ScanPair, ScanError> {
        let random = &mut self.random;
        let Surroundings { walls, map_from_laser } = self.world.sample(random);
        let reference_from_sensed = motion(random);
        let first_guess = with_noise(&reference_from_sensed, random);
        let mut lidar = Lidar::new(&self.lidar, Pcg64::from_rng(random));
        let mut scan_at = |map_from_laser: Pose2| lidar.scan(|_| &walls, |_| map_from_laser, Stamp::default());
        let (before, after) = (scan_at(map_from_laser), scan_at(map_from_laser * reference_from_sensed));
        let mut convert = |message: &LaserScan| self.converter.convert(message, false);
        let (reference, sensed) = (convert(&before)?, convert(&after)?);
        let in_map = map_from_laser * reference_from_sensed;
        let known = information::scan_information(&walls, &in_map, sensed.beams(), self.lidar.noise, self.lidar.range_max);
        let rotation = nalgebra::Rotation3::from_axis_angle(&nalgebra::Vector3::z_axis(), -map_from_laser.theta);
        Ok(ScanPair {
            reference,
            sensed,
            reference_from_sensed,
            first_guess,
            information: rotation * known * rotation.transpose(),
        })
    }
}

impl Iterator for Pairs {
    type Item = ScanPair;

    /// Never ends. Positions with too few measurements for a scan are skipped.
    fn next(&mut self) -> Option<ScanPair> {
        (0..u32::MAX).find_map(|_| self.sample().ok())
    }
}

/// Random motion of a driving car from one scan to the next.
fn motion(random: &mut Pcg64) -> Pose2 {
    let (rate, speed, yaw_rate) = DRIVES[random.random_range(0..DRIVES.len())];
    let twist = Twist2 { vx: random.random_range(0.0..speed), vy: 0.0, omega: random.random_range(-yaw_rate..yaw_rate) };
    twist.motion(rate.recip())
}

fn with_noise(pose: &Pose2, random: &mut Pcg64) -> Pose2 {
    let [x, y, theta]: [f64; 3] = std::array::from_fn(|_| StandardNormal.sample(random));
    let along_axis = GUESS_TRANSLATION * std::f64::consts::FRAC_1_SQRT_2;
    Pose2::new(pose.x + along_axis * x, pose.y + along_axis * y, pose.theta + GUESS_ROTATION.to_radians() * theta)
}
