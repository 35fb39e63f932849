//! Pairs a point with the surface that the reference laser saw in its direction: no nearest neighbour, but what would have been
//! measured there. Far errors lose their weight by degrees (the kernel of Geman and `McClure` 1987) instead of being cut off.
//!
//! The squared error of a pair is weighed by its variance, in units of a range's: `cos^2(incidence)` of the sensed range, the
//! surface's own, and a floor that is the same for all. The floor is what the pairs themselves show beyond the rest. At first that
//! is the error of the guess: all weigh alike, and the kernel is wide. As the scans come to lie on each other it falls to what
//! surfaces are uneven, and grazing rays, which know best, count.
//!
//! A ray is judged by the direction, too, in which the rays beside it say that its surface runs: one that ends near a surface, but on another
//! that meets it at an angle, as in the corner that a robot drives round, weighs less.
//!
//! What moves is where one view saw it, and not where the others did: a ray that lies on the surface in some of the views that have one
//! for it, and not in the rest, weighs less.

mod chords;
mod line_fit;
mod onto;
mod range_noise;
mod rays;
mod sums;
mod verdict;

#[cfg(test)]
mod specification;

use fearless_simd::{Level, Simd, dispatch, f32x8, prelude::*};
use nalgebra::{Matrix2, Matrix3, Vector3};

use super::pairing::{Agreement, Pairing, Pairs, PlacedView};
use super::ray_order::RayOrder;
use super::solver::{Metric, QuadraticForm};
use super::surface::LANES;
use super::symmetric_eigen::SymmetricEigen;
use super::uncertainty::{Uncertainty, condition_number};
use super::view::View;
use super::{FirstGuess, Prior};
use crate::geometry::{Point, Pose2};
use crate::scan::Scan;
use line_fit::LineFitter;
use onto::{Moved, Onto};
use range_noise::RangeNoise;
use rays::{AllRays, Rays};
use sums::{Sum, Sums};
use verdict::Verdict;

/// An error of so many standard deviations has a quarter of its weight.
const KERNEL_SIGMAS: f64 = 3.0;
/// That error for the first pairs, m.
const FIRST_WIDTH: f64 = 0.3;
/// From iteration to iteration the floor falls to this part of it at least: what fits first need not fit best.
const STEEPEST: f64 = 0.08;
/// And to this part of it at most, while it is above [`MOST_FLOOR`] ...
const GENTLEST: f64 = 0.5;
/// ... which stands for 3 cm: what errs more is no unevenness, but something that has moved.
const MOST_FLOOR: f64 = 9.0;
/// The floor has come to rest when it falls to no less than this part of it.
const RESTING: f64 = 0.7;
/// Least floor, in units of a range's variance: surfaces are uneven, beams are wide.
const LEAST_FLOOR: f64 = 0.15;
/// The pairs of neighbouring rays err alike, so that all together know less than their variances say: by this factor of the variance.
const DEPENDENCE: f64 = 3.0;
/// A ray agrees with a surface that it ends this near to, m.
const AGREEMENT: f32 = 0.07;
/// No laser and no wall is better than this, m, whatever the pairs show: standard deviation of a range.
const LEAST_NOISE: f64 = 0.001;
/// Nor is any wall straighter than this, rad: a centimetre in a metre. What pairs know by less is not claimed.
const LEAST_TURN: f64 = 0.01;
/// A direction in which the pairs know so many times what errors of the surfaces' directions feign is not seen at all.
const FEIGNED: f64 = 4.0;

pub(super) struct Projective {
    range_noise: RangeNoise,
    learns_noise: bool,
    /// What the processor can do.
    level: Level,
    fitter: LineFitter,
    views: Vec<PlacedView>,
    /// Views that take part at most.
    most_views: usize,
    /// The sensed scan.
    sensed: AllRays,
    /// The rays of it that take part.
    chosen: Rays,
    guess: FirstGuess,
    prior: QuadraticForm,
    floor: f64,
    /// How the views judge the rays that take part.
    verdicts: Vec<Verdict>,
    /// Beams of a view that look where the rays end.
    beams: Vec<[u32; LANES]>,
    form: QuadraticForm,
    totals: Sums,
}

impl Projective {
    /// `noise`: standard deviation of a range at least, m.
    pub(super) fn new(noise: f64) -> Self {
        Self {
            range_noise: RangeNoise::new(noise),
            learns_noise: false,
            level: Level::new(),
            fitter: LineFitter::default(),
            views: Vec::new(),
            most_views: usize::MAX,
            sensed: AllRays::default(),
            chosen: Rays::default(),
            guess: Pose2::IDENTITY.into(),
            prior: QuadraticForm::default(),
            floor: LEAST_FLOOR,
            verdicts: Vec::new(),
            beams: Vec::new(),
            form: QuadraticForm::default(),
            totals: Sums::default(),
        }
    }

    /// Views that have a surface for a ray, on the average; one at least.
    fn views_per_ray(&self) -> f64 {
        (self.totals.of(Sum::Pairs) / self.chosen.len.max(1) as f64).max(1.0)
    }

    fn chosen_views(&self) -> &[PlacedView] {
        &self.views[..self.views.len().min(self.most_views)]
    }

    /// The sums over the pairs with one view. Everything is in units of the noise's variance but the errors themselves, m.
    #[inline(always)]
    #[allow(clippy::cast_possible_truncation)] // to single precision
    fn sum<S: Simd>(&mut self, simd: S, view: usize, view_from_sensed: &Pose2) -> Sums {
        let onto = Onto::new(&self.views[view].view, view_from_sensed);
        let noise = self.range_noise.deviation();
        let kernel_width = (KERNEL_SIGMAS * noise).powi(2) as f32;
        let per_square = (noise * noise).recip() as f32;
        let floor = self.floor as f32;
        let zero = f32x8::splat(simd, 0.0);
        let mut sums = [zero; Sum::Count as usize];
        // Beforehand: as one loop, every step would wait for the one before, and a processor sees too little ahead to do others meanwhile.
        for (block, beams) in self.chosen.blocks.iter().zip(&mut self.beams) {
            *beams = onto.beams(simd, block);
        }
        for ((block, verdict), beams) in self.chosen.blocks.iter().zip(&mut self.verdicts).zip(&self.beams) {
            let Moved { point: [px, py], turned, partners, error } = onto.pair(simd, block, beams);
            let inverse_square = f32x8::from_slice(simd, &block.inverse_square);
            // The lanes past the last ray have none.
            let found = partners.is_some(simd) & inverse_square.simd_gt(0.0);
            let [nx, ny] = partners.normal;
            let facing = nx * turned[0] + ny * turned[1];
            let (squared, distance) = (error * error, error.abs());
            let variance = facing * facing * inverse_square + floor + partners.variance;
            let scale = variance * kernel_width;
            let chord = onto.turned(simd, &block.chord);
            let across = nx.mul_add(chord[0], ny * chord[1]);
            let widened = across.mul_add(across, scale + squared);
            let one = found.select(f32x8::splat(simd, 1.0), zero);
            // Two divisions for the price of one.
            let per_both = one / (variance * widened);
            let (kernel, by_variance) = (scale * variance * per_both, widened * per_both);
            let weight = kernel * kernel * by_variance * verdict.credit(simd);
            let inlier = squared.simd_lt(scale).select(one, zero);
            verdict.add(simd, one, inlier, distance);

            let mut add = |place: usize, factor: f32x8<S>, value: f32x8<S>| sums[place] = factor.mul_add(value, sums[place]);
            let a = [nx, ny, nx * px + ny * py, ny * px - nx * py];
            let mut place = Sum::Matrix as usize;
            for i in 0..4 {
                let wa = weight * a[i];
                add(Sum::Gradient as usize + i, wa, error);
                for &aj in &a[i..] {
                    add(place, wa, aj);
                    place += 1;
                }
            }
            let excess_weight = weight * by_variance;
            add(Sum::Squares as usize, weight, squared);
            add(Sum::Expected as usize, weight, variance);
            add(Sum::Feigned as usize, weight, partners.turn_variance);
            add(Sum::Excess as usize, excess_weight, squared.mul_sub(per_square, variance));
            add(Sum::Residuals as usize, inlier, distance);
            sums[Sum::ExcessWeights as usize] += excess_weight;
            sums[Sum::Weights as usize] += weight;
            sums[Sum::Inliers as usize] += inlier;
            sums[Sum::Pairs as usize] += one;
        }
        let mut added = [0.0; Sum::Count as usize];
        for (added, sum) in added.iter_mut().zip(sums) {
            let (low, high) = sum.widen();
            *added = (low + high).reduce_sum();
        }
        Sums(added)
    }

    /// The floor for the next pairs, and whether it has come to rest.
    fn lower_floor(&mut self) -> bool {
        let shown = self.floor + self.totals.of(Sum::Excess) / self.totals.of(Sum::ExcessWeights).max(f64::MIN_POSITIVE);
        let gentlest = if self.floor > MOST_FLOOR { (GENTLEST * self.floor).max(MOST_FLOOR) } else { self.floor };
        let floor = shown.max(STEEPEST * self.floor).max(LEAST_FLOOR).min(gentlest);
        let resting = floor >= RESTING * self.floor;
        self.floor = floor;
        resting
    }

    /// The translation that the pairs leave open, if any: a unit vector. What errors of the surfaces' directions feign to know of it is
    /// not knowledge: those of their fits, and so much that no wall is straighter, rad.
    fn free_direction(&self, pose: &Pose2, crooked: f64) -> Option<Point> {
        let information = 0.5 * self.form.linearize(pose).1;
        let coupling = information.fixed_view::<2, 1>(0, 2);
        let translation = information.fixed_view::<2, 2>(0, 0) - coupling * coupling.transpose() / information.m33;
        let eigen = SymmetricEigen::of(&Matrix2::from(translation));
        let feigned = (self.totals.of(Sum::Feigned) + crooked * crooked * self.totals.of(Sum::Weights)) / self.views_per_ray();
        (eigen.values.x < FEIGNED * feigned).then_some(eigen.minor)
    }

    /// What holds the pose where the pairs do not.
    fn hold(&self, pose: &Pose2) -> QuadraticForm {
        // Pairs that know little still know more than nothing.
        let Some(direction) = self.free_direction(pose, 0.0) else { return QuadraticForm::default() };
        let known = self.guess.prior.map_or(self.guess.pose, |prior| prior.pose);
        let mut form = QuadraticForm::default();
        // The line through what is known, at right angles to the direction, as if the pairs that have told of the rest all lay on it.
        form.add_line(Point::zeros(), direction, direction.dot(&known.translation()), self.totals.of(Sum::Expected));
        form
    }
}

/// What is left of an information matrix when nothing is known along a direction of the translation: what single precision has left there
/// of differences of large numbers may be less than zero, too.
fn without(information: &Matrix3<f64>, direction: &Point) -> Matrix3<f64> {
    let open = Vector3::new(direction.x, direction.y, 0.0);
    let rest = Matrix3::identity() - open * open.transpose();
    rest * information * rest
}

#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // counts of rays, and to single precision
impl Pairing for Projective {
    fn view(&mut self, scan: Scan) -> View {
        let mut surfaces = Vec::with_capacity(scan.len() + 1);
        let noise = self.range_noise.deviation();
        self.fitter.fit(&scan, noise, &mut surfaces);
        if self.learns_noise
            && let Some(variance) = self.fitter.shown_variance(noise)
        {
            self.range_noise.observe(variance);
        }
        View::new(scan, surfaces)
    }

    fn learn_noise(&mut self) {
        self.learns_noise = true;
    }

    fn set_views(&mut self, views: &[PlacedView]) {
        self.views.clear();
        self.views.extend_from_slice(views);
    }

    fn begin(&mut self, guess: &FirstGuess) {
        self.guess = *guess;
        self.verdicts.iter_mut().for_each(Verdict::forget);
        let noise = self.range_noise.deviation();
        self.floor = (FIRST_WIDTH / (KERNEL_SIGMAS * noise)).powi(2);
        let unit = DEPENDENCE * noise * noise;
        self.prior = guess
            .prior
            .map_or_else(QuadraticForm::default, |Prior { pose, covariance }| QuadraticForm::of_prior(&pose, &covariance, unit));
    }

    fn sense(&mut self, scan: &Scan) {
        self.sensed.set(self.level, scan, self.range_noise.deviation());
    }

    fn choose_rays(&mut self, order: RayOrder) {
        self.chosen.choose(&self.sensed.rays, order);
        self.beams.resize(self.chosen.blocks.len(), [0; LANES]);
        self.verdicts.resize(self.chosen.blocks.len(), Verdict::NONE);
        self.verdicts.iter_mut().for_each(Verdict::forget);
    }

    fn choose_views(&mut self, at_most: usize) {
        self.most_views = at_most;
    }

    fn rays(&self) -> usize {
        self.chosen.len
    }

    fn pair(&mut self, pose: &Pose2, _metric: Metric) -> Option<Pairs> {
        if self.views.is_empty() {
            return None;
        }
        self.verdicts.iter_mut().for_each(Verdict::begin);
        (self.form, self.totals) = (QuadraticForm::default(), Sums::default());
        for view in 0..self.chosen_views().len() {
            let reference_from_view = self.views[view].reference_from_view;
            let view_from_sensed = reference_from_view.between(pose);
            let level = self.level;
            let sums = dispatch!(level, simd => self.sum(simd, view, &view_from_sensed));
            self.form += sums.form(&view_from_sensed).seen_from(&reference_from_view);
            self.totals += &sums;
        }
        // A ray that several views have surfaces for is no better known than one: its own noise is the same for all.
        let views_per_ray = self.views_per_ray();
        self.form = self.form.scaled(views_per_ray.recip());
        // One view alone contradicts nothing but the first guess, which says something where there is a prior.
        if self.chosen_views().len() > 1 || self.guess.prior.is_some() {
            self.verdicts.iter_mut().for_each(Verdict::conclude);
        }
        let mut form = self.form;
        form += self.prior;
        form += self.hold(pose);
        let resting = self.lower_floor();
        Some(Pairs {
            form,
            correspondences: (self.totals.of(Sum::Pairs) / views_per_ray).round() as u32,
            inliers: (self.totals.of(Sum::Inliers) / views_per_ray).round() as u32,
            mean_residual: self.totals.of(Sum::Residuals) / self.totals.of(Sum::Inliers).max(1.0),
            fingerprint: None,
            settled: resting,
        })
    }

    fn uncertainty(&mut self, pose: &Pose2, _metric: Metric) -> Uncertainty {
        let noise =
            (self.totals.of(Sum::Squares) / self.totals.of(Sum::Expected).max(f64::MIN_POSITIVE)).max(LEAST_NOISE * LEAST_NOISE);
        let reference_rays: usize = self.chosen_views().iter().map(|placed| placed.view.scan().valid_len()).sum();
        // What the sensed rays that take part add of noise, the reference's have added to the surfaces, all of them.
        let both = 1.0 + self.chosen.len as f64 / reference_rays.max(1) as f64;
        let free_direction = self.free_direction(pose, LEAST_TURN);
        let information = 0.5 * self.form.linearize(pose).1;
        let seen = free_direction.map_or(information, |direction| without(&information, &direction)) / (noise * both);
        let known = match self.guess.prior {
            Some(prior) => prior.covariance.try_inverse().map(|by_prior| seen + by_prior),
            None => Some(seen).filter(|_| free_direction.is_none()),
        };
        Uncertainty {
            covariance: known.and_then(Matrix3::try_inverse).filter(|covariance| covariance.iter().all(|v| v.is_finite())),
            condition_number: match free_direction {
                Some(_) => f64::INFINITY,
                None => condition_number(&information, self.chosen.mean_range(self.level)),
            },
            free_direction,
            information: Some(seen),
        }
    }

    fn agreement(&self) -> Option<Agreement> {
        let within = |limit: f32| self.verdicts.iter().map(|verdict| verdict.within(limit)).sum();
        Some(Agreement { agreeing: within(AGREEMENT), seen: within(f32::INFINITY) })
    }

    fn width(&self) -> f64 {
        self.floor
    }

    fn set_width(&mut self, width: f64) {
        self.floor = width;
    }

    fn score(&self, pose: &Pose2) -> u32 {
        let Some(placed) = self.views.first() else { return 0 };
        let onto = Onto::new(&placed.view, &placed.reference_from_view.between(pose));
        dispatch!(self.level, simd => onto.score(simd, &self.chosen))
    }

    fn matched_points(&self, pose: &Pose2, points: &mut Vec<(Point, Point)>) {
        for placed in self.chosen_views() {
            let view_from_sensed = placed.reference_from_view.between(pose).transform();
            let back = placed.reference_from_view.transform();
            let (bearings, surfaces) = (placed.view.bearings(), placed.view.surfaces());
            for point in self.chosen.ends() {
                let seen = view_from_sensed.apply(point.map(f64::from).into());
                let surface = &surfaces[bearings.beam(&seen)];
                let normal = Point::from(surface.normal().map(f64::from));
                let error = normal.dot(&seen) - f64::from(surface.offset());
                if !surface.is_none() && error.abs() < f64::from(AGREEMENT) {
                    points.push((back.apply(seen), back.apply(seen - normal * error)));
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_rounding_feigns_along_an_open_direction_is_not_known() {
        // A wall along the direction 0.6, 0.8, and a little less than nothing along it.
        let (wall, open) = (Vector3::new(0.8, -0.6, 3.0), Vector3::new(0.6, 0.8, 0.0));
        let information = 1e8 * wall * wall.transpose() - 25.0 * open * open.transpose();
        let left = without(&information, &Point::new(0.6, 0.8));
        assert!((left * open).norm() < 1e-6, "{left}");
        let known = left + Matrix3::identity() / 30.0;
        assert!(known.cholesky().is_some(), "{known}");
    }
}
