//! The particle filter: a cloud of particles tracks the robot; in addition, a global search runs while the robot may be
//! elsewhere.

use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};

use super::LocalizationKnobs;
use super::agreement::{Agreement, MIN_ADVANTAGE, MIN_EXPLAINED};
use super::estimate::{self, Belief};
use super::evidence::Evidence;
use super::model::Model;
use super::motion::{MotionKnobs, UncertainMotion};
use super::observation::Observation;
use super::particles::{Particles, SAME_HYPOTHESIS, relative};
use super::resampling::{kld_count, low_variance};
use super::search::Search;
use super::sensor::SensorKnobs;
use super::streams::Streams;
use super::update::{SearchWork, particles_for};
use super::view::View;
use crate::anytime::contract::Contract;
use crate::anytime::cost_model::Phase;
use crate::anytime::{AnytimeAlgorithm, ContractRunner, ErrorEstimate, RemainingBudget};
use crate::geometry::{Pose2, PoseCovariance};
use crate::map::grid::OccupancyGrid;
use crate::matching::StopReason;
use crate::raycasting::Fan;

/// Motion after which a scan is independent evidence, m and rad. Scans from nearer poses show the same parts of the same walls
/// and share the errors of the map and of ray casting, so together they are no more evidence than one. The distance is two cells
/// of a typical map.
const VIEW: View = View { distance: 0.1, rotation: 0.1 };
/// Assumed time between two scans if it is unknown, s.
const DEFAULT_PERIOD: f64 = 0.025;
/// Minimum number of beams before the covariance can satisfy an error bound: with fewer, a small covariance would be chance.
const MIN_BEAMS: usize = 8;

/// A particle filter on a map.
pub struct ParticleFilter {
    model: Model,
    streams: Streams,
    /// The cloud that tracks the robot; empty during global localization.
    particles: Particles,
    /// Buffer for the next generation while resampling.
    resampled: Particles,
    /// The current or last scan, and its likelihoods.
    evidence: Evidence,
    base_from_laser: Pose2,
    /// The belief after the beams so far.
    belief: Option<Belief>,
    /// The log-weights of that belief.
    posterior: Vec<f32>,
    /// Number of particles that the time budget allows.
    max_particles: usize,
    /// Time since the previous scan, s.
    seconds: f64,
    /// Evidence not used yet, as a fraction of an independent scan; it grows with the robot's motion.
    novelty: f64,
    /// The fraction of the scans that the pose explains, over time.
    agreement: Agreement,
    /// The global search, while the robot may be elsewhere.
    search: Option<Search>,
    /// Rays cast so far.
    rays: u64,
}

impl ParticleFilter {
    /// Starts with global localization. Fails if the system cannot start the threads.
    pub fn new(
        map: OccupancyGrid,
        knobs: &LocalizationKnobs,
        motion: &MotionKnobs,
        sensor: &SensorKnobs,
    ) -> std::io::Result<Self> {
        let mut filter = Self {
            model: Model::new(map, knobs, motion, sensor)?,
            streams: Streams::new(knobs.seed),
            particles: Particles::default(),
            resampled: Particles::default(),
            evidence: Evidence::default(),
            base_from_laser: Pose2::IDENTITY,
            belief: None,
            posterior: Vec::new(),
            max_particles: usize::MAX,
            seconds: 0.0,
            novelty: 1.0,
            agreement: Agreement::expecting(sensor.hit),
            search: None,
            rays: 0,
        };
        filter.start_globally();
        Ok(filter)
    }

    /// Restarts near `map_from_base`, with this covariance, or else with that of the configuration.
    pub fn start_at(&mut self, map_from_base: &Pose2, covariance: Option<&PoseCovariance>) {
        let heading = self.model.knobs.initial_heading_error.to_radians();
        let position = self.model.knobs.initial_position_error;
        let deviations = nalgebra::Vector3::new(position, position, heading);
        let given = covariance.and_then(|covariance| covariance.cholesky()).map(|root| root.l());
        self.start_around(map_from_base, &given.unwrap_or_else(|| PoseCovariance::from_diagonal(&deviations)));
    }

    /// Restarts near this position with unknown heading.
    pub fn start_at_position(&mut self, map_from_base: &Pose2) {
        let position = self.model.knobs.initial_position_error;
        self.start_around(map_from_base, &PoseCovariance::from_diagonal(&nalgebra::Vector3::new(position, position, 0.0)));
        let mut random = self.streams.next().stream(0);
        self.particles.theta.fill_with(|| random.random_range(-std::f32::consts::PI..std::f32::consts::PI));
    }

    /// Samples particles around a pose; `root` is the Cholesky factor of the covariance.
    fn start_around(&mut self, map_from_base: &Pose2, root: &PoseCovariance) {
        self.clear();
        let mut random = self.streams.next().stream(0);
        for _ in 0..self.model.knobs.particles {
            let error = root * nalgebra::Vector3::from_fn(|_, _| StandardNormal.sample(&mut random));
            let pose = Pose2::new(map_from_base.x + error.x, map_from_base.y + error.y, map_from_base.theta + error.z);
            let pose = self.model.grid.pose_in_cells(&pose);
            self.particles.push([pose.x as f32, pose.y as f32, pose.theta as f32], self.model.scale(&mut random), 0.0);
        }
    }

    /// Restarts with global localization.
    pub fn start_globally(&mut self) {
        self.clear();
        self.search = Some(Search::new(&self.model, &mut self.streams));
    }

    fn clear(&mut self) {
        self.novelty = 1.0;
        self.belief = None;
        self.particles.clear();
        self.agreement = Agreement::expecting(self.model.sensor.hit);
        self.search = None;
    }

    /// Places this many particles at a possible pose for warm-up, and returns the scan expected there. The belief is meaningless
    /// until [`Self::reset`].
    pub fn prepare_warm_up(&mut self, particles: u32, beams: usize) -> Observation {
        let pose = self.model.random_pose(self.streams.next());
        self.start_at(&pose, None);
        self.resample(particles as usize);
        let angles: Vec<f64> = (0..beams).map(|k| k as f64 * 4.7 / beams as f64 - 2.35).collect();
        let ranges = self.expected_ranges(&pose, angles.iter().copied());
        Observation::of(angles, ranges)
    }

    /// Restores the initial state.
    pub fn reset(&mut self) {
        self.streams = Streams::new(self.model.knobs.seed);
        self.max_particles = usize::MAX;
        self.start_globally();
    }

    /// Predicts the particles by `motion`, in the frame of its start, which took `seconds`.
    pub fn predict(&mut self, motion: &Pose2, seconds: f64) {
        self.seconds = seconds;
        // The odometry of a robot at rest may be wrong, too.
        self.novelty = VIEW.novelty(self.novelty, motion, self.model.motion.speed_error * seconds);
        if let Some(search) = &mut self.search {
            search.add_motion(motion, seconds);
        }
        let motion = UncertainMotion::new(&self.model.motion, motion, seconds);
        self.model.move_all(&mut self.particles, &motion, self.streams.next());
    }

    /// Reduces the number of particles if there is no time to move them all and to process a scan of `beams` beams. Call it
    /// before [`Self::predict`].
    pub fn plan(&mut self, beams: usize, runner: &ContractRunner) {
        let configured = self.model.knobs.particles as usize;
        self.max_particles = runner.remaining().map_or(usize::MAX, |remaining| particles_for(&remaining, configured, beams));
        if self.len() > self.max_particles {
            self.resample(self.max_particles);
        }
    }

    /// Weights the particles by a scan of the laser at `base_from_laser`; pass each scan only once. Processes as many beams as
    /// the runner has time for. The caller must then call [`Self::finish`].
    pub fn update(
        &mut self,
        observation: Observation,
        base_from_laser: &Pose2,
        runner: &mut ContractRunner,
    ) -> (Belief, StopReason) {
        if let Some(search) = &mut self.search {
            search.offer(&observation, base_from_laser, self.seconds, &mut self.streams);
        }
        self.base_from_laser = *base_from_laser;
        let mount = self.model.mount(base_from_laser);
        let Particles { x, y, theta, .. } = &self.particles;
        let views = x.iter().zip(y).zip(theta).map(|((&x, &y), &theta)| mount.view(x, y, theta));
        self.evidence.begin(observation, views);
        let stop_reason = runner.run(&mut Update { filter: self, is_first: true });
        (self.update_belief(), stop_reason)
    }

    /// Does the work that can wait until the belief is published: processes the remaining beams (if `use_all_beams`) as far as
    /// `runner` has time, resamples, and continues the global search if the robot may be elsewhere. Does nothing without a
    /// preceding update.
    pub fn finish(&mut self, use_all_beams: bool, runner: &mut ContractRunner) {
        let Some(mut belief) = self.belief.take() else { return };
        if use_all_beams && self.next_beams() > 0 {
            runner.run(&mut Update { filter: self, is_first: false });
            belief = self.update_belief();
            self.belief = None;
        }
        if !self.particles.is_empty() {
            self.resample_and_check(&belief);
        }
        self.evidence.begin(Observation::default(), std::iter::empty());
        self.continue_search(runner);
        self.seconds = 0.0;
    }

    /// Resamples if necessary, and starts or ends the global search according to how well the map explains the scans.
    fn resample_and_check(&mut self, belief: &Belief) {
        std::mem::swap(&mut self.particles.log_weight, &mut self.posterior);
        if belief.beams > 0 {
            self.novelty = 0.0;
            self.agreement = self.agreement_with(belief.explained);
        }
        let (count, typical) = (self.len(), self.typical_count());
        let is_atypical = count > typical || count < typical && self.model.knobs.min_particles.is_none();
        if is_atypical || belief.effective < self.model.knobs.resample_below * count as f64 {
            self.resample(self.next_count());
        }
        let fraction = self.model.knobs.recover_below;
        if self.search.is_none() && self.agreement.is_poor(fraction) {
            self.search = Some(Search::new(&self.model, &mut self.streams));
        } else if self.agreement.is_good(fraction) {
            self.search = None;
        }
    }

    /// Continues the global search and evaluates its result: the cloud is replaced only by a pose that explains the scans clearly
    /// better.
    fn continue_search(&mut self, runner: &mut ContractRunner) {
        let Some(search) = &mut self.search else { return };
        let rays = search.rays();
        if search.has_work() {
            // At least one step, so that there is progress even if scans follow each other without pause.
            search.work(&self.model, &mut self.streams);
            runner.run(&mut SearchWork { search, model: &self.model, streams: &mut self.streams });
        }
        self.rays += search.rays() - rays;
        let Some((candidate, explained)) = search.candidate().filter(|_| !search.is_busy()) else { return };
        let here = estimate::belief(&self.model, &self.particles, &relative(&self.particles.log_weight)).map_from_base;
        let difference = here.between(&candidate.map_from_base);
        let is_same = difference.distance() < SAME_HYPOTHESIS.0 && difference.theta.abs() < SAME_HYPOTHESIS.1;
        if !self.particles.is_empty() && is_same {
            self.agreement.accept_current_level();
            self.search = None;
        } else if self.particles.is_empty() || explained >= self.agreement.recent() + MIN_ADVANTAGE {
            self.particles = search.particles_at_candidate(&self.model, self.model.knobs.particles as usize, &mut self.streams);
            self.agreement = Agreement::expecting(self.model.sensor.hit);
            self.search = None;
        } else {
            search.reject_candidate();
        }
    }

    /// Number of beams in the next step; 0 when all are processed.
    pub(super) fn next_beams(&self) -> usize {
        self.evidence.next_beams().len()
    }

    /// Number of beams processed so far.
    pub(super) fn processed_beams(&self) -> usize {
        self.evidence.processed()
    }

    /// Processes the beams of the next step.
    pub(super) fn process_next_beams(&mut self) {
        self.rays += (self.next_beams() * self.len()) as u64;
        self.evidence.process_next(&self.model);
    }

    /// Computes the belief after the beams so far. Without a cloud, it is that of the global search.
    pub(super) fn update_belief(&mut self) -> Belief {
        let belief = match &mut self.search {
            Some(search) if self.particles.is_empty() => search.belief(&self.model),
            _ => self.cloud_belief(),
        };
        self.belief = Some(belief.clone());
        belief
    }

    fn cloud_belief(&mut self) -> Belief {
        let beams = self.processed_beams();
        self.posterior = if beams == 0 {
            self.particles.log_weight.clone()
        } else {
            self.evidence.posterior(&self.particles, self.novelty, self.model.knobs.least_effective).0
        };
        let mut belief = estimate::belief(&self.model, &self.particles, &relative(&self.posterior));
        belief.beams = beams;
        belief.fit = self.evidence.fit(&self.particles, self.model.sensor.squash).unwrap_or(0.0);
        let map_from_laser = belief.map_from_base * self.base_from_laser;
        belief.explained =
            if beams == 0 { self.agreement.recent() } else { self.model.explained(self.evidence.observation(), &map_from_laser) };
        belief.is_unconfirmed = self.agreement_with(belief.explained).recent() < MIN_EXPLAINED;
        belief
    }

    fn agreement_with(&self, explained: f64) -> Agreement {
        self.agreement.with(explained, if self.seconds > 0.0 { self.seconds } else { DEFAULT_PERIOD })
    }

    /// Resamples `count` particles by their weights.
    fn resample(&mut self, count: usize) {
        let mut random = self.streams.next().stream(0);
        let weights = relative(&self.particles.log_weight);
        self.resampled.clear();
        for index in low_variance(&weights, count, random.random()) {
            self.resampled.push(self.particles.pose(index), self.particles.scale[index], 0.0);
        }
        std::mem::swap(&mut self.particles, &mut self.resampled);
    }

    /// Number of particles of a compact cloud.
    fn typical_count(&self) -> usize {
        (self.model.knobs.particles as usize).min(self.max_particles)
    }

    /// Number of particles of the next generation.
    fn next_count(&self) -> usize {
        let (now, typical) = (self.len(), self.typical_count());
        let minimum = self.model.knobs.min_particles.map_or(typical, |minimum| (minimum as usize).min(typical));
        if now <= typical && minimum == typical {
            return typical;
        }
        let weights = relative(&self.particles.log_weight);
        let kept = low_variance(&weights, now, 0.5);
        let error = self.model.knobs.kld_error;
        kld_count(&self.particles, kept, self.model.grid.resolution() as f32, error).clamp(minimum, now.max(typical))
    }

    /// Number of particles that track the robot.
    pub(super) fn len(&self) -> usize {
        self.particles.len()
    }

    /// The ranges that a laser at `map_from_laser` would measure in the map at these angles, rad: in m, infinite if nothing is
    /// within range.
    pub fn expected_ranges(&self, map_from_laser: &Pose2, angles: impl IntoIterator<Item = f64>) -> Vec<f64> {
        self.model.expected_ranges(map_from_laser, &Fan::new(angles))
    }

    /// The map.
    pub fn map(&self) -> &OccupancyGrid {
        &self.model.grid
    }

    /// Number of rays cast for scans so far, a measure of the work of the updates.
    pub fn rays_cast(&self) -> u64 {
        self.rays
    }

    /// Poses of the particles in the map.
    pub fn poses(&self) -> impl ExactSizeIterator<Item = Pose2> + '_ {
        let particles = match &self.search {
            Some(search) if self.particles.is_empty() => search.particles(),
            _ => &self.particles,
        };
        (0..particles.len()).map(|index| {
            let [x, y, theta] = particles.pose(index).map(f64::from);
            self.model.grid.pose_in_map(&Pose2::new(x, y, theta))
        })
    }
}

/// The processing of a scan as interruptible work.
struct Update<'a> {
    filter: &'a mut ParticleFilter,
    /// Whether this is the first part of the processing; else it continues after an answer.
    is_first: bool,
}

impl AnytimeAlgorithm for Update<'_> {
    /// The size of an iteration is its number of rays; of the other phases, the number of particles.
    fn size(&self, phase: Phase) -> usize {
        let particles = self.filter.len();
        match phase {
            Phase::Setup => {
                if self.is_first {
                    particles
                } else {
                    0
                }
            }
            Phase::Iteration => particles * self.filter.next_beams(),
            Phase::Closing => particles,
        }
    }

    /// Nothing to plan: [`particles_for`] was called before the particles were moved, and the number of beams follows from the
    /// time.
    fn plan(&mut self, _remaining: &RemainingBudget) {}

    fn step(&mut self) -> Option<StopReason> {
        self.filter.process_next_beams();
        (self.filter.next_beams() == 0).then_some(StopReason::Converged)
    }

    fn is_good_enough(&mut self, contract: &Contract) -> bool {
        self.filter.processed_beams() >= MIN_BEAMS && {
            let belief = self.filter.update_belief();
            let error = ErrorEstimate::of_covariance(&belief.covariance);
            belief.is_localized() && contract.is_satisfied_by(error.translation, error.rotation)
        }
    }
}
