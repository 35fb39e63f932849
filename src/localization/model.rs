//! The fixed models of the particle filter: map, motion and sensor.

use rand::{Rng, RngExt};
use rand_distr::{Distribution, StandardNormal};

use super::LocalizationKnobs;
use super::agreement::explained;
use super::motion::{MotionKnobs, UncertainMotion};
use super::observation::Observation;
use super::particles::Particles;
use super::sensor::{BeamTable, SensorKnobs};
use super::streams::{CHUNK, Step};
use crate::geometry::{Pose2, wrap_angle};
use crate::map::grid::OccupancyGrid;
use crate::map::indoors::indoor_cells;
use crate::parallel::Workers;
use crate::raycasting::{Fan, RayCaster, RayCasting, Viewpoint, binary_angle};

/// The map, the motion model and the sensor model.
pub(super) struct Model {
    pub(super) knobs: LocalizationKnobs,
    pub(super) motion: MotionKnobs,
    pub(super) sensor: SensorKnobs,
    pub(super) beams: BeamTable,
    /// The beam model of the global search.
    pub(super) global_beams: BeamTable,
    pub(super) caster: Box<dyn RayCaster>,
    pub(super) grid: OccupancyGrid,
    /// Indices of the cells where a robot can be.
    indoors: Vec<usize>,
    pub(super) workers: Workers,
}

impl Model {
    /// Fails if the system cannot start the threads.
    pub(super) fn new(
        grid: OccupancyGrid,
        knobs: &LocalizationKnobs,
        motion: &MotionKnobs,
        sensor: &SensorKnobs,
    ) -> std::io::Result<Self> {
        let max_range = sensor.max_range / grid.resolution();
        Ok(Self {
            knobs: knobs.clone(),
            motion: motion.clone(),
            sensor: sensor.clone(),
            beams: BeamTable::new(sensor, grid.resolution()),
            global_beams: BeamTable::new(&sensor.global(), grid.resolution()),
            caster: match knobs.ray_casting {
                Some(method) => method.caster(&grid, max_range),
                None => RayCasting::fastest_caster(&grid, max_range),
            },
            indoors: indoor_cells(&grid),
            grid,
            workers: Workers::new(knobs.threads as usize)?,
        })
    }

    /// Adds particles uniformly over the map.
    pub(super) fn scatter(&self, particles: &mut Particles, count: usize, log_weight: f32, step: Step) {
        let mut random = step.stream(0);
        for _ in 0..if self.indoors.is_empty() { 0 } else { count } {
            let (column, row) = self.cell(random.random_range(0..self.indoors.len()));
            let (x, y) = (column as f32 + random.random::<f32>(), row as f32 + random.random::<f32>());
            let theta = (random.random::<f32>() - 0.5) * std::f32::consts::TAU;
            particles.push([x, y, theta], self.scale(&mut random), log_weight);
        }
    }

    /// A random pose where a robot can be, in the map frame.
    pub(super) fn random_pose(&self, step: Step) -> Pose2 {
        let count = self.indoors.len();
        let (column, row) = if count == 0 { (0, 0) } else { self.cell(step.stream(0).random_range(0..count)) };
        let centre = self.grid.centre(column, row);
        Pose2::new(centre.x, centre.y, 0.0)
    }

    fn cell(&self, number: usize) -> (usize, usize) {
        (self.indoors[number] % self.grid.width(), self.indoors[number] / self.grid.width())
    }

    /// Samples a particle's scale error of distances.
    pub(super) fn scale(&self, random: &mut impl Rng) -> f32 {
        let normal: f64 = StandardNormal.sample(random);
        (self.motion.scale_error * normal) as f32
    }

    /// Moves a chunk of particles, given by their columns, rows, headings and scale errors.
    pub(super) fn move_chunk(&self, motion: &UncertainMotion, step: Step, chunk: usize, [x, y, theta, scale]: [&mut [f32]; 4]) {
        let (mut random, per_metre) = (step.stream(chunk), self.grid.resolution().recip());
        for (((x, y), theta), scale) in x.iter_mut().zip(y).zip(theta).zip(scale) {
            let step = motion.sample(scale, &mut random);
            let (sin, cos) = (*theta + step.direction as f32).sin_cos();
            let (forward, left) = ((step.forward * per_metre) as f32, (step.left * per_metre) as f32);
            *x += forward * cos - left * sin;
            *y += forward * sin + left * cos;
            *theta = wrap_angle(f64::from(*theta) + step.rotation) as f32;
        }
    }

    /// Moves all particles.
    pub(super) fn move_all(&self, particles: &mut Particles, motion: &UncertainMotion, step: Step) {
        let Particles { x, y, theta, scale, .. } = particles;
        let chunks = x.chunks_mut(CHUNK).zip(y.chunks_mut(CHUNK)).zip(theta.chunks_mut(CHUNK)).zip(scale.chunks_mut(CHUNK));
        self.workers
            .for_each(chunks, |chunk, (((x, y), theta), scale)| self.move_chunk(motion, step, chunk, [x, y, theta, scale]));
    }

    /// Adds the log-likelihoods of a scan, by this beam model, to those of the particles whose lasers are at `views`.
    pub(super) fn add_log_likelihoods(&self, table: &BeamTable, scan: &Observation, views: &[Viewpoint], sums: &mut [f32]) {
        let mut lengths = vec![0.0; scan.len() * views.len()];
        self.caster.cast(views, &scan.fan, &mut lengths);
        for (&range, lengths) in scan.ranges.iter().zip(lengths.chunks_exact(views.len())) {
            table.add_log_likelihoods(range, scan.max_range, lengths, sums);
        }
    }

    /// Converts the pose of a laser on the base to cells.
    pub(super) fn mount(&self, base_from_laser: &Pose2) -> Mount {
        let per_metre = self.grid.resolution().recip();
        Mount([base_from_laser.x * per_metre, base_from_laser.y * per_metre, base_from_laser.theta].map(|value| value as f32))
    }

    /// The ranges that a laser at `map_from_laser` would measure in the map at these angles, rad: in m, infinite if nothing is
    /// within range.
    pub(super) fn expected_ranges(&self, map_from_laser: &Pose2, fan: &Fan) -> Vec<f64> {
        let mut lengths = vec![0.0; fan.len()];
        self.caster.cast(&[Viewpoint::new(&self.grid.pose_in_cells(map_from_laser))], fan, &mut lengths);
        lengths.into_iter().map(|length| f64::from(length) * self.grid.resolution()).collect()
    }

    /// The fraction of the beams that the map explains if the laser is at this pose.
    pub(super) fn explained(&self, observation: &Observation, map_from_laser: &Pose2) -> f64 {
        explained(&self.sensor, observation, self.expected_ranges(map_from_laser, &observation.fan))
    }
}

/// The pose of a laser on the base: cells and rad.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Mount([f32; 3]);

impl Mount {
    /// The pose of the laser for a robot at a pose of the grid.
    #[inline]
    pub(super) fn view(self, x: f32, y: f32, theta: f32) -> Viewpoint {
        let [forward, left, yaw] = self.0;
        let (sin, cos) = theta.sin_cos();
        let (x, y) = (x + forward * cos - left * sin, y + forward * sin + left * cos);
        let heading = theta + yaw;
        let (sin, cos) = if yaw == 0.0 { (sin, cos) } else { heading.sin_cos() };
        Viewpoint { x, y, heading: binary_angle(heading.into()), cos, sin }
    }
}
