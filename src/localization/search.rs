//! The global search for a robot that may be anywhere: many particles process one scan after another, each over several updates.
//!
//! The work of one update is bounded ([`RAYS_PER_SECOND`]). While a scan is being processed, the particles stay at the robot's
//! pose of that scan; they catch up with the motion since then at the next scan. A scan is evidence only as far as the robot's
//! motion has made it new, so that the skipped scans are no loss.

use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};

use super::agreement::MIN_EXPLAINED_BY_CANDIDATE;
use super::estimate::{self, Belief};
use super::evidence::{fit, posterior};
use super::model::Model;
use super::motion::UncertainMotion;
use super::observation::Observation;
use super::particles::{Particles, is_near, relative};
use super::recovery::Fit;
use super::resampling::{kld_count, low_variance};
use super::sensor::expected_fit;
use super::streams::{CHUNK, Step, Streams};
use super::view::View;
use crate::geometry::Pose2;

/// Maximum work per second of the robot's time, in rays: a fifth of what one core casts on a whole map (`cargo bench --bench
/// raycasting`).
const RAYS_PER_SECOND: f64 = 10e6;
/// Maximum time whose work is done in one update, and the time assumed if it is unknown, s.
const PERIOD: (f64, f64) = (0.1, 0.025);
/// Chunks of particles processed before the clock is read again.
const CHUNKS_PER_STEP: usize = 4;
/// Cost of weighting or resampling a particle beside ray casting, in rays.
const RAYS_PER_PARTICLE: usize = 4;
/// Motion after which a scan is independent evidence, m and rad: scans from nearer poses show the same again and are together no
/// more evidence than one.
const VIEW: View = View { distance: 0.5, rotation: 0.5 };
/// Minimum novelty of a scan that is processed, as a fraction of an independent scan.
const MIN_NOVELTY: f64 = 0.1;
/// Standard deviation of the noise added when resampling, so that no two particles have the same pose: cells, rad.
const ROUGHENING: (f32, f32) = (1.0, 0.02);
/// Minimum number of particles, as a multiple of that for tracking: equally likely hypotheses must not be lost by chance.
const MIN_PARTICLE_FACTOR: u32 = 10;
/// Fit, relative to what the model expects at the right pose, below which all hypotheses are wrong.
const MIN_RELATIVE_FIT: f64 = 0.7;
/// Minimum fraction of the total weight of a hypothesis without a competing one.
const MIN_UNIQUE_SHARE: f64 = 0.99;
/// Distance that the robot must drive with one hypothesis and no competing one before it is accepted, m. In corridors, several
/// places look alike for a while.
const MIN_UNIQUE_DISTANCE: f64 = 2.0;

/// The next stage of the work.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Stage {
    /// Waiting for a scan with enough novelty.
    Wait,
    /// The particles from this index on must be moved and compared with the scan.
    Weigh(usize),
    /// The scan has been compared with all particles.
    Conclude,
    /// The particles must be resampled.
    Resample,
    /// More particles are needed all over the map.
    Scatter,
}

/// A motion of the robot and its duration, s.
#[derive(Clone, Copy, Debug, Default)]
struct TimedMotion {
    motion: Pose2,
    seconds: f64,
}

impl TimedMotion {
    fn add(&mut self, motion: &Pose2, seconds: f64) {
        self.motion = self.motion * *motion;
        self.seconds += seconds;
    }
}

/// How long one hypothesis has been without a competing one.
#[derive(Clone, Copy, Debug, Default)]
struct UniqueHypothesis {
    /// Distance driven, m.
    distance: f64,
    /// Number of scans.
    scans: f64,
    /// Sum of the explained fractions of these scans.
    explained: f64,
}

/// The state of the global search.
#[derive(Debug)]
pub(super) struct Search {
    particles: Particles,
    resampled: Particles,
    log_likelihoods: Vec<f32>,
    stage: Stage,
    /// The scan being processed.
    scan: Observation,
    base_from_laser: Pose2,
    /// Motion of the robot from the pose of the particles to that scan.
    before: TimedMotion,
    /// Motion of the robot since then; all motion while no scan is being processed.
    since: TimedMotion,
    step: Step,
    /// Evidence not used yet, as a fraction of an independent scan; it grows with the robot's motion.
    novelty: f64,
    /// Evidence of the scan being processed.
    scan_novelty: f64,
    unique: UniqueHypothesis,
    fit: Fit,
    /// The belief after the last processed scan, moved along with odometry since then.
    belief: Option<Belief>,
    /// Number of rays that may still be cast in this update.
    allowance: f64,
    /// Number of rays cast so far.
    rays: u64,
}

impl Search {
    /// Starts with particles all over the map.
    pub(super) fn new(model: &Model, streams: &mut Streams) -> Self {
        let mut particles = Particles::default();
        model.scatter(&mut particles, model.knobs.global_particles as usize, 0.0, streams.next());
        Self {
            particles,
            resampled: Particles::default(),
            log_likelihoods: Vec::new(),
            stage: Stage::Wait,
            scan: Observation::default(),
            base_from_laser: Pose2::IDENTITY,
            before: TimedMotion::default(),
            since: TimedMotion::default(),
            step: Step::default(),
            novelty: 1.0,
            scan_novelty: 0.0,
            unique: UniqueHypothesis::default(),
            fit: Fit::expecting(expected_fit(&model.sensor, &model.sensor.global())),
            belief: None,
            allowance: 0.0,
            rays: 0,
        }
    }

    /// Adds a motion of the robot.
    pub(super) fn add_motion(&mut self, motion: &Pose2, seconds: f64) {
        self.novelty = VIEW.novelty(self.novelty, motion, 0.0);
        self.unique.distance += motion.distance();
        self.since.add(motion, seconds);
        if let Some(belief) = &mut self.belief {
            belief.map_from_base = belief.map_from_base * *motion;
        }
    }

    /// Offers a scan taken `seconds` after the last one. It is skipped while an earlier one is being processed, or if its novelty
    /// is too low.
    pub(super) fn offer(&mut self, scan: &Observation, base_from_laser: &Pose2, seconds: f64, streams: &mut Streams) {
        let seconds = if seconds > 0.0 { seconds.min(PERIOD.0) } else { PERIOD.1 };
        self.allowance = RAYS_PER_SECOND * seconds;
        if self.stage != Stage::Wait || self.novelty < MIN_NOVELTY || scan.is_empty() {
            return;
        }
        (self.scan, self.base_from_laser) = (scan.clone(), *base_from_laser);
        (self.scan_novelty, self.novelty) = (self.novelty, 0.0);
        self.before = std::mem::take(&mut self.since);
        self.step = streams.next();
        self.log_likelihoods.clear();
        self.log_likelihoods.resize(self.particles.len(), 0.0);
        self.stage = Stage::Weigh(0);
    }

    /// Whether there is work left for this update.
    pub(super) fn has_work(&self) -> bool {
        self.stage != Stage::Wait && self.allowance > 0.0
    }

    /// Does the next step of the work.
    pub(super) fn work(&mut self, model: &Model, streams: &mut Streams) {
        let count = self.particles.len();
        let cost = match self.stage {
            Stage::Wait => 0,
            Stage::Weigh(first) => {
                let end = (first + CHUNKS_PER_STEP * CHUNK).min(count);
                self.weigh(model, first, end);
                self.stage = if end < count { Stage::Weigh(end) } else { Stage::Conclude };
                self.rays += ((end - first) * self.scan.len()) as u64;
                (end - first) * (self.scan.len() + RAYS_PER_PARTICLE)
            }
            Stage::Conclude => {
                self.stage = self.conclude(model);
                count * RAYS_PER_PARTICLE
            }
            Stage::Resample => {
                self.resample(model, streams);
                self.stage = Stage::Wait;
                count * RAYS_PER_PARTICLE
            }
            Stage::Scatter => {
                self.scatter(model, streams);
                self.stage = Stage::Wait;
                count * RAYS_PER_PARTICLE
            }
        };
        self.allowance -= cost as f64;
    }

    /// Moves some particles to the robot's pose at the scan, and computes the likelihood of the scan for them.
    fn weigh(&mut self, model: &Model, first: usize, end: usize) {
        let TimedMotion { motion, seconds } = self.before;
        let motion = (seconds > 0.0).then(|| UncertainMotion::new(&model.motion, &motion, seconds));
        let (mount, scan, step) = (model.mount(&self.base_from_laser), &self.scan, self.step);
        let Particles { x, y, theta, scale, .. } = &mut self.particles;
        let poses = x[first..end].chunks_mut(CHUNK).zip(y[first..end].chunks_mut(CHUNK)).zip(theta[first..end].chunks_mut(CHUNK));
        let poses = poses.zip(scale[first..end].chunks_mut(CHUNK));
        let tasks = poses.zip(self.log_likelihoods[first..end].chunks_mut(CHUNK));
        model.workers.for_each(tasks, |chunk, ((((x, y), theta), scale), sums)| {
            if let Some(motion) = &motion {
                model.move_chunk(motion, step, first / CHUNK + chunk, [&mut *x, &mut *y, &mut *theta, scale]);
            }
            let views: Vec<_> = (0..x.len()).map(|i| mount.view(x[i], y[i], theta[i])).collect();
            model.add_log_likelihoods(&model.global_beams, scan, &views, sums);
        });
    }

    /// Weights the particles by the scan, as far as it is new.
    fn conclude(&mut self, model: &Model) -> Stage {
        let (knobs, before) = (&model.knobs, &self.particles.log_weight);
        let (log_weights, power) = posterior(before, &self.log_likelihoods, self.scan_novelty, knobs.global_least_effective);
        let fit = fit(before, &self.log_likelihoods, model.sensor.squash, self.scan.len());
        self.particles.log_weight = log_weights;
        self.before = TimedMotion::default();
        self.novelty = (self.novelty + self.scan_novelty - power).min(1.0);
        let mut belief = estimate::belief(model, &self.particles, &relative(&self.particles.log_weight));
        belief.explained = model.explained(&self.scan, &(belief.map_from_base * self.base_from_laser));
        (belief.beams, belief.fit, belief.is_unconfirmed) = (self.scan.len(), fit, true);
        self.fit.add(fit);
        self.update_unique(&belief);
        let is_uneven = belief.effective < knobs.resample_below * self.particles.len() as f64;
        belief.map_from_base = belief.map_from_base * self.since.motion;
        self.belief = Some(belief);
        let is_large = self.particles.len() > knobs.global_particles.max(knobs.particles * MIN_PARTICLE_FACTOR) as usize;
        if is_uneven || is_large {
            Stage::Resample
        } else if self.fit.is_lost(MIN_RELATIVE_FIT) {
            Stage::Scatter
        } else {
            Stage::Wait
        }
    }

    /// Updates whether the hypothesis has a competing one.
    fn update_unique(&mut self, belief: &Belief) {
        if belief.share < MIN_UNIQUE_SHARE || !belief.is_compact() {
            self.unique = UniqueHypothesis::default();
        } else {
            self.unique.scans += 1.0;
            self.unique.explained += belief.explained;
        }
    }

    /// Gives half of the total weight to new particles all over the map, because all hypotheses were wrong.
    fn scatter(&mut self, model: &Model, streams: &mut Streams) {
        let count = model.knobs.global_particles as usize;
        let log_weights = &self.particles.log_weight;
        let largest = log_weights.iter().copied().fold(f32::NEG_INFINITY, f32::max);
        let total: f64 = relative(log_weights).into_iter().map(f64::from).sum();
        model.scatter(&mut self.particles, count, largest + (total / count as f64).ln() as f32, streams.next());
        self.fit = Fit::expecting(expected_fit(&model.sensor, &model.sensor.global()));
        self.unique = UniqueHypothesis::default();
    }

    /// Resamples the particles.
    fn resample(&mut self, model: &Model, streams: &mut Streams) {
        let mut random = streams.next().stream(0);
        let weights = relative(&self.particles.log_weight);
        self.resampled.clear();
        for index in low_variance(&weights, self.next_count(model, &weights), random.random()) {
            let mut pose = self.particles.pose(index);
            for (value, deviation) in pose.iter_mut().zip([ROUGHENING.0, ROUGHENING.0, ROUGHENING.1]) {
                let normal: f32 = StandardNormal.sample(&mut random);
                *value += deviation * normal;
            }
            self.resampled.push(pose, self.particles.scale[index], 0.0);
        }
        std::mem::swap(&mut self.particles, &mut self.resampled);
    }

    /// Number of particles of the next generation.
    fn next_count(&self, model: &Model, weights: &[f32]) -> usize {
        let (now, minimum) = (self.particles.len(), (model.knobs.particles * MIN_PARTICLE_FACTOR) as usize);
        let maximum = model.knobs.global_particles as usize;
        if now <= minimum {
            return minimum.min(maximum);
        }
        let kept = low_variance(weights, now, 0.5);
        kld_count(&self.particles, kept, model.grid.resolution() as f32, model.knobs.kld_error)
            .clamp(minimum, now.min(maximum.max(minimum)))
    }

    /// The current belief of the search.
    pub(super) fn belief(&mut self, model: &Model) -> Belief {
        let particles = &self.particles;
        let all = || Belief { is_unconfirmed: true, ..estimate::belief(model, particles, &relative(&particles.log_weight)) };
        self.belief.get_or_insert_with(all).clone()
    }

    /// Whether a scan is being processed. Otherwise all particles are of the same time.
    pub(super) fn is_busy(&self) -> bool {
        self.stage != Stage::Wait
    }

    /// The accepted hypothesis, if it had no competing one for long enough, and the fraction of the beams that it explained.
    pub(super) fn candidate(&self) -> Option<(&Belief, f64)> {
        let belief = self.belief.as_ref().filter(|_| self.unique.distance >= MIN_UNIQUE_DISTANCE && self.unique.scans > 0.0)?;
        Some((belief, self.unique.explained / self.unique.scans))
            .filter(|&(_, explained)| explained >= MIN_EXPLAINED_BY_CANDIDATE)
    }

    /// Rejects the candidate: it must be confirmed anew.
    pub(super) fn reject_candidate(&mut self) {
        self.unique = UniqueHypothesis::default();
    }

    /// Samples `count` particles of the candidate at the robot's current pose.
    pub(super) fn particles_at_candidate(&self, model: &Model, count: usize, streams: &mut Streams) -> Particles {
        let mut there = Particles::default();
        let Some(belief) = &self.belief else { return there };
        let centre = model.grid.pose_in_cells(&(belief.map_from_base * self.since.motion.inverse()));
        let mut weights = relative(&self.particles.log_weight);
        for (index, weight) in weights.iter_mut().enumerate() {
            if !is_near(self.particles.pose(index), &centre, model.grid.resolution() as f32) {
                *weight = 0.0;
            }
        }
        for index in low_variance(&weights, count, streams.next().stream(0).random()) {
            there.push(self.particles.pose(index), self.particles.scale[index], 0.0);
        }
        if self.since.seconds > 0.0 {
            let motion = UncertainMotion::new(&model.motion, &self.since.motion, self.since.seconds);
            model.move_all(&mut there, &motion, streams.next());
        }
        there
    }

    /// The particles, at the time of the last processed scan.
    pub(super) fn particles(&self) -> &Particles {
        &self.particles
    }

    /// Rays cast so far.
    pub(super) fn rays(&self) -> u64 {
        self.rays
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::PoseCovariance;
    use crate::localization::LocalizationKnobs;
    use crate::localization::motion::MotionKnobs;
    use crate::localization::sensor::SensorKnobs;
    use crate::map::grid::{Cell, OccupancyGrid};

    /// A room of 10 m by 5 m.
    fn model() -> Model {
        let is_wall = |i: usize| i.is_multiple_of(100) || i % 100 == 99 || i / 100 == 0 || i / 100 == 49;
        let cells = (0..5000).map(|i| if is_wall(i) { Cell::Occupied } else { Cell::Free }).collect();
        let grid = OccupancyGrid::new(100, 0.1, Pose2::IDENTITY, cells).unwrap();
        let knobs = LocalizationKnobs { global_particles: 20_000, particles: 1000, threads: 1, ..LocalizationKnobs::default() };
        let sensor = SensorKnobs { max_range: 12.0, ..SensorKnobs::default() };
        Model::new(grid, &knobs, &MotionKnobs::default(), &sensor).unwrap()
    }

    /// The expected scan at a pose.
    fn expected_scan(model: &Model, pose: Pose2) -> Observation {
        let angles: Vec<f64> = (0..60).map(|k| f64::from(k) * 0.1).collect();
        let ranges = model.expected_ranges(&pose, &crate::raycasting::Fan::new(angles.iter().copied()));
        Observation::of(angles, ranges)
    }

    /// Processes a scan over as many updates as necessary; returns the work of each.
    fn process(search: &mut Search, model: &Model, scan: &Observation, streams: &mut Streams) -> Vec<u64> {
        let mut work = Vec::new();
        loop {
            let before = search.rays();
            search.offer(scan, &Pose2::IDENTITY, 0.025, streams);
            while search.has_work() {
                search.work(model, streams);
            }
            work.push(search.rays() - before);
            if !search.is_busy() {
                return work;
            }
            search.add_motion(&Pose2::IDENTITY, 0.025);
        }
    }

    #[test]
    fn processing_a_scan_is_spread_over_updates_of_bounded_work() {
        let (model, mut streams) = (model(), Streams::new(1));
        let mut search = Search::new(&model, &mut streams);
        let work = process(&mut search, &model, &expected_scan(&model, Pose2::new(3.0, 2.0, 0.5)), &mut streams);
        let (limit, step) = (RAYS_PER_SECOND * 0.025, CHUNKS_PER_STEP * CHUNK * 60);
        assert!(work.len() >= 5 && work.iter().all(|&rays| rays <= limit as u64 + step as u64), "{work:?}");
        assert_eq!(work.iter().sum::<u64>(), 20_000 * 60, "every particle, once");
    }

    #[test]
    fn a_robot_at_rest_gets_no_new_evidence_and_is_not_localized() {
        let (model, mut streams) = (model(), Streams::new(1));
        let (mut search, scan) = (Search::new(&model, &mut streams), expected_scan(&model, Pose2::new(3.0, 2.0, 0.5)));
        for _ in 0..100 {
            process(&mut search, &model, &scan, &mut streams);
        }
        let rays = search.rays();
        process(&mut search, &model, &scan, &mut streams);
        assert!(search.novelty < MIN_NOVELTY && search.candidate().is_none() && search.rays() == rays, "{}", search.novelty);
        search.add_motion(&Pose2::new(0.2, 0.0, 0.0), 0.1);
        assert!((search.novelty - 0.4).abs() < MIN_NOVELTY);
    }

    #[test]
    fn a_hypothesis_is_accepted_once_it_is_unique_for_a_while_and_explains_the_scans() {
        let (model, mut streams) = (model(), Streams::new(1));
        let drive = |explained: f64, shares: &[f64]| {
            let mut search = Search::new(&model, &mut Streams::new(1));
            for &share in shares {
                search.add_motion(&Pose2::new(0.5, 0.0, 0.0), 0.1);
                let belief = Belief { covariance: PoseCovariance::identity() * 1e-4, share, explained, ..search.belief(&model) };
                search.update_unique(&belief);
            }
            search.candidate().is_some()
        };
        assert!(!drive(0.9, &[0.8, 1.0, 1.0, 1.0]) && drive(0.9, &[0.8, 1.0, 1.0, 1.0, 1.0]));
        assert!(!drive(0.9, &[0.8, 1.0, 1.0, 0.9, 1.0]) && !drive(0.5, &[1.0; 9]));
        // The cloud of the candidate is moved to the robot's current pose.
        let mut search = Search::new(&model, &mut streams);
        assert_eq!(search.particles_at_candidate(&model, 100, &mut streams).len(), 0, "no belief yet");
        search.belief(&model);
        assert_eq!(search.particles_at_candidate(&model, 100, &mut streams).len(), 100);
    }
}
