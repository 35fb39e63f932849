//! The filter itself.

use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};

use super::LocalizationKnobs;
use super::estimate;
use super::evidence::Evidence;
use super::motion::{MotionKnobs, UncertainMotion};
use super::observation::Observation;
use super::particles::{Particles, effective_number, relative};
use super::recovery::Fit;
use super::resampling::{kld_count, low_variance};
use super::search::Search;
use super::sensor::{BeamTable, SensorKnobs, expected_fit};
use super::streams::{CHUNK, Streams};
use super::update::{Update, particles_for};
use crate::anytime::Driver;
use crate::geometry::{Pose2, PoseCovariance, wrap_angle};
use crate::map::grid::OccupancyGrid;
use crate::map::indoors::indoor_cells;
use crate::matching::StopReason;
use crate::parallel::Workers;
use crate::raycasting::{Fan, RayCaster, RayCasting, Viewpoint, turn};

/// While the robot may be anywhere, each particle is moved by so much when chosen: no two shall stand for the same pose. Cells, rad.
const ROUGHENING: (f32, f32) = (1.0, 0.02);
/// Then there are at least so many times as many particles as usual: places that are as likely as others shall not be given up by chance.
const EXPLORERS: usize = 10;
/// Standard deviation of the position within which the robot knows where it is, m,
const LOCALIZED: f64 = 0.3;
/// if the cluster has this part of the weight.
const LOCALIZED_SHARE: f64 = 0.9;

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
    /// Beams of the last scan that have been taken in.
    pub beams: usize,
    /// Likelihood of these, per beam.
    pub fit: f64,
    /// Whether the robot is still looked for: it may be elsewhere.
    pub is_sought: bool,
}

impl Belief {
    /// Whether the robot knows where it is.
    pub fn is_localized(&self) -> bool {
        !self.is_sought && self.share > LOCALIZED_SHARE && self.is_compact()
    }

    /// Whether the pose is one place.
    pub(super) fn is_compact(&self) -> bool {
        (self.covariance.m11 + self.covariance.m22).sqrt() < LOCALIZED
    }
}

/// A particle filter on one map.
pub struct ParticleFilter {
    knobs: LocalizationKnobs,
    motion: MotionKnobs,
    beams: BeamTable,
    /// The model while the robot may be anywhere.
    global_beams: BeamTable,
    /// What scans fit where the robot is, as the model says, and the model while it may be anywhere.
    expected_fit: f64,
    expected_global_fit: f64,
    squash: f64,
    caster: Box<dyn RayCaster>,
    grid: OccupancyGrid,
    /// Where a robot can be.
    indoors: Vec<usize>,
    workers: Workers,
    streams: Streams,
    particles: Particles,
    /// The next generation, while it is made.
    chosen: Particles,
    /// The scan that is being taken in, or was last.
    evidence: Evidence,
    /// What it leads to believe so far, the logarithms of the weights then, and the power to which its likelihood is taken for that.
    belief: Option<Belief>,
    posterior: Vec<f32>,
    power: f64,
    /// Particles that there is time for.
    affordable: usize,
    /// While the robot may be anywhere.
    search: Option<Search>,
    fit: Fit,
}

impl ParticleFilter {
    /// A filter whose robot may be anywhere in the map. Fails when the system gives no threads.
    pub fn new(
        map: OccupancyGrid,
        knobs: &LocalizationKnobs,
        motion: &MotionKnobs,
        sensor: &SensorKnobs,
    ) -> std::io::Result<Self> {
        let mut filter = Self {
            knobs: knobs.clone(),
            motion: motion.clone(),
            beams: BeamTable::new(sensor, map.resolution()),
            global_beams: BeamTable::new(&sensor.global(), map.resolution()),
            expected_fit: expected_fit(sensor, sensor),
            expected_global_fit: expected_fit(sensor, &sensor.global()),
            squash: sensor.squash,
            caster: knobs
                .ray_casting
                .unwrap_or_else(|| RayCasting::fastest_for(&map))
                .caster(&map, sensor.max_range / map.resolution()),
            indoors: indoor_cells(&map),
            grid: map,
            workers: Workers::new(knobs.threads as usize)?,
            streams: Streams::new(knobs.seed),
            particles: Particles::default(),
            chosen: Particles::default(),
            evidence: Evidence::default(),
            belief: None,
            posterior: Vec::new(),
            power: 0.0,
            affordable: usize::MAX,
            search: None,
            fit: Fit::default(),
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
        self.start_about(map_from_base, &given.unwrap_or_else(|| PoseCovariance::from_diagonal(&deviations)));
    }

    /// The robot is near this position; of its heading nothing is known.
    pub fn start_in_place(&mut self, map_from_base: &Pose2) {
        let position = self.knobs.initial_position_error;
        self.start_about(map_from_base, &PoseCovariance::from_diagonal(&nalgebra::Vector3::new(position, position, 0.0)));
        let mut random = self.streams.next()(0);
        self.particles.theta.fill_with(|| random.random_range(-std::f32::consts::PI..std::f32::consts::PI));
    }

    /// `root` times normal numbers is what the pose may be off.
    fn start_about(&mut self, map_from_base: &Pose2, root: &PoseCovariance) {
        let mut random = self.streams.next()(0);
        self.belief = None;
        self.particles.clear();
        for _ in 0..self.knobs.particles {
            let off = root * nalgebra::Vector3::from_fn(|_, _| StandardNormal.sample(&mut random));
            let pose = Pose2::new(map_from_base.x + off.x, map_from_base.y + off.y, map_from_base.theta + off.z);
            let pose = self.grid.pose_in_cells(&pose);
            self.particles.push([pose.x as f32, pose.y as f32, pose.theta as f32], 0.0);
        }
        self.search = None;
        self.fit = Fit::default();
    }

    /// The robot may be anywhere.
    pub fn spread(&mut self) {
        self.belief = None;
        self.particles.clear();
        self.scatter(self.knobs.global_particles as usize, 0.0);
        self.begin_search(self.expected_fit);
    }

    /// Where the robot is, scans will fit as well as `usual`, once it is found.
    fn begin_search(&mut self, usual: f64) {
        self.fit = Fit::expecting(usual);
        self.search = Some(Search::expecting(self.expected_global_fit * (usual / self.expected_fit).min(1.0)));
    }

    /// Puts so many particles where a robot could be, for practice, and tells what it would see there. What is believed means nothing
    /// until [`Self::begin_anew`].
    pub fn practise(&mut self, particles: u32, beams: usize) -> Observation {
        let mut random = self.streams.next()(0);
        let place = if self.indoors.is_empty() { 0 } else { self.indoors[random.random_range(0..self.indoors.len())] };
        let place = self.grid.centre(place % self.grid.width(), place / self.grid.width());
        let pose = Pose2::new(place.x, place.y, 0.0);
        self.start_at(&pose, None);
        self.resample(particles as usize);
        let angles: Vec<f64> = (0..beams).map(|k| k as f64 * 4.7 / beams as f64 - 2.35).collect();
        let ranges = self.expected_ranges(&pose, angles.iter().copied());
        Observation::of(angles, ranges)
    }

    /// Forgets everything: as new.
    pub fn begin_anew(&mut self) {
        self.streams = Streams::new(self.knobs.seed);
        self.affordable = usize::MAX;
        self.spread();
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
        if let Some(search) = &mut self.search {
            search.moved(motion);
        }
        let motion = UncertainMotion::new(&self.motion, motion, seconds);
        let (per_metre, streams) = (self.grid.resolution().recip(), self.streams.next());
        let Particles { x, y, theta, .. } = &mut self.particles;
        let chunks = x.chunks_mut(CHUNK).zip(y.chunks_mut(CHUNK)).zip(theta.chunks_mut(CHUNK));
        self.workers.share(chunks, |chunk, ((x, y), theta)| {
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
    }

    /// Gives up particles if there are too many to move them and take in a scan of `beams` beams in the time there is. To be called
    /// before the motion.
    pub fn plan(&mut self, beams: usize, driver: &Driver) {
        let wanted = if self.search.is_some() { self.len() } else { self.knobs.particles as usize };
        self.affordable = driver.outlook().map_or(usize::MAX, |outlook| particles_for(&outlook, wanted, beams));
        if self.len() > self.affordable {
            self.resample(self.affordable);
        }
    }

    /// The laser, at `base_from_laser`, has seen something: new evidence, each scan but once. As many of its beams are taken in as the
    /// driver has time for. [`Self::finish`] is to follow.
    pub fn update(&mut self, observation: Observation, base_from_laser: &Pose2, driver: &mut Driver) -> (Belief, StopReason) {
        let part = self.knobs.recover_below;
        if self.search.as_ref().map_or_else(|| self.fit.is_lost(part), |search| search.is_lost(part)) {
            self.look_everywhere();
        }
        let per_metre = self.grid.resolution().recip();
        let mount = [base_from_laser.x * per_metre, base_from_laser.y * per_metre, base_from_laser.theta].map(|v| v as f32);
        let Particles { x, y, theta, .. } = &self.particles;
        let views = x.iter().zip(y).zip(theta).map(|((&x, &y), &theta)| laser_at(x, y, theta, mount));
        self.evidence.begin(observation, views);
        let stop_reason = driver.drive(&mut Update { filter: self, is_first: true });
        (self.believe(), stop_reason)
    }

    /// What can wait until the belief is out: takes in the beams that are left, if `driver` has time for them, and chooses the
    /// particles that live on. Without an update before there is nothing to be done.
    pub fn finish(&mut self, driver: Option<&mut Driver>) {
        let Some(mut belief) = self.belief.take() else { return };
        if let (Some(driver), true) = (driver, self.next_beams() > 0) {
            driver.drive(&mut Update { filter: self, is_first: false });
            belief = self.believe();
            self.belief = None;
        }
        if self.search.is_none() && belief.beams > 0 {
            self.fit.add(belief.fit);
        }
        std::mem::swap(&mut self.particles.log_weight, &mut self.posterior);
        self.evidence.begin(Observation::default(), std::iter::empty());
        if let Some(search) = &mut self.search {
            search.used(self.power, &belief);
        }
        self.search.take_if(|search| search.is_over());
        let (count, usual) = (self.len(), self.usual_count());
        let is_off = count > usual || count < usual && self.knobs.min_particles.is_none();
        if is_off && self.search.is_none() || belief.effective < self.knobs.resample_below * count as f64 {
            self.resample(self.next_count());
        }
    }

    /// Half of the belief goes to particles all over the map.
    fn look_everywhere(&mut self) {
        let count = self.knobs.global_particles as usize;
        let largest = self.particles.log_weight.iter().copied().fold(f32::NEG_INFINITY, f32::max);
        let total: f64 = relative(&self.particles.log_weight).into_iter().map(f64::from).sum();
        self.scatter(count, largest + (total / count as f64).ln() as f32);
        self.begin_search(self.fit.usual());
    }

    /// Beams of the next step.
    pub(super) fn next_beams(&self) -> usize {
        self.evidence.next_beams().len()
    }

    /// Beams taken in.
    pub(super) fn weighed_beams(&self) -> usize {
        self.evidence.weighed()
    }

    /// Takes in some beams more.
    pub(super) fn weigh_next_beams(&mut self) {
        let beams = if self.search.is_some() { &self.global_beams } else { &self.beams };
        self.evidence.weigh_next(beams, &*self.caster, &self.workers);
    }

    /// What is to be believed by as much of the scan as has been taken in.
    pub(super) fn believe(&mut self) -> Belief {
        (self.posterior, self.power) = if self.weighed_beams() == 0 {
            (self.particles.log_weight.clone(), 0.0)
        } else {
            let (power, part) = match &self.search {
                Some(search) => (search.news(), self.knobs.global_least_effective),
                None => (1.0, self.knobs.least_effective),
            };
            self.evidence.posterior(&self.particles, power, part * self.len() as f64)
        };
        let weights = relative(&self.posterior);
        let mean = estimate::mean(&self.particles, &weights, self.grid.resolution());
        let map_from_grid = self.grid.pose_in_map(&Pose2::IDENTITY).theta;
        let (sin, cos) = map_from_grid.sin_cos();
        let turn = nalgebra::Matrix3::new(cos, -sin, 0.0, sin, cos, 0.0, 0.0, 0.0, 1.0);
        let belief = Belief {
            map_from_base: self.grid.pose_in_map(&mean.pose),
            covariance: turn * mean.covariance * turn.transpose(),
            share: mean.share,
            particles: self.len(),
            effective: effective_number(&weights),
            beams: self.weighed_beams(),
            fit: self.evidence.fit(&self.particles, self.squash).unwrap_or(0.0),
            is_sought: self.search.is_some(),
        };
        self.belief = Some(belief.clone());
        belief
    }

    /// Chooses `count` particles by their weights.
    fn resample(&mut self, count: usize) {
        let mut random = self.streams.next()(0);
        let weights = relative(&self.particles.log_weight);
        self.chosen.clear();
        for index in low_variance(&weights, count, random.random()) {
            let mut pose = self.particles.pose(index);
            if self.search.is_some() {
                for (value, deviation) in pose.iter_mut().zip([ROUGHENING.0, ROUGHENING.0, ROUGHENING.1]) {
                    let normal: f32 = StandardNormal.sample(&mut random);
                    *value += deviation * normal;
                }
            }
            self.chosen.push(pose, 0.0);
        }
        std::mem::swap(&mut self.particles, &mut self.chosen);
    }

    /// Particles when the cloud is compact.
    fn usual_count(&self) -> usize {
        let times = if self.search.is_some() { EXPLORERS } else { 1 };
        (self.knobs.particles as usize * times).min(self.affordable)
    }

    /// How many particles the next generation has.
    fn next_count(&self) -> usize {
        let (now, usual) = (self.len(), self.usual_count());
        let least = self.knobs.min_particles.filter(|_| self.search.is_none()).map_or(usual, |least| (least as usize).min(usual));
        if now <= usual && least == usual {
            return usual;
        }
        let weights = relative(&self.particles.log_weight);
        let chosen = low_variance(&weights, now, 0.5);
        kld_count(&self.particles, chosen, self.grid.resolution() as f32, self.knobs.kld_error).clamp(least, now.max(usual))
    }

    /// Number of particles.
    pub(super) fn len(&self) -> usize {
        self.particles.len()
    }

    /// What a laser at `map_from_laser` would see in the map at these angles, rad: lengths, m; infinite where nothing is in reach.
    pub fn expected_ranges(&self, map_from_laser: &Pose2, angles: impl IntoIterator<Item = f64>) -> Vec<f64> {
        let fan = Fan::new(angles);
        let mut lengths = vec![0.0; fan.len()];
        self.caster.cast(&[Viewpoint::new(&self.grid.pose_in_cells(map_from_laser))], &fan, &mut lengths);
        lengths.into_iter().map(|length| f64::from(length) * self.grid.resolution()).collect()
    }

    /// The map.
    pub fn map(&self) -> &OccupancyGrid {
        &self.grid
    }

    /// Poses of the particles, in the map.
    pub fn poses(&self) -> impl ExactSizeIterator<Item = Pose2> + '_ {
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
