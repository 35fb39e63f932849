//! The filter itself.

use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;
use rayon::{ThreadPool, ThreadPoolBuildError, ThreadPoolBuilder};

use super::LocalizationKnobs;
use super::estimate;
use super::motion::{MotionKnobs, UncertainMotion};
use super::observation::Observation;
use super::particles::{Particles, effective_number};
use super::recovery::Fit;
use super::resampling::{kld_count, low_variance};
use super::sensor::{BeamTable, SensorKnobs, expected_fit};
use super::streams::{CHUNK, Streams};
use crate::geometry::{Pose2, PoseCovariance, wrap_angle};
use crate::map::grid::OccupancyGrid;
use crate::map::indoors::indoor_cells;
use crate::raycasting::{RayCaster, Viewpoint, turn};

/// While the robot may be anywhere, each particle is moved by so much when chosen: no two shall stand for the same pose. Cells, rad.
const ROUGHENING: (f32, f32) = (1.0, 0.02);
/// Standard deviation of the position within which the robot knows where it is, m,
const LOCALIZED: f64 = 0.3;
/// if the cluster has this part of the weight.
const LOCALIZED_SHARE: f64 = 0.9;
/// Halvings in the search for the exponent by which a scan is believed less.
const HALVINGS: usize = 12;

/// What the filter believes.
#[derive(Clone, Debug, PartialEq)]
pub struct Belief {
    /// Where the robot is.
    pub map_from_base: Pose2,
    /// How sure that is, in the map frame.
    pub covariance: PoseCovariance,
    /// Part of the weight that agrees with it.
    pub share: f64,
    /// Number of particles.
    pub particles: usize,
    /// How many particles of equal weight would say as much.
    pub effective: f64,
    /// Likelihood of the last scan, per beam.
    pub fit: f64,
}

impl Belief {
    /// Whether the robot knows where it is.
    pub fn is_localized(&self) -> bool {
        self.share > LOCALIZED_SHARE && (self.covariance.m11 + self.covariance.m22).sqrt() < LOCALIZED
    }
}

/// A particle filter on one map.
pub struct ParticleFilter {
    knobs: LocalizationKnobs,
    motion: MotionKnobs,
    beams: BeamTable,
    /// The model while the robot may be anywhere.
    global_beams: BeamTable,
    /// What scans fit where the robot is, as the model says.
    expected_fit: f64,
    squash: f64,
    caster: Box<dyn RayCaster>,
    grid: OccupancyGrid,
    /// Where a robot can be.
    indoors: Vec<usize>,
    pool: ThreadPool,
    streams: Streams,
    particles: Particles,
    /// The next generation, while it is made.
    chosen: Particles,
    weights: Vec<f32>,
    log_likelihoods: Vec<f32>,
    /// Whether the robot may be anywhere.
    exploring: bool,
    fit: Fit,
    last_fit: f64,
}

impl ParticleFilter {
    /// A filter whose robot may be anywhere in the map. Fails when the system gives no threads.
    pub fn new(
        map: OccupancyGrid,
        knobs: &LocalizationKnobs,
        motion: &MotionKnobs,
        sensor: &SensorKnobs,
    ) -> Result<Self, ThreadPoolBuildError> {
        let mut filter = Self {
            knobs: knobs.clone(),
            motion: motion.clone(),
            beams: BeamTable::new(sensor, map.resolution()),
            global_beams: BeamTable::global(sensor, map.resolution()),
            expected_fit: expected_fit(sensor),
            squash: sensor.squash,
            caster: knobs.ray_casting.caster(&map, sensor.max_range / map.resolution()),
            indoors: indoor_cells(&map),
            grid: map,
            pool: ThreadPoolBuilder::new().num_threads(knobs.threads as usize).build()?,
            streams: Streams::new(knobs.seed),
            particles: Particles::default(),
            chosen: Particles::default(),
            weights: Vec::new(),
            log_likelihoods: Vec::new(),
            exploring: true,
            fit: Fit::default(),
            last_fit: 0.0,
        };
        filter.spread();
        Ok(filter)
    }

    /// The robot is near `map_from_base`; how near, says `covariance`, or the configuration.
    pub fn start_at(&mut self, map_from_base: &Pose2, covariance: Option<&PoseCovariance>) {
        let heading = self.knobs.initial_heading_error.to_radians();
        let position = self.knobs.initial_position_error;
        let deviations = nalgebra::Vector3::new(position, position, heading);
        let given = covariance.and_then(|covariance| covariance.cholesky()).map(|root| root.l());
        let root = given.unwrap_or_else(|| PoseCovariance::from_diagonal(&deviations));
        let mut random = self.streams.next()(0);
        self.particles.clear();
        for _ in 0..self.knobs.particles {
            let off = root * nalgebra::Vector3::from_fn(|_, _| StandardNormal.sample(&mut random));
            let pose = Pose2::new(map_from_base.x + off.x, map_from_base.y + off.y, map_from_base.theta + off.z);
            let pose = self.grid.pose_in_cells(&pose);
            self.particles.push([pose.x as f32, pose.y as f32, pose.theta as f32], 0.0);
        }
        self.exploring = false;
        self.fit = Fit::default();
    }

    /// The robot may be anywhere.
    pub fn spread(&mut self) {
        self.particles.clear();
        self.scatter(self.knobs.global_particles as usize, 0.0);
        self.exploring = true;
        self.fit = Fit::expecting(self.expected_fit);
    }

    /// Adds particles all over the map.
    fn scatter(&mut self, count: usize, log_weight: f32) {
        let mut random = self.streams.next()(0);
        for _ in 0..if self.indoors.is_empty() { 0 } else { count } {
            let cell = self.indoors[random.random_range(0..self.indoors.len())];
            let (column, row) = (cell % self.grid.width(), cell / self.grid.width());
            let (x, y) = (column as f32 + random.random::<f32>(), row as f32 + random.random::<f32>());
            let theta = (random.random::<f32>() - 0.5) * std::f32::consts::TAU;
            self.particles.push([x, y, theta], log_weight);
        }
    }

    /// The robot has moved: `motion`, seen from its start, took `seconds`.
    pub fn predict(&mut self, motion: &Pose2, seconds: f64) {
        let motion = UncertainMotion::new(&self.motion, motion, seconds);
        let (per_metre, streams) = (self.grid.resolution().recip(), self.streams.next());
        let Particles { x, y, theta, .. } = &mut self.particles;
        self.pool.install(|| {
            let chunks = x.par_chunks_mut(CHUNK).zip(y.par_chunks_mut(CHUNK)).zip(theta.par_chunks_mut(CHUNK));
            chunks.enumerate().for_each(|(chunk, ((x, y), theta))| {
                let mut random = streams(chunk);
                for ((x, y), theta) in x.iter_mut().zip(y).zip(theta) {
                    let step = motion.sample(&mut random);
                    let (sin, cos) = (*theta + step.direction as f32).sin_cos();
                    let (ahead, left) = ((step.ahead * per_metre) as f32, (step.left * per_metre) as f32);
                    *x += ahead * cos - left * sin;
                    *y += ahead * sin + left * cos;
                    *theta = wrap_angle(f64::from(*theta) + step.turn) as f32;
                }
            });
        });
    }

    /// The laser, at `base_from_laser`, has seen something: new evidence, each scan but once.
    pub fn update(&mut self, observation: &Observation, base_from_laser: &Pose2) -> Belief {
        if !self.exploring && self.fit.is_lost(self.knobs.recover_below) {
            self.look_everywhere();
        }
        if !observation.ranges.is_empty() {
            self.weigh(observation, base_from_laser);
        }
        self.particles.weights(&mut self.weights);
        let belief = self.belief();
        let particles = self.particles.len();
        self.exploring &= !belief.is_localized();
        let crowded = particles > self.knobs.particles as usize;
        if belief.effective < self.knobs.resample_below * particles as f64 || crowded {
            self.resample();
        }
        belief
    }

    /// Half of the belief goes to particles all over the map.
    fn look_everywhere(&mut self) {
        let count = self.knobs.global_particles as usize;
        self.particles.weights(&mut self.weights);
        let largest = self.particles.log_weight.iter().copied().fold(f32::NEG_INFINITY, f32::max);
        let total: f64 = self.weights.iter().map(|&weight| f64::from(weight)).sum();
        self.scatter(count, largest + (total / count as f64).ln() as f32);
        self.exploring = true;
        self.fit = Fit::expecting(self.fit.usual());
    }

    fn weigh(&mut self, observation: &Observation, base_from_laser: &Pose2) {
        let beams = if self.exploring { &self.global_beams } else { &self.beams };
        let rows = beams.rows(observation);
        let (fan, caster) = (&observation.fan, &*self.caster);
        let per_metre = self.grid.resolution().recip();
        let mount =
            [(base_from_laser.x * per_metre) as f32, (base_from_laser.y * per_metre) as f32, base_from_laser.theta as f32];
        self.log_likelihoods.resize(self.particles.len(), 0.0);
        let Particles { x, y, theta, .. } = &self.particles;
        let poses = x.par_chunks(CHUNK).zip(y.par_chunks(CHUNK)).zip(theta.par_chunks(CHUNK));
        self.pool.install(|| {
            poses.zip(self.log_likelihoods.par_chunks_mut(CHUNK)).for_each(|(((x, y), theta), results)| {
                let views: Vec<Viewpoint> =
                    x.iter().zip(y).zip(theta).map(|((&x, &y), &theta)| laser_at(x, y, theta, mount)).collect();
                let mut lengths = vec![0.0; fan.len() * views.len()];
                caster.cast(&views, fan, &mut lengths);
                results.fill(0.0);
                for (row, lengths) in rows.iter().zip(lengths.chunks_exact(views.len())) {
                    beams.add_log_likelihoods(row, lengths, results);
                }
            });
        });
        let count = rows.len();
        self.take_evidence(count);
    }

    /// Weights by the likelihoods, to a power of less than one where they would leave too few particles effective.
    fn take_evidence(&mut self, beams: usize) {
        let before = self.particles.log_weight.clone();
        let likelihoods = &self.log_likelihoods;
        let mut effective_with = |power: f32| {
            let log_weights = before.iter().zip(likelihoods).map(|(before, likelihood)| before + power * likelihood);
            self.particles.log_weight.clear();
            self.particles.log_weight.extend(log_weights);
            self.particles.weights(&mut self.weights);
            effective_number(&self.weights)
        };
        let part = if self.exploring { self.knobs.global_least_effective } else { self.knobs.least_effective };
        let least = part * before.len() as f64;
        if effective_with(1.0) < least {
            let (mut low, mut high) = (0.0, 1.0);
            for _ in 0..HALVINGS {
                let power = 0.5 * (low + high);
                *(if effective_with(power) < least { &mut high } else { &mut low }) = power;
            }
            effective_with(low);
        }
        let mean = |log_weights: &[f32], more: &[f32]| {
            let sums = log_weights.iter().enumerate().map(|(i, weight)| f64::from(weight + more.get(i).copied().unwrap_or(0.0)));
            let largest = sums.clone().fold(f64::NEG_INFINITY, f64::max);
            largest + sums.map(|sum| (sum - largest).exp()).sum::<f64>().ln()
        };
        let log_mean = mean(&before, likelihoods) - mean(&before, &[]);
        self.last_fit = (log_mean * self.squash / beams as f64).exp();
        if !self.exploring {
            self.fit.add(self.last_fit);
        }
    }

    fn belief(&self) -> Belief {
        let mean = estimate::mean(&self.particles, &self.weights, self.grid.resolution());
        let map_from_grid = self.grid.pose_in_map(&Pose2::IDENTITY).theta;
        let (sin, cos) = map_from_grid.sin_cos();
        let turn = nalgebra::Matrix3::new(cos, -sin, 0.0, sin, cos, 0.0, 0.0, 0.0, 1.0);
        Belief {
            map_from_base: self.grid.pose_in_map(&mean.pose),
            covariance: turn * mean.covariance * turn.transpose(),
            share: mean.share,
            particles: self.particles.len(),
            effective: effective_number(&self.weights),
            fit: self.last_fit,
        }
    }

    fn resample(&mut self) {
        let mut random = self.streams.next()(0);
        let count = self.next_count();
        self.chosen.clear();
        for index in low_variance(&self.weights, count, random.random()) {
            let mut pose = self.particles.pose(index);
            if self.exploring {
                for (value, deviation) in pose.iter_mut().zip([ROUGHENING.0, ROUGHENING.0, ROUGHENING.1]) {
                    let normal: f32 = StandardNormal.sample(&mut random);
                    *value += deviation * normal;
                }
            }
            self.chosen.push(pose, 0.0);
        }
        std::mem::swap(&mut self.particles, &mut self.chosen);
    }

    /// How many particles the next generation has.
    fn next_count(&self) -> usize {
        let (now, usual) = (self.particles.len(), self.knobs.particles as usize);
        let least = self.knobs.min_particles.map_or(usual, |least| (least as usize).min(usual));
        if now == usual && least == usual {
            return usual;
        }
        let chosen = low_variance(&self.weights, now, 0.5);
        kld_count(&self.particles, chosen, self.grid.resolution() as f32, self.knobs.kld_error).clamp(least, now.max(usual))
    }

    /// Poses of the particles, in the map.
    pub fn poses(&self) -> impl Iterator<Item = Pose2> + '_ {
        (0..self.particles.len()).map(|index| {
            let [x, y, theta] = self.particles.pose(index).map(f64::from);
            self.grid.pose_in_map(&Pose2::new(x, y, theta))
        })
    }
}

/// Where the laser is on a robot at a pose of the grid.
#[inline]
fn laser_at(x: f32, y: f32, theta: f32, [ahead, left, yaw]: [f32; 3]) -> Viewpoint {
    let (sin, cos) = theta.sin_cos();
    let (x, y) = (x + ahead * cos - left * sin, y + ahead * sin + left * cos);
    let heading = theta + yaw;
    let (sin, cos) = if yaw == 0.0 { (sin, cos) } else { heading.sin_cos() };
    Viewpoint { x, y, turn: turn(heading.into()), cos, sin }
}
