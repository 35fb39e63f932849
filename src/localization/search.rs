//! The search for a robot that may be anywhere: many particles take in one scan after another, each in the course of several updates.
//!
//! The work of one update is bounded ([`RAYS_PER_SECOND`]). While a scan is being taken in, the particles stay where the robot was then;
//! its motion since is caught up with at the next scan. A scan is evidence only as far as the robot's motion has made it new, so that the
//! scans passed over are no loss.

use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};

use super::agreement::FOUND;
use super::estimate::{self, Belief};
use super::evidence::{fit, posterior};
use super::model::Model;
use super::motion::UncertainMotion;
use super::observation::Observation;
use super::particles::{Particles, relative};
use super::recovery::Fit;
use super::resampling::{kld_count, low_variance};
use super::sensor::expected_fit;
use super::streams::{CHUNK, Step, Streams};
use super::view::View;
use crate::geometry::{Pose2, wrap_angle};

/// Work for each second of the robot's time: a fifth of what one core casts all over a map (`cargo bench --bench raycasting`).
const RAYS_PER_SECOND: f64 = 10e6;
/// Work of this time at most is done at once, s, and of so much if the time is not known.
const PERIOD: (f64, f64) = (0.1, 0.025);
/// Chunks that are weighed before the clock is looked at.
const CHUNKS: usize = 4;
/// What weighing a particle or choosing it costs beside the casting, in rays.
const RAYS_PER_PARTICLE: usize = 4;
/// Scans from nearer than this, m and rad, show the same once more: together they are no more evidence than one.
const VIEW: View = View { way: 0.5, turn: 0.5 };
/// Less news than this, in scans, is not worth taking a scan in.
const LEAST_NEWS: f64 = 0.1;
/// Each particle is moved by so much when chosen: no two shall stand for the same pose. Cells, rad.
const ROUGHENING: (f32, f32) = (1.0, 0.02);
/// There are at least so many times as many particles as usual: places that are as likely as others shall not be given up by chance.
const EXPLORERS: u32 = 10;
/// It is on the wrong track everywhere where scans fit worse than this part of what the model expects of the right place.
const LOST: f64 = 0.7;
/// Part of the weight with which a place has no rival.
const NO_RIVAL: f64 = 0.99;
/// The robot is found when a place has had no rival for this way, m: corridors look alike for a while.
const WAY_WITHOUT_RIVAL: f64 = 2.0;
/// Particles this near to the place that was found belong to it: m, rad.
const CLUSTER: (f32, f32) = (1.0, 0.6);

/// What is to be done next.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Stage {
    /// Nothing before a scan with news.
    Wait,
    /// The particles from this one on are to be moved and compared with the scan.
    Weigh(usize),
    /// The scan has been compared with all.
    Conclude,
    /// Particles are to be chosen by their weights.
    Choose,
    /// More of them are needed all over the map.
    Scatter,
}

/// A motion of the robot and how long it took, s.
#[derive(Clone, Copy, Debug, Default)]
struct Passed {
    motion: Pose2,
    seconds: f64,
}

impl Passed {
    fn add(&mut self, motion: &Pose2, seconds: f64) {
        self.motion = self.motion * *motion;
        self.seconds += seconds;
    }
}

/// How far a place has come without a rival.
#[derive(Clone, Copy, Debug, Default)]
struct Lead {
    /// Way, m.
    way: f64,
    /// Scans, and the sum of the parts of their beams that the place explained.
    scans: f64,
    explained: f64,
}

/// How far it has come.
#[derive(Debug)]
pub(super) struct Search {
    particles: Particles,
    chosen: Particles,
    log_likelihoods: Vec<f32>,
    stage: Stage,
    /// The scan that is being taken in.
    scan: Observation,
    base_from_laser: Pose2,
    /// How the robot moved from where the particles are to that scan, and since then; before a scan is taken in, all is in the latter.
    before: Passed,
    since: Passed,
    step: Step,
    /// Evidence that the robot's motion has made new and that has not been used, in scans, and what of it the scan may be.
    news: f64,
    offered: f64,
    lead: Lead,
    fit: Fit,
    /// What the last scan that was taken in led to believe, and where the robot is by odometry since then.
    belief: Option<Belief>,
    /// Rays that may be cast in this update.
    allowance: f64,
    /// All rays so far.
    rays: u64,
}

impl Search {
    /// Nothing has been seen.
    pub(super) fn new(model: &Model, streams: &mut Streams) -> Self {
        let mut particles = Particles::default();
        model.scatter(&mut particles, model.knobs.global_particles as usize, 0.0, streams.next());
        Self {
            particles,
            chosen: Particles::default(),
            log_likelihoods: Vec::new(),
            stage: Stage::Wait,
            scan: Observation::default(),
            base_from_laser: Pose2::IDENTITY,
            before: Passed::default(),
            since: Passed::default(),
            step: Step::default(),
            news: 1.0,
            offered: 0.0,
            lead: Lead::default(),
            fit: Fit::expecting(expected_fit(&model.sensor, &model.sensor.global())),
            belief: None,
            allowance: 0.0,
            rays: 0,
        }
    }

    /// The robot has moved.
    pub(super) fn moved(&mut self, motion: &Pose2, seconds: f64) {
        self.news = VIEW.news(self.news, motion, 0.0);
        self.lead.way += motion.distance();
        self.since.add(motion, seconds);
        if let Some(belief) = &mut self.belief {
            belief.map_from_base = belief.map_from_base * *motion;
        }
    }

    /// Another scan, so many seconds after the last. It is passed over while an earlier one is being taken in, and if it is no news.
    pub(super) fn offer(&mut self, scan: &Observation, base_from_laser: &Pose2, seconds: f64, streams: &mut Streams) {
        let seconds = if seconds > 0.0 { seconds.min(PERIOD.0) } else { PERIOD.1 };
        self.allowance = RAYS_PER_SECOND * seconds;
        if self.stage != Stage::Wait || self.news < LEAST_NEWS || scan.is_empty() {
            return;
        }
        (self.scan, self.base_from_laser) = (scan.clone(), *base_from_laser);
        (self.offered, self.news) = (self.news, 0.0);
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

    /// Does the next piece of it.
    pub(super) fn work(&mut self, model: &Model, streams: &mut Streams) {
        let count = self.particles.len();
        let cost = match self.stage {
            Stage::Wait => 0,
            Stage::Weigh(first) => {
                let end = (first + CHUNKS * CHUNK).min(count);
                self.weigh(model, first, end);
                self.stage = if end < count { Stage::Weigh(end) } else { Stage::Conclude };
                self.rays += ((end - first) * self.scan.len()) as u64;
                (end - first) * (self.scan.len() + RAYS_PER_PARTICLE)
            }
            Stage::Conclude => {
                self.stage = self.conclude(model);
                count * RAYS_PER_PARTICLE
            }
            Stage::Choose => {
                self.choose(model, streams);
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

    /// Moves some particles to where the robot was at the scan, and compares the scan with what they would see.
    fn weigh(&mut self, model: &Model, first: usize, end: usize) {
        let Passed { motion, seconds } = self.before;
        let motion = (seconds > 0.0).then(|| UncertainMotion::new(&model.motion, &motion, seconds));
        let (mount, scan, step) = (model.mount(&self.base_from_laser), &self.scan, self.step);
        let rows = model.global_beams.rows(&scan.ranges);
        let Particles { x, y, theta, scale, .. } = &mut self.particles;
        let poses = x[first..end].chunks_mut(CHUNK).zip(y[first..end].chunks_mut(CHUNK)).zip(theta[first..end].chunks_mut(CHUNK));
        let poses = poses.zip(scale[first..end].chunks_mut(CHUNK));
        let tasks = poses.zip(self.log_likelihoods[first..end].chunks_mut(CHUNK));
        model.workers.share(tasks, |chunk, ((((x, y), theta), scale), sums)| {
            if let Some(motion) = &motion {
                model.move_chunk(motion, step, first / CHUNK + chunk, [&mut *x, &mut *y, &mut *theta, scale]);
            }
            let views: Vec<_> = (0..x.len()).map(|i| mount.view(x[i], y[i], theta[i])).collect();
            let mut lengths = vec![0.0; scan.len() * views.len()];
            model.caster.cast(&views, &scan.fan, &mut lengths);
            for (row, lengths) in rows.iter().zip(lengths.chunks_exact(views.len())) {
                model.global_beams.add_log_likelihoods(row, scan.reach, lengths, sums);
            }
        });
    }

    /// Believes the scan as far as it is news.
    fn conclude(&mut self, model: &Model) -> Stage {
        let (knobs, before) = (&model.knobs, &self.particles.log_weight);
        let (log_weights, power) = posterior(before, &self.log_likelihoods, self.offered, knobs.global_least_effective);
        let fit = fit(before, &self.log_likelihoods, model.sensor.squash, self.scan.len());
        self.particles.log_weight = log_weights;
        self.before = Passed::default();
        self.news = (self.news + self.offered - power).min(1.0);
        let mut belief = estimate::belief(model, &self.particles, &relative(&self.particles.log_weight));
        belief.explained = model.explained(&self.scan, &(belief.map_from_base * self.base_from_laser));
        (belief.beams, belief.fit, belief.is_sought) = (self.scan.len(), fit, true);
        self.fit.add(fit);
        self.lead(&belief);
        let is_uneven = belief.effective < knobs.resample_below * self.particles.len() as f64;
        belief.map_from_base = belief.map_from_base * self.since.motion;
        self.belief = Some(belief);
        let is_large = self.particles.len() > knobs.global_particles.max(knobs.particles * EXPLORERS) as usize;
        if is_uneven || is_large {
            Stage::Choose
        } else if self.fit.is_lost(LOST) {
            Stage::Scatter
        } else {
            Stage::Wait
        }
    }

    /// Takes note of whether the place has a rival.
    fn lead(&mut self, belief: &Belief) {
        if belief.share < NO_RIVAL || !belief.is_compact() {
            self.lead = Lead::default();
        } else {
            self.lead.scans += 1.0;
            self.lead.explained += belief.explained;
        }
    }

    /// Half of the belief goes to particles all over the map: it was on the wrong track everywhere.
    fn scatter(&mut self, model: &Model, streams: &mut Streams) {
        let count = model.knobs.global_particles as usize;
        let log_weights = &self.particles.log_weight;
        let largest = log_weights.iter().copied().fold(f32::NEG_INFINITY, f32::max);
        let total: f64 = relative(log_weights).into_iter().map(f64::from).sum();
        model.scatter(&mut self.particles, count, largest + (total / count as f64).ln() as f32, streams.next());
        self.fit = Fit::expecting(expected_fit(&model.sensor, &model.sensor.global()));
        self.lead = Lead::default();
    }

    /// Chooses the particles that live on.
    fn choose(&mut self, model: &Model, streams: &mut Streams) {
        let mut random = streams.next().stream(0);
        let weights = relative(&self.particles.log_weight);
        self.chosen.clear();
        for index in low_variance(&weights, self.next_count(model, &weights), random.random()) {
            let mut pose = self.particles.pose(index);
            for (value, deviation) in pose.iter_mut().zip([ROUGHENING.0, ROUGHENING.0, ROUGHENING.1]) {
                let normal: f32 = StandardNormal.sample(&mut random);
                *value += deviation * normal;
            }
            self.chosen.push(pose, self.particles.scale[index], 0.0);
        }
        std::mem::swap(&mut self.particles, &mut self.chosen);
    }

    /// How many particles the next generation has.
    fn next_count(&self, model: &Model, weights: &[f32]) -> usize {
        let (now, usual) = (self.particles.len(), (model.knobs.particles * EXPLORERS) as usize);
        let most = model.knobs.global_particles as usize;
        if now <= usual {
            return usual.min(most);
        }
        let chosen = low_variance(weights, now, 0.5);
        kld_count(&self.particles, chosen, model.grid.resolution() as f32, model.knobs.kld_error)
            .clamp(usual, now.min(most.max(usual)))
    }

    /// What it leads to believe, where the robot is now.
    pub(super) fn belief(&mut self, model: &Model) -> Belief {
        let particles = &self.particles;
        let all = || Belief { is_sought: true, ..estimate::belief(model, particles, &relative(&particles.log_weight)) };
        self.belief.get_or_insert_with(all).clone()
    }

    /// Whether a scan is being taken in: only afterwards are all particles of the same time.
    pub(super) fn is_busy(&self) -> bool {
        self.stage != Stage::Wait
    }

    /// The place that has had no rival for a while, and the part of the beams that it explained.
    pub(super) fn place(&self) -> Option<(&Belief, f64)> {
        let belief = self.belief.as_ref().filter(|_| self.lead.way >= WAY_WITHOUT_RIVAL && self.lead.scans > 0.0)?;
        Some((belief, self.lead.explained / self.lead.scans)).filter(|&(_, explained)| explained >= FOUND)
    }

    /// The place that it leads to is not believed: it has to prove itself anew.
    pub(super) fn disbelieve(&mut self) {
        self.lead = Lead::default();
    }

    /// So many particles of the place that was found, where the robot is now.
    pub(super) fn particles_there(&self, model: &Model, count: usize, streams: &mut Streams) -> Particles {
        let mut there = Particles::default();
        let Some(belief) = &self.belief else { return there };
        let place = model.grid.pose_in_cells(&(belief.map_from_base * self.since.motion.inverse()));
        let per_cell = model.grid.resolution() as f32;
        let mut weights = relative(&self.particles.log_weight);
        for (index, weight) in weights.iter_mut().enumerate() {
            let [x, y, theta] = self.particles.pose(index);
            let is_near = (x - place.x as f32).hypot(y - place.y as f32) * per_cell < CLUSTER.0;
            if !is_near || wrap_angle(f64::from(theta) - place.theta).abs() > CLUSTER.1.into() {
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

    /// Its particles, at the last scan that was taken in.
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

    /// What is seen from a place of it.
    fn seen(model: &Model, pose: Pose2) -> Observation {
        let angles: Vec<f64> = (0..60).map(|k| f64::from(k) * 0.1).collect();
        let ranges = model.expected_ranges(&pose, &crate::raycasting::Fan::new(angles.iter().copied()));
        Observation::of(angles, ranges)
    }

    /// Takes a scan offered in as many updates as it takes; the work of each.
    fn take_in(search: &mut Search, model: &Model, scan: &Observation, streams: &mut Streams) -> Vec<u64> {
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
            search.moved(&Pose2::IDENTITY, 0.025);
        }
    }

    #[test]
    fn a_scan_is_taken_in_over_updates_none_of_which_does_more_than_its_part() {
        let (model, mut streams) = (model(), Streams::new(1));
        let mut search = Search::new(&model, &mut streams);
        let work = take_in(&mut search, &model, &seen(&model, Pose2::new(3.0, 2.0, 0.5)), &mut streams);
        let (most, step) = (RAYS_PER_SECOND * 0.025, CHUNKS * CHUNK * 60);
        assert!(work.len() >= 5 && work.iter().all(|&rays| rays <= most as u64 + step as u64), "{work:?}");
        assert_eq!(work.iter().sum::<u64>(), 20_000 * 60, "every particle, once");
    }

    #[test]
    fn a_robot_at_rest_sees_nothing_new_and_is_not_found() {
        let (model, mut streams) = (model(), Streams::new(1));
        let (mut search, scan) = (Search::new(&model, &mut streams), seen(&model, Pose2::new(3.0, 2.0, 0.5)));
        for _ in 0..100 {
            take_in(&mut search, &model, &scan, &mut streams);
        }
        let rays = search.rays();
        take_in(&mut search, &model, &scan, &mut streams);
        assert!(search.news < LEAST_NEWS && search.place().is_none() && search.rays() == rays, "{}", search.news);
        search.moved(&Pose2::new(0.2, 0.0, 0.0), 0.1);
        assert!((search.news - 0.4).abs() < LEAST_NEWS);
    }

    #[test]
    fn it_is_found_where_no_other_place_has_been_likely_for_a_while_and_the_map_explains_what_is_seen() {
        let (model, mut streams) = (model(), Streams::new(1));
        let drive = |explained: f64, shares: &[f64]| {
            let mut search = Search::new(&model, &mut Streams::new(1));
            for &share in shares {
                search.moved(&Pose2::new(0.5, 0.0, 0.0), 0.1);
                let place = Belief { covariance: PoseCovariance::identity() * 1e-4, share, explained, ..search.belief(&model) };
                search.lead(&place);
            }
            search.place().is_some()
        };
        assert!(!drive(0.9, &[0.8, 1.0, 1.0, 1.0]) && drive(0.9, &[0.8, 1.0, 1.0, 1.0, 1.0]));
        assert!(!drive(0.9, &[0.8, 1.0, 1.0, 0.9, 1.0]) && !drive(0.5, &[1.0; 9]));
        // Where it is, the cloud of the place is moved on to.
        let mut search = Search::new(&model, &mut streams);
        assert_eq!(search.particles_there(&model, 100, &mut streams).len(), 0, "nothing is believed yet");
        search.belief(&model);
        assert_eq!(search.particles_there(&model, 100, &mut streams).len(), 100);
    }
}
