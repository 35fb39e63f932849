//! The filter itself: a cloud of particles that follows the robot, and beside it, where the robot may be elsewhere, a search all over
//! the map.

use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};

use super::LocalizationKnobs;
use super::agreement::{Agreement, DECIDED, LEAST};
use super::estimate::{self, Belief};
use super::evidence::Evidence;
use super::model::Model;
use super::motion::{MotionKnobs, UncertainMotion};
use super::observation::Observation;
use super::particles::{Particles, relative};
use super::resampling::{kld_count, low_variance};
use super::search::Search;
use super::sensor::SensorKnobs;
use super::streams::Streams;
use super::update::{Searching, particles_for};
use super::view::View;
use crate::anytime::contract::Contract;
use crate::anytime::cost_model::Phase;
use crate::anytime::{Driver, ErrorEstimate, Outlook, Work};
use crate::geometry::{Pose2, PoseCovariance};
use crate::map::grid::OccupancyGrid;
use crate::matching::StopReason;
use crate::raycasting::Fan;

/// Two poses this near to each other, m and rad, are of one place.
const SAME_PLACE: (f64, f64) = (1.0, 0.6);
/// Scans from nearer than this, m and rad, show the same parts of the same walls, and err alike by what the map and the ray casting err
/// there: together they are no more evidence than one. Two cells of a usual map.
const VIEW: View = View { way: 0.1, turn: 0.1 };
/// Time between two scans if it is not known, s.
const PERIOD: f64 = 0.025;

/// With fewer beams than this, a small covariance would be luck.
const FEWEST_BEAMS: usize = 8;

/// A particle filter on one map.
pub struct ParticleFilter {
    model: Model,
    streams: Streams,
    /// The cloud that follows the robot; none while the robot may be anywhere.
    particles: Particles,
    /// The next generation, while it is made.
    chosen: Particles,
    /// The scan that is being taken in, or was last.
    evidence: Evidence,
    base_from_laser: Pose2,
    /// What it leads to believe so far, and the logarithms of the weights then.
    belief: Option<Belief>,
    posterior: Vec<f32>,
    /// Particles that there is time for.
    affordable: usize,
    /// Time since the scan before, s.
    seconds: f64,
    /// Evidence that the robot's motion has made new and that has not been used, in scans.
    news: f64,
    /// How much of the scans the cloud explains.
    agreement: Agreement,
    /// While the robot may be elsewhere.
    search: Option<Search>,
    /// Rays cast so far.
    rays: u64,
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
            model: Model::new(map, knobs, motion, sensor)?,
            streams: Streams::new(knobs.seed),
            particles: Particles::default(),
            chosen: Particles::default(),
            evidence: Evidence::default(),
            base_from_laser: Pose2::IDENTITY,
            belief: None,
            posterior: Vec::new(),
            affordable: usize::MAX,
            seconds: 0.0,
            news: 1.0,
            agreement: Agreement::expecting(sensor.hit),
            search: None,
            rays: 0,
        };
        filter.spread();
        Ok(filter)
    }

    /// The robot is near `map_from_base`; how near, says `covariance`, or the configuration.
    pub fn start_at(&mut self, map_from_base: &Pose2, covariance: Option<&PoseCovariance>) {
        let heading = self.model.knobs.initial_heading_error.to_radians();
        let position = self.model.knobs.initial_position_error;
        let deviations = nalgebra::Vector3::new(position, position, heading);
        let given = covariance.and_then(|covariance| covariance.cholesky()).map(|root| root.l());
        self.start_about(map_from_base, &given.unwrap_or_else(|| PoseCovariance::from_diagonal(&deviations)));
    }

    /// The robot is near this position; of its heading nothing is known.
    pub fn start_in_place(&mut self, map_from_base: &Pose2) {
        let position = self.model.knobs.initial_position_error;
        self.start_about(map_from_base, &PoseCovariance::from_diagonal(&nalgebra::Vector3::new(position, position, 0.0)));
        let mut random = self.streams.next().stream(0);
        self.particles.theta.fill_with(|| random.random_range(-std::f32::consts::PI..std::f32::consts::PI));
    }

    /// `root` times normal numbers is what the pose may be off.
    fn start_about(&mut self, map_from_base: &Pose2, root: &PoseCovariance) {
        self.forget();
        let mut random = self.streams.next().stream(0);
        for _ in 0..self.model.knobs.particles {
            let off = root * nalgebra::Vector3::from_fn(|_, _| StandardNormal.sample(&mut random));
            let pose = Pose2::new(map_from_base.x + off.x, map_from_base.y + off.y, map_from_base.theta + off.z);
            let pose = self.model.grid.pose_in_cells(&pose);
            self.particles.push([pose.x as f32, pose.y as f32, pose.theta as f32], self.model.scale(&mut random), 0.0);
        }
    }

    /// The robot may be anywhere.
    pub fn spread(&mut self) {
        self.forget();
        self.search = Some(Search::new(&self.model, &mut self.streams));
    }

    fn forget(&mut self) {
        self.news = 1.0;
        self.belief = None;
        self.particles.clear();
        self.agreement = Agreement::expecting(self.model.sensor.hit);
        self.search = None;
    }

    /// Puts so many particles where a robot could be, for practice, and tells what it would see there. What is believed means nothing
    /// until [`Self::begin_anew`].
    pub fn practise(&mut self, particles: u32, beams: usize) -> Observation {
        let pose = self.model.somewhere(self.streams.next());
        self.start_at(&pose, None);
        self.resample(particles as usize);
        let angles: Vec<f64> = (0..beams).map(|k| k as f64 * 4.7 / beams as f64 - 2.35).collect();
        let ranges = self.expected_ranges(&pose, angles.iter().copied());
        Observation::of(angles, ranges)
    }

    /// Forgets everything: as new.
    pub fn begin_anew(&mut self) {
        self.streams = Streams::new(self.model.knobs.seed);
        self.affordable = usize::MAX;
        self.spread();
    }

    /// The robot has moved: `motion`, seen from its start, took `seconds`.
    pub fn predict(&mut self, motion: &Pose2, seconds: f64) {
        self.seconds = seconds;
        // What says that it stands may err.
        self.news = VIEW.news(self.news, motion, self.model.motion.speed_error * seconds);
        if let Some(search) = &mut self.search {
            search.moved(motion, seconds);
        }
        let motion = UncertainMotion::new(&self.model.motion, motion, seconds);
        self.model.move_all(&mut self.particles, &motion, self.streams.next());
    }

    /// Gives up particles if there are too many to move them and take in a scan of `beams` beams in the time there is. To be called
    /// before the motion.
    pub fn plan(&mut self, beams: usize, driver: &Driver) {
        let wanted = self.model.knobs.particles as usize;
        self.affordable = driver.outlook().map_or(usize::MAX, |outlook| particles_for(&outlook, wanted, beams));
        if self.len() > self.affordable {
            self.resample(self.affordable);
        }
    }

    /// The laser, at `base_from_laser`, has seen something: new evidence, each scan but once. As many of its beams are taken in as the
    /// driver has time for. [`Self::finish`] is to follow.
    pub fn update(&mut self, observation: Observation, base_from_laser: &Pose2, driver: &mut Driver) -> (Belief, StopReason) {
        if let Some(search) = &mut self.search {
            search.offer(&observation, base_from_laser, self.seconds, &mut self.streams);
        }
        self.base_from_laser = *base_from_laser;
        let mount = self.model.mount(base_from_laser);
        let Particles { x, y, theta, .. } = &self.particles;
        let views = x.iter().zip(y).zip(theta).map(|((&x, &y), &theta)| mount.view(x, y, theta));
        self.evidence.begin(observation, views);
        let stop_reason = driver.drive(&mut Update { filter: self, is_first: true });
        (self.believe(), stop_reason)
    }

    /// What can wait until the belief is out: takes in the beams that are left, if that is wanted, as far as `driver` has time for it,
    /// chooses the particles that live on, and goes on looking for the robot where it may be elsewhere. Without an update before there is
    /// nothing to be done.
    pub fn finish(&mut self, take_in_all: bool, driver: &mut Driver) {
        let Some(mut belief) = self.belief.take() else { return };
        if take_in_all && self.next_beams() > 0 {
            driver.drive(&mut Update { filter: self, is_first: false });
            belief = self.believe();
            self.belief = None;
        }
        if !self.particles.is_empty() {
            self.follow(&belief);
        }
        self.evidence.begin(Observation::default(), std::iter::empty());
        self.seek(driver);
        self.seconds = 0.0;
    }

    /// Chooses the particles that live on, and judges what they believe.
    fn follow(&mut self, belief: &Belief) {
        std::mem::swap(&mut self.particles.log_weight, &mut self.posterior);
        if belief.beams > 0 {
            self.news = 0.0;
            self.agreement = self.agreement_with(belief.explained);
        }
        let (count, usual) = (self.len(), self.usual_count());
        let is_off = count > usual || count < usual && self.model.knobs.min_particles.is_none();
        if is_off || belief.effective < self.model.knobs.resample_below * count as f64 {
            self.resample(self.next_count());
        }
        let part = self.model.knobs.recover_below;
        if self.search.is_none() && self.agreement.is_doubtful(part) {
            self.search = Some(Search::new(&self.model, &mut self.streams));
        } else if self.agreement.is_good(part) {
            self.search = None;
        }
    }

    /// Goes on with the search, and draws its conclusions: the cloud is given up only for a place that explains the scans decidedly better.
    fn seek(&mut self, driver: &mut Driver) {
        let Some(search) = &mut self.search else { return };
        let rays = search.rays();
        if search.has_work() {
            // However fast scans come, there is some progress.
            search.work(&self.model, &mut self.streams);
            driver.drive(&mut Searching { search, model: &self.model, streams: &mut self.streams });
        }
        self.rays += search.rays() - rays;
        let Some((place, explained)) = search.place().filter(|_| !search.is_busy()) else { return };
        let here = estimate::belief(&self.model, &self.particles, &relative(&self.particles.log_weight)).map_from_base;
        let off = here.between(&place.map_from_base);
        if !self.particles.is_empty() && off.distance() < SAME_PLACE.0 && off.theta.abs() < SAME_PLACE.1 {
            self.agreement.settle();
            self.search = None;
        } else if self.particles.is_empty() || explained >= self.agreement.recent() + DECIDED {
            self.particles = search.particles_there(&self.model, self.model.knobs.particles as usize, &mut self.streams);
            self.agreement = Agreement::expecting(self.model.sensor.hit);
            self.search = None;
        } else {
            search.disbelieve();
        }
    }

    /// Whether there are beams left for the cloud, and how many come next.
    pub(super) fn next_beams(&self) -> usize {
        self.evidence.next_beams().len()
    }

    /// Beams taken in.
    pub(super) fn weighed_beams(&self) -> usize {
        self.evidence.weighed()
    }

    /// Takes in some beams more.
    pub(super) fn weigh_next_beams(&mut self) {
        self.rays += (self.next_beams() * self.len()) as u64;
        self.evidence.weigh_next(&self.model.beams, &*self.model.caster, &self.model.workers);
    }

    /// What is to be believed by as much of the scan as has been taken in. Without a cloud, what the search has led to.
    pub(super) fn believe(&mut self) -> Belief {
        let belief = match &mut self.search {
            Some(search) if self.particles.is_empty() => search.belief(&self.model),
            _ => self.believe_cloud(),
        };
        self.belief = Some(belief.clone());
        belief
    }

    fn believe_cloud(&mut self) -> Belief {
        let beams = self.weighed_beams();
        self.posterior = if beams == 0 {
            self.particles.log_weight.clone()
        } else {
            self.evidence.posterior(&self.particles, self.news, self.model.knobs.least_effective).0
        };
        let mut belief = estimate::belief(&self.model, &self.particles, &relative(&self.posterior));
        belief.beams = beams;
        belief.fit = self.evidence.fit(&self.particles, self.model.sensor.squash).unwrap_or(0.0);
        let map_from_laser = belief.map_from_base * self.base_from_laser;
        belief.explained =
            if beams == 0 { self.agreement.recent() } else { self.model.explained(self.evidence.observation(), &map_from_laser) };
        belief.is_sought = self.agreement_with(belief.explained).recent() < LEAST;
        belief
    }

    fn agreement_with(&self, explained: f64) -> Agreement {
        self.agreement.with(explained, if self.seconds > 0.0 { self.seconds } else { PERIOD })
    }

    /// Chooses `count` particles by their weights.
    fn resample(&mut self, count: usize) {
        let mut random = self.streams.next().stream(0);
        let weights = relative(&self.particles.log_weight);
        self.chosen.clear();
        for index in low_variance(&weights, count, random.random()) {
            self.chosen.push(self.particles.pose(index), self.particles.scale[index], 0.0);
        }
        std::mem::swap(&mut self.particles, &mut self.chosen);
    }

    /// Particles when the cloud is compact.
    fn usual_count(&self) -> usize {
        (self.model.knobs.particles as usize).min(self.affordable)
    }

    /// How many particles the next generation has.
    fn next_count(&self) -> usize {
        let (now, usual) = (self.len(), self.usual_count());
        let least = self.model.knobs.min_particles.map_or(usual, |least| (least as usize).min(usual));
        if now <= usual && least == usual {
            return usual;
        }
        let weights = relative(&self.particles.log_weight);
        let chosen = low_variance(&weights, now, 0.5);
        let error = self.model.knobs.kld_error;
        kld_count(&self.particles, chosen, self.model.grid.resolution() as f32, error).clamp(least, now.max(usual))
    }

    /// Number of particles that follow the robot.
    pub(super) fn len(&self) -> usize {
        self.particles.len()
    }

    /// What a laser at `map_from_laser` would see in the map at these angles, rad: lengths, m; infinite where nothing is in reach.
    pub fn expected_ranges(&self, map_from_laser: &Pose2, angles: impl IntoIterator<Item = f64>) -> Vec<f64> {
        self.model.expected_ranges(map_from_laser, &Fan::new(angles))
    }

    /// The map.
    pub fn map(&self) -> &OccupancyGrid {
        &self.model.grid
    }

    /// Rays cast for scans so far: the work that updates took.
    pub fn rays_cast(&self) -> u64 {
        self.rays
    }

    /// Poses of the particles, in the map.
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

/// Taking in a scan.
struct Update<'a> {
    filter: &'a mut ParticleFilter,
    /// Whether it begins here, or goes on after an answer.
    is_first: bool,
}

impl Work for Update<'_> {
    /// Iterations in beams of all particles, all else in particles.
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

    /// The particles have been moved already: [`particles_for`] came before that. How many beams there is time for shows.
    fn plan(&mut self, _outlook: &Outlook) {}

    fn step(&mut self) -> Option<StopReason> {
        self.filter.weigh_next_beams();
        (self.filter.next_beams() == 0).then_some(StopReason::Converged)
    }

    fn is_good_enough(&mut self, contract: &Contract) -> bool {
        self.filter.weighed_beams() >= FEWEST_BEAMS && {
            let belief = self.filter.believe();
            let error = ErrorEstimate::of_covariance(&belief.covariance);
            belief.is_localized() && contract.is_satisfied_by(error.translation, error.rotation)
        }
    }
}
