//! A particle filter: where a robot is on a map (Monte Carlo localization; Dellaert et al., 1999).
//!
//! [`filter::ParticleFilter`] is moved by [`motion`] and corrected by an [`observation`] through the beam model of [`sensor`]. It
//! keeps to its seed: the same calls give the same answers, bit for bit, on any number of threads.

#![allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // particles live in single precision, within the map

mod agreement;
pub mod estimate;
mod evidence;
pub mod filter;
mod model;
pub mod motion;
pub mod observation;
mod particles;
mod recovery;
mod resampling;
mod search;
pub mod sensor;
mod streams;
mod update;
mod view;

use std::time::Duration;

use crate::anytime::timer::Timer;
use crate::geometry::Pose2;
use crate::knobs::Seconds;
use crate::raycasting::RayCasting;

crate::knobs! {
    /// The particle filter.
    pub struct LocalizationKnobs {
        /// The map: a YAML file of `map_server`; unset: the node takes the one on the topic `map`.
        map: Option<String> = None;
        /// Where the base is at the start, `[x, y, yaw]` on the map; unset: it may be anywhere.
        initial_pose: Option<Pose2> = None, unit "m, m, rad";
        /// A timer with this period drives the updates, each with the latest scan, if it is new, and odometry; 0: every scan does.
        update_period: Seconds = Seconds(0.0), in 0 to 10, unit "s";
        /// Particles, when the robot knows where it is.
        particles: u32 = 4000, in 10 to 1_000_000;
        /// While the cloud is compact, as few as this will do (KLD sampling); unset: always `particles`.
        min_particles: Option<u32> = None, in 10 to 1_000_000;
        /// Particles to begin with when the robot may be anywhere; their number falls as the cloud contracts (KLD sampling). They take in a scan
        /// in the course of several updates.
        global_particles: u32 = 100_000, in 100 to 10_000_000;
        /// KLD sampling: bound on the error of the distribution.
        kld_error: f64 = 0.05, in 0.001 to 1;
        /// Resample when the effective number of particles falls below this part of them.
        resample_below: f64 = 0.5, in 0 to 1;
        /// A scan that would leave a smaller part of the particles effective is believed less, until it leaves so many.
        least_effective: f64 = 0.02, in 0 to 0.5;
        /// The same while the robot may be anywhere: no place is given up in haste.
        global_least_effective: f64 = 0.2, in 0 to 0.5;
        /// The robot is looked for all over the map, too, when the map explains a smaller part of the beams than this part of what it uses
        /// to; it is taken to be elsewhere only once that explains the scans decidedly better. 0: never.
        recover_below: f64 = 0.85, in 0 to 1;
        /// How far an initial pose without covariance may be off.
        initial_position_error: f64 = 0.3, in 0 to 100, unit "m";
        /// How far its heading may be off.
        initial_heading_error: f64 = 10.0, in 0 to 180, unit "deg";
        /// How the lengths of beams are found; unset: `table` where it takes at most 256 MB, else `cddt`.
        ray_casting: Option<RayCasting> = None;
        /// Threads; 0: one for each core. The answer does not depend on it.
        threads: u32 = 0, in 0 to 256;
        /// Another seed: other random numbers.
        seed: u32 = 1;
    }
}

impl LocalizationKnobs {
    /// The timer that drives the updates, for the first time one period after `now`; `None`: the scans do.
    pub fn timer(&self, now: Duration) -> Option<Timer> {
        let period = Duration::try_from_secs_f64(self.update_period.0).ok().filter(|period| !period.is_zero())?;
        Some(Timer::new(period, now + period))
    }
}
