//! A simulated laser scanner.

use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;

use crate::geometry::{Point, Pose2};
use crate::knobs;
use crate::knobs::Seconds;
use crate::messages::sensor_msgs::LaserScan;
use crate::messages::std_msgs::Header;
use crate::scan::BeamGeometry;
use crate::time::Stamp;

use super::rays::Rays;
use super::world::World;

knobs! {
    /// The simulated laser scanner.
    pub struct LidarKnobs {
        /// Number of rays of a scan.
        beams: u32 = 1081, in 10 to 10000;
        /// Angle between the first and the last ray; at 360 the last ray is one step before the first.
        field_of_view: f64 = 270.0, in 10 to 360, unit "deg";
        /// At 360 degrees: the last ray coincides with the first, as in `racecar_simulator`, instead of being one step before it.
        overlap: bool = false;
        /// Scans per second.
        rate: f64 = 40.0, in 0.1 to 1000, unit "Hz";
        /// Minimum range; closer walls give -inf (REP 117).
        range_min: f64 = 0.06, in 0 to 10, unit "m";
        /// Maximum range; rays without a hit within it give inf (REP 117).
        range_max: f64 = 30.0, in 0.5 to 1000, unit "m";
        /// Standard deviation of the ranges.
        noise: f64 = 0.01, in 0 to 1, unit "m";
        /// Ranges are rounded to multiples of this; 0: not rounded.
        range_resolution: f64 = 0.001, in 0 to 1, unit "m";
        /// Time from the first ray of a scan to the last. 0: instantaneous scans without motion distortion.
        scan_duration: Seconds = Seconds(0.0), in 0 to 10, unit "s";
        /// Pose of the laser in `base_link`.
        laser_in_base: Pose2 = Pose2::new(0.275, 0.0, 0.0), unit "m, m, rad";
    }
}

/// Frame of the laser.
pub const LASER_FRAME: &str = "laser";

/// A laser scanner on a car.
#[derive(Clone, Debug)]
pub struct Lidar<'a> {
    knobs: &'a LidarKnobs,
    /// Constant fields of the scans, with numbers rounded to the precision of the message.
    template: LaserScan,
    beams: BeamGeometry,
    random: Pcg64,
}

impl<'a> Lidar<'a> {
    /// A scanner; `random` is its source of noise.
    #[allow(clippy::cast_possible_truncation)] // the message carries 32 bits
    pub fn new(knobs: &'a LidarKnobs, random: Pcg64) -> Self {
        let beams = f64::from(knobs.beams);
        let view = knobs.field_of_view.to_radians();
        let steps = if knobs.field_of_view < 360.0 || knobs.overlap { beams - 1.0 } else { beams };
        let angle_min = (-0.5 * view) as f32;
        let angle_increment = (view / steps) as f32;
        let template = LaserScan {
            header: Header { frame_id: LASER_FRAME.into(), ..Header::default() },
            angle_min,
            angle_max: angle_min + angle_increment * (beams - 1.0) as f32,
            angle_increment,
            time_increment: (knobs.scan_duration.0 / (beams - 1.0)) as f32,
            scan_time: knobs.rate.recip() as f32,
            range_min: knobs.range_min as f32,
            range_max: knobs.range_max as f32,
            ..LaserScan::default()
        };
        // The beams are computed from the rounded fields, as a reader of the message does.
        let beams = BeamGeometry::new(angle_min.into(), angle_increment.into(), knobs.beams as usize);
        Self { knobs, template, beams, random }
    }

    /// Time from the first ray of a scan to the last, s.
    pub fn sweep_time(&self) -> f64 {
        self.ray_time(self.beams.len() - 1)
    }

    fn ray_time(&self, ray: usize) -> f64 {
        ray as f64 * f64::from(self.template.time_increment)
    }

    /// Takes a scan with the stamp `stamp`, the time of its first ray. `world` and `map_from_base` give the world and the pose of
    /// the car as functions of the time since then, s.
    pub fn scan<W: World>(&mut self, world: impl Fn(f64) -> W, map_from_base: impl Fn(f64) -> Pose2, stamp: Stamp) -> LaserScan {
        let laser = |after| map_from_base(after) * self.knobs.laser_in_base;
        let range_max = self.knobs.range_max;
        let distances = if self.sweep_time() > 0.0 {
            let distance = |(ray, &direction): (usize, &Point)| {
                let after = self.ray_time(ray);
                let laser = laser(after);
                world(after).range(laser.translation(), laser.transform().rotate(direction), range_max)
            };
            self.beams.directions().iter().enumerate().map(distance).collect()
        } else {
            world(0.0).ranges(&Rays::new(&self.beams, &laser(0.0)), range_max)
        };
        let mut scan = self.template.clone();
        scan.header.stamp = stamp.into();
        scan.ranges = distances.into_iter().map(|distance| self.measurement(distance)).collect();
        scan
    }

    /// The measured range of a wall at `distance`; `None`: no hit.
    #[allow(clippy::cast_possible_truncation)] // the message carries 32 bits
    fn measurement(&mut self, distance: Option<f64>) -> f32 {
        let error: f64 = StandardNormal.sample(&mut self.random);
        let Some(distance) = distance else { return f32::INFINITY };
        let measured = round_to(distance + self.knobs.noise * error, self.knobs.range_resolution);
        if measured > self.knobs.range_max {
            f32::INFINITY
        } else if measured < self.knobs.range_min {
            f32::NEG_INFINITY
        } else {
            measured as f32
        }
    }
}

/// Rounds to the nearest multiple of `step`; 0: does not round.
fn round_to(value: f64, step: f64) -> f64 {
    if step > 0.0 { (value / step).round() * step } else { value }
}
