//! Projective data association: pairs each sensed point with the surface that the reference laser saw in its direction. There is
//! no nearest-neighbour search. Large errors lose their weight gradually (kernel of Geman and `McClure` 1987) instead of being
//! cut off.
//!
//! The squared error of a correspondence is weighted by its inverse variance, in units of the variance of a range. The variance
//! is the sum of that of the sensed range (`cos^2(incidence)`), that of the surface, and the kernel variance, which is the same
//! for all. The kernel variance is what the errors of the correspondences show beyond the other terms. At first it is dominated
//! by the error of the guess: all correspondences have similar weights, and the kernel is wide. As the scans converge, it falls
//! to the unevenness of the surfaces, and grazing rays, which are the most precise, gain weight.
//!
//! A ray is also weighted by the direction of the surface that it ends on, estimated from its neighbours (`chords`). A ray that
//! ends near a surface but belongs to another one at an angle to it, as in a corner that the robot drives around, gets less
//! weight.
//!
//! A moving object is seen at one position by one view and not by the others (`view_consistency`). A ray that lies on the surface
//! in only some of the views that have one in its direction gets less weight.

mod chords;
mod free_direction;
mod line_fit;
mod projection;
mod range_noise;
mod rays;
mod sums;
mod view_consistency;

#[cfg(test)]
mod specification;

use fearless_simd::{Level, Simd, dispatch, f32x8, prelude::*};
use nalgebra::Matrix3;

use super::data_association::{Agreement, Correspondences, DataAssociation, PlacedView};
use super::first_guess::{FirstGuess, Prior};
use super::ray_order::RayOrder;
use super::solver::QuadraticForm;
use super::surface::LANES;
use super::uncertainty::{Uncertainty, condition_number};
use super::view::View;
use crate::geometry::{Point, Pose2};
use crate::scan::Scan;
use free_direction::remove_information;
use line_fit::LineFitter;
use projection::{ProjectedBlock, ViewProjection};
use range_noise::RangeNoise;
use rays::{AllRays, Rays};
use sums::{Sum, Sums};
use view_consistency::ViewConsistency;

/// An error of this many standard deviations keeps a quarter of its weight.
const KERNEL_SIGMAS: f64 = 3.0;
/// Initial kernel width, m: an error of this size keeps a quarter of its weight in the first iteration.
const INITIAL_KERNEL_WIDTH: f64 = 0.3;
/// Smallest ratio of the kernel variance to that of the previous iteration: the correspondences that fit first need not fit best.
const MIN_SHRINK: f64 = 0.08;
/// Largest ratio of the kernel variance to that of the previous iteration while it is above [`MAX_SURFACE_VARIANCE`].
const MAX_SHRINK: f64 = 0.5;
/// Largest kernel variance that unevenness of surfaces can explain, in units of the variance of a range (3 cm at the default
/// range noise of 1 cm). Larger errors come from objects that have moved.
const MAX_SURFACE_VARIANCE: f64 = 9.0;
/// The kernel variance has settled if its ratio to that of the previous iteration is at least this.
const SETTLED_SHRINK: f64 = 0.7;
/// Minimum kernel variance, in units of the variance of a range: surfaces are uneven, and beams are wide.
const MIN_KERNEL_VARIANCE: f64 = 0.15;
/// The errors of neighbouring rays are correlated, so the correspondences together contain less information than their variances
/// suggest, by this factor.
const RAY_CORRELATION: f64 = 3.0;
/// A ray agrees with a surface if it ends within this distance of it, m.
const AGREEMENT_DISTANCE: f32 = 0.07;
/// Minimum standard deviation of a range in the covariance, m: no laser and no wall is better, whatever the residuals show.
const MIN_NOISE: f64 = 0.001;
/// Minimum error of the direction of a surface, rad, a centimetre per metre: no wall is straighter. Information that such errors
/// could produce is not claimed.
const MIN_DIRECTION_ERROR: f64 = 0.01;

/// Projective data association with a robust kernel.
pub(super) struct Projective {
    range_noise: RangeNoise,
    estimates_noise: bool,
    /// SIMD level of the processor.
    level: Level,
    fitter: LineFitter,
    views: Vec<PlacedView>,
    /// Maximum number of views used.
    max_views: usize,
    /// The sensed scan.
    sensed: AllRays,
    /// The selected rays of the sensed scan.
    selected: Rays,
    guess: FirstGuess,
    prior: QuadraticForm,
    kernel_variance: f64,
    /// Consistency of the selected rays with the views.
    consistency: Vec<ViewConsistency>,
    /// Beams of a view that point towards the end points of the rays.
    beams: Vec<[u32; LANES]>,
    form: QuadraticForm,
    totals: Sums,
}

impl Projective {
    /// `noise`: minimum standard deviation of a range, m.
    pub(super) fn new(noise: f64) -> Self {
        Self {
            range_noise: RangeNoise::new(noise),
            estimates_noise: false,
            level: Level::new(),
            fitter: LineFitter::default(),
            views: Vec::new(),
            max_views: usize::MAX,
            sensed: AllRays::default(),
            selected: Rays::default(),
            guess: Pose2::IDENTITY.into(),
            prior: QuadraticForm::default(),
            kernel_variance: MIN_KERNEL_VARIANCE,
            consistency: Vec::new(),
            beams: Vec::new(),
            form: QuadraticForm::default(),
            totals: Sums::default(),
        }
    }

    /// Mean number of views that have a surface for a ray, at least one.
    fn views_per_ray(&self) -> f64 {
        (self.totals.of(Sum::Correspondences) / self.selected.len.max(1) as f64).max(1.0)
    }

    fn selected_views(&self) -> &[PlacedView] {
        &self.views[..self.views.len().min(self.max_views)]
    }

    /// Sums over the correspondences with one view. Everything is in units of the variance of a range, except the errors
    /// themselves, which are in m.
    #[inline(always)]
    #[allow(clippy::cast_possible_truncation)] // conversion to single precision
    fn sum<S: Simd>(&mut self, simd: S, view: usize, view_from_sensed: &Pose2) -> Sums {
        let projection = ViewProjection::new(&self.views[view].view, view_from_sensed);
        let noise = self.range_noise.standard_deviation();
        let squared_kernel_sigmas = (KERNEL_SIGMAS * noise).powi(2) as f32;
        let per_square = (noise * noise).recip() as f32;
        let kernel_variance = self.kernel_variance as f32;
        let zero = f32x8::splat(simd, 0.0);
        let mut sums = [zero; Sum::Count as usize];
        // A separate loop: in a single loop, every step would wait for the previous one, and the processor looks ahead too little
        // to overlap them.
        for (block, beams) in self.selected.blocks.iter().zip(&mut self.beams) {
            *beams = projection.beams(simd, block);
        }
        for ((block, consistency), beams) in self.selected.blocks.iter().zip(&mut self.consistency).zip(&self.beams) {
            let ProjectedBlock { point: [px, py], rotated, surfaces, error } = projection.pair(simd, block, beams);
            let inverse_square = f32x8::from_slice(simd, &block.inverse_square);
            // The padding after the last ray has no surface.
            let found = surfaces.is_some(simd) & inverse_square.simd_gt(0.0);
            let [nx, ny] = surfaces.normal;
            let facing = nx * rotated[0] + ny * rotated[1];
            let (squared, distance) = (error * error, error.abs());
            let variance = facing * facing * inverse_square + kernel_variance + surfaces.variance;
            let scale = variance * squared_kernel_sigmas;
            let chord = projection.rotated(simd, &block.chord);
            let across = nx.mul_add(chord[0], ny * chord[1]);
            let widened = across.mul_add(across, scale + squared);
            let one = found.select(f32x8::splat(simd, 1.0), zero);
            // Two quotients with a single division.
            let per_both = one / (variance * widened);
            let (kernel, by_variance) = (scale * variance * per_both, widened * per_both);
            let weight = kernel * kernel * by_variance * consistency.weight(simd);
            let inlier = squared.simd_lt(scale).select(one, zero);
            consistency.add(simd, one, inlier, distance);

            let mut add = |index: usize, factor: f32x8<S>, value: f32x8<S>| sums[index] = factor.mul_add(value, sums[index]);
            let a = [nx, ny, nx * px + ny * py, ny * px - nx * py];
            let mut index = Sum::Matrix as usize;
            for i in 0..4 {
                let wa = weight * a[i];
                add(Sum::Gradient as usize + i, wa, error);
                for &aj in &a[i..] {
                    add(index, wa, aj);
                    index += 1;
                }
            }
            let excess_weight = weight * by_variance;
            add(Sum::Squares as usize, weight, squared);
            add(Sum::Expected as usize, weight, variance);
            add(Sum::SpuriousInformation as usize, weight, surfaces.direction_variance);
            add(Sum::Excess as usize, excess_weight, squared.mul_sub(per_square, variance));
            add(Sum::Residuals as usize, inlier, distance);
            sums[Sum::ExcessWeights as usize] += excess_weight;
            sums[Sum::Weights as usize] += weight;
            sums[Sum::Inliers as usize] += inlier;
            sums[Sum::Correspondences as usize] += one;
        }
        let mut added = [0.0; Sum::Count as usize];
        for (added, sum) in added.iter_mut().zip(sums) {
            let (low, high) = sum.widen();
            *added = (low + high).reduce_sum();
        }
        Sums(added)
    }

    /// Updates the kernel variance for the next iteration, and returns whether it has settled.
    fn update_kernel_variance(&mut self) -> bool {
        let (now, excess_weights) = (self.kernel_variance, self.totals.of(Sum::ExcessWeights));
        let observed = now + self.totals.of(Sum::Excess) / excess_weights.max(f64::MIN_POSITIVE);
        let upper = if now > MAX_SURFACE_VARIANCE { (MAX_SHRINK * now).max(MAX_SURFACE_VARIANCE) } else { now };
        self.kernel_variance = observed.max(MIN_SHRINK * now).max(MIN_KERNEL_VARIANCE).min(upper);
        self.kernel_variance >= SETTLED_SHRINK * now
    }
}

#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // counts of rays, and conversion to single precision
impl DataAssociation for Projective {
    fn view(&mut self, scan: Scan) -> View {
        let noise = self.range_noise.standard_deviation();
        let surfaces = self.fitter.fit(self.level, &scan, noise);
        if self.estimates_noise
            && let Some(variance) = self.fitter.observed_variance(noise)
        {
            self.range_noise.observe(variance);
        }
        View::new(scan, surfaces)
    }

    fn estimate_noise(&mut self) {
        self.estimates_noise = true;
    }

    fn set_views(&mut self, views: &[PlacedView]) {
        self.views.clear();
        self.views.extend_from_slice(views);
    }

    fn begin(&mut self, guess: &FirstGuess) {
        self.guess = *guess;
        self.consistency.iter_mut().for_each(ViewConsistency::reset_weights);
        let noise = self.range_noise.standard_deviation();
        self.kernel_variance = (INITIAL_KERNEL_WIDTH / (KERNEL_SIGMAS * noise)).powi(2);
        let unit = RAY_CORRELATION * noise * noise;
        self.prior = guess.prior.map_or_else(QuadraticForm::default, |Prior { pose, covariance }| {
            QuadraticForm::from_prior(&pose, &covariance, unit)
        });
    }

    fn set_sensed(&mut self, scan: &Scan) {
        self.sensed.set(self.level, scan, self.range_noise.standard_deviation());
    }

    fn select_rays(&mut self, order: RayOrder, max_views: usize) {
        self.max_views = max_views;
        self.selected.select(&self.sensed.rays, order);
        self.beams.resize(self.selected.blocks.len(), [0; LANES]);
        self.consistency.resize(self.selected.blocks.len(), ViewConsistency::INITIAL);
        self.consistency.iter_mut().for_each(ViewConsistency::reset_weights);
    }

    fn ray_count(&self) -> usize {
        self.selected.len
    }

    fn find_correspondences(&mut self, pose: &Pose2) -> Option<Correspondences> {
        if self.views.is_empty() {
            return None;
        }
        self.consistency.iter_mut().for_each(ViewConsistency::reset_counts);
        (self.form, self.totals) = (QuadraticForm::default(), Sums::default());
        for view in 0..self.selected_views().len() {
            let reference_from_view = self.views[view].reference_from_view;
            let view_from_sensed = reference_from_view.between(pose);
            let level = self.level;
            let sums = dispatch!(level, simd => self.sum(simd, view, &view_from_sensed));
            self.form += sums.form(&view_from_sensed).in_parent_frame(&reference_from_view);
            self.totals += &sums;
        }
        // Several correspondences of one ray contain no more information than one, because the noise of the ray is the same in
        // all.
        let views_per_ray = self.views_per_ray();
        self.form = self.form.scaled(views_per_ray.recip());
        // A single view can contradict only the first guess, which is evidence only if there is a prior.
        if self.selected_views().len() > 1 || self.guess.prior.is_some() {
            self.consistency.iter_mut().for_each(ViewConsistency::update_weights);
        }
        let mut form = self.form;
        form += self.prior;
        form += self.constrain_free_direction(pose);
        let is_settled = self.update_kernel_variance();
        Some(Correspondences {
            form,
            count: (self.totals.of(Sum::Correspondences) / views_per_ray).round() as u32,
            inliers: (self.totals.of(Sum::Inliers) / views_per_ray).round() as u32,
            mean_residual: self.totals.of(Sum::Residuals) / self.totals.of(Sum::Inliers).max(1.0),
            fingerprint: None,
            is_kernel_settled: is_settled,
        })
    }

    fn uncertainty(&mut self, pose: &Pose2) -> Uncertainty {
        let variance =
            (self.totals.of(Sum::Squares) / self.totals.of(Sum::Expected).max(f64::MIN_POSITIVE)).max(MIN_NOISE * MIN_NOISE);
        let reference_rays: usize = self.selected_views().iter().map(|placed| placed.view.scan().valid_len()).sum();
        // The surfaces have noise, too, from all rays of the views: add it in the proportion of the numbers of rays.
        let both = 1.0 + self.selected.len as f64 / reference_rays.max(1) as f64;
        let free_direction = self.free_direction(pose, MIN_DIRECTION_ERROR);
        let information = 0.5 * self.form.linearize(pose).1;
        let measured =
            free_direction.map_or(information, |direction| remove_information(&information, &direction)) / (variance * both);
        let total = match self.guess.prior {
            Some(prior) => prior.covariance.try_inverse().map(|by_prior| measured + by_prior),
            None => Some(measured).filter(|_| free_direction.is_none()),
        };
        Uncertainty {
            covariance: total.and_then(Matrix3::try_inverse).filter(|covariance| covariance.iter().all(|v| v.is_finite())),
            condition_number: match free_direction {
                Some(_) => f64::INFINITY,
                None => condition_number(&information, self.selected.mean_range(self.level)),
            },
            free_direction,
            information: Some(measured),
        }
    }

    fn agreement(&self) -> Option<Agreement> {
        let within = |limit: f32| self.consistency.iter().map(|consistency| consistency.count_within(limit)).sum();
        Some(Agreement { agreeing: within(AGREEMENT_DISTANCE), visible: within(f32::INFINITY) })
    }

    fn kernel_variance(&self) -> f64 {
        self.kernel_variance
    }

    fn set_kernel_variance(&mut self, variance: f64) {
        self.kernel_variance = variance;
    }

    fn score(&self, pose: &Pose2) -> u32 {
        let Some(placed) = self.views.first() else { return 0 };
        let projection = ViewProjection::new(&placed.view, &placed.reference_from_view.between(pose));
        dispatch!(self.level, simd => projection.score(simd, &self.selected))
    }

    fn matched_points(&self, pose: &Pose2, points: &mut Vec<(Point, Point)>) {
        for placed in self.selected_views() {
            let view_from_sensed = placed.reference_from_view.between(pose).transform();
            let back = placed.reference_from_view.transform();
            let (bearings, surfaces) = (placed.view.bearings(), placed.view.surfaces());
            for point in self.selected.end_points() {
                let moved = view_from_sensed.apply(point.map(f64::from).into());
                let surface = &surfaces[bearings.beam(&moved)];
                let normal = Point::from(surface.normal().map(f64::from));
                let error = normal.dot(&moved) - f64::from(surface.offset());
                if !surface.is_none() && error.abs() < f64::from(AGREEMENT_DISTANCE) {
                    points.push((back.apply(moved), back.apply(moved - normal * error)));
                }
            }
        }
    }
}
