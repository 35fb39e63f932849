//! A particle filter that localizes a robot on a map (Monte Carlo localization; Dellaert et al., 1999).
//!
//! [`filter::ParticleFilter`] is predicted by [`motion`] and corrected by an [`observation`] through the beam model of
//! [`sensor`]. It is deterministic for its seed: the same calls give bit-identical results on any number of threads.

#![allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // particles are in single precision, within the map

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
        /// The map: a YAML file of `map_server`; unset: the node uses the one on the topic `map`.
        map: Option<String> = None;
        /// Initial pose of the base on the map, `[x, y, yaw]`; unset: unknown, global localization.
        initial_pose: Option<Pose2> = None, unit "m, m, rad";
        /// If set, a timer with this period triggers the updates, each with odometry and the latest scan, if that is new; 0:
        /// every scan triggers an update.
        update_period: Seconds = Seconds(0.0), in 0 to 10, unit "s";
        /// Number of particles while the robot is localized.
        particles: u32 = 4000, in 10 to 1_000_000;
        /// Minimum number of particles while the cloud is compact (KLD sampling); unset: always `particles`.
        min_particles: Option<u32> = None, in 10 to 1_000_000;
        /// Initial number of particles of the global search; it falls as the cloud contracts (KLD sampling). The search processes
        /// one scan over several updates.
        global_particles: u32 = 100_000, in 100 to 10_000_000;
        /// KLD sampling: maximum error of the distribution.
        kld_error: f64 = 0.05, in 0.001 to 1;
        /// Resample when the effective number of particles falls below this fraction of all particles.
        resample_below: f64 = 0.5, in 0 to 1;
        /// Minimum fraction of effective particles after a scan: the likelihood of a scan that would leave fewer is tempered
        /// until it leaves as many.
        least_effective: f64 = 0.02, in 0 to 0.5;
        /// The same for the global search: no hypothesis is dropped too early.
        global_least_effective: f64 = 0.2, in 0 to 0.5;
        /// The global search starts, beside tracking, when the map explains a fraction of the beams below this factor times its
        /// long-term average. The pose is replaced only by one that explains the scans clearly better. 0: never.
        recover_below: f64 = 0.85, in 0 to 1;
        /// Standard deviation of the position of an initial pose without covariance.
        initial_position_error: f64 = 0.3, in 0 to 100, unit "m";
        /// Standard deviation of its heading.
        initial_heading_error: f64 = 10.0, in 0 to 180, unit "deg";
        /// Ray casting method; unset: `table` if it needs at most 256 MB, else `cddt`.
        ray_casting: Option<RayCasting> = None;
        /// Number of threads; 0: one per core. The result does not depend on it.
        threads: u32 = 0, in 0 to 256;
        /// Seed of the random numbers.
        seed: u32 = 1;
    }
}

impl LocalizationKnobs {
    /// The timer that triggers the updates, first one period after `now`; `None`: the scans do.
    pub fn timer(&self, now: Duration) -> Option<Timer> {
        let period = Duration::try_from_secs_f64(self.update_period.0).ok().filter(|period| !period.is_zero())?;
        Some(Timer::new(period, now + period))
    }
}
