//! Line fitting: finds the surface at each beam of a scan by fitting a line to a stretch, which is a run of consecutive rays. The
//! line through two neighbouring points would be dominated by their noise.
//!
//! A line `n . x = d` seen from the laser has the inverse range `1/r = (n . v)/d` along the unit vector v. This is linear in
//! `n/d`, so a weighted linear least-squares fit finds it. A range of standard deviation sigma makes an inverse range of standard
//! deviation sigma/r^2, hence the weight r^4. The sums over any stretch are differences of running sums.
//!
//! Of several stretches around a ray, the one that makes the line most certain is chosen. Over a longer stretch the noise
//! averages out, but if the rays do not lie on a line, the residuals exceed the noise and do not average out. A ray near a
//! corner, whose own stretch is short, is assigned to a longer stretch of one of its neighbours.

mod fit;
mod fitted_line;
mod padded;
mod summed_rays;

use fearless_simd::{Level, dispatch, prelude::*};

use crate::matching::surface::{LANES, Surface};
use crate::quantile::quantile;
use crate::scan::Scan;
use fitted_line::{FIELDS, FittedLine};
use padded::Padded;
use summed_rays::SummedRays;

/// Rays to either side of the middle of the longest stretch. Each shorter stretch has half as many.
const MAX_REACH: usize = 32;
/// A ray may be assigned to the stretches of the rays at these distances, in rays, to either side.
const NEIGHBOURS: [usize; 6] = [1, 2, 4, 8, 16, MAX_REACH - 1];
/// Lever arm of the direction error of a line, m: points are paired with a surface up to this distance along it from where it was
/// fitted.
const LEVER_ARM: f32 = 0.05;

/// Minimum number of rays of a line that is used to estimate the range noise.
const MIN_RAYS: f32 = 32.0;
/// The noise is estimated from the line of every this many rays, because neighbouring lines are nearly the same.
const SAMPLE_STRIDE: usize = 8;
/// Minimum number of such lines for a noise estimate. With fewer, white noise does not average out, and it alone would decide.
const MIN_SAMPLES: usize = 64;

/// Number of rays processed at a time in double precision.
const HALF: usize = LANES / 2;

/// Fits lines, and keeps its buffers from scan to scan.
#[derive(Debug, Default)]
pub(super) struct LineFitter {
    rays: SummedRays,
    /// The line with each ray in its middle, by field of [`FittedLine`] and by ray.
    lines: [Padded<f32>; FIELDS],
    /// Mean squared range errors of the lines used to estimate the noise.
    errors: Vec<f32>,
}

impl LineFitter {
    /// The surface at each beam of a scan. `noise`: standard deviation of a range, m.
    #[allow(clippy::cast_possible_truncation)] // conversion to single precision
    pub(super) fn fit(&mut self, level: Level, scan: &Scan, noise: f64) -> Vec<Surface> {
        let mut surfaces = Vec::with_capacity(scan.len() + 1); // the view adds one
        surfaces.resize(scan.len(), Surface::NONE);
        if scan.valid_len() > 0 {
            self.rays.set(scan);
            let noise = (noise * noise) as f32;
            dispatch!(level, simd => self.rays.sum(simd));
            dispatch!(level, simd => self.find_lines(simd, noise));
            dispatch!(level, simd => self.find_surfaces(simd, noise, &mut surfaces));
        }
        surfaces
    }

    /// The range variance that the last scan shows, m^2: the median over lines of many rays. `None`: there are too few such
    /// lines. `noise`: the standard deviation that the scan was fitted with, m.
    pub(super) fn observed_variance(&mut self, noise: f64) -> Option<f64> {
        let [_, per_ray, _, _, _, observed, direction_variance] = self.lines.each_mut().map(Padded::values);
        let sampled = (0..self.rays.beams.len()).step_by(SAMPLE_STRIDE);
        let with_many_rays = sampled.filter(|&ray| per_ray[ray] * MIN_RAYS < 2.0 && direction_variance[ray] < f32::INFINITY);
        self.errors.clear();
        self.errors.extend(with_many_rays.map(|ray| observed[ray]));
        let median = quantile(&mut self.errors, 0.5, f32::total_cmp).filter(|_| self.errors.len() >= MIN_SAMPLES)?;
        Some(f64::from(median) * noise * noise)
    }

    /// Finds the most certain line that has each ray in its middle.
    #[inline(always)]
    fn find_lines<S: Simd>(&mut self, simd: S, noise: f32) {
        let len = self.rays.beams.len();
        self.lines.iter_mut().for_each(|values| values.resize(len));
        for first in (0..len).step_by(LANES) {
            let lines = self.rays.window(simd, first, noise).best_lines(simd);
            for (value, values) in lines.values().into_iter().zip(&mut self.lines) {
                value.store_slice(values.block(first));
            }
        }
        self.lines.iter_mut().for_each(|values| values.pad(0.0, 0.0));
        let direction_variance = &mut self.lines[FIELDS - 1];
        direction_variance.pad(f32::INFINITY, f32::INFINITY);
    }

    /// Finds the best surface for each ray: from its own line or that of a neighbour.
    #[inline(always)]
    fn find_surfaces<S: Simd>(&self, simd: S, noise: f32, surfaces: &mut [Surface]) {
        for (block, beams) in self.rays.beams.chunks(LANES).enumerate() {
            let first = block * LANES;
            let rays = self.rays.window(simd, first, noise);
            let field = |field: usize| self.lines[field].window(first);
            let lines = [field(0), field(1), field(2), field(3), field(4), field(5), field(6)];
            let mut best = FittedLine::at(simd, &lines, MAX_REACH).surfaces(simd, &rays);
            for neighbour in NEIGHBOURS {
                for start in [MAX_REACH - neighbour, MAX_REACH + neighbour] {
                    best = best.or_better(FittedLine::at(simd, &lines, start).surfaces(simd, &rays));
                }
            }
            best.direction_variance *= noise / (LEVER_ARM * LEVER_ARM);
            best.scatter(simd, surfaces, beams);
        }
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_distr::{Distribution, Normal};
    use rand_pcg::Pcg64;

    use super::*;
    use crate::geometry::Point;
    use crate::scan::BeamGeometry;
    use crate::time::Stamp;

    /// Scan, from the origin, of a corner of two walls, x = 2 and y = 1.
    fn corner(lone: Option<usize>) -> Scan {
        let beams = BeamGeometry::new(0.0, 1_f64.to_radians(), 91);
        let ranges = beams.directions().iter().enumerate();
        let ranges = ranges.map(|(i, v)| if lone == Some(i) { 0.5 } else { (2.0 / v.x).min(1.0 / v.y) }).collect::<Vec<_>>();
        Scan::new(Stamp::default(), beams.into(), (0.0, 100.0), ranges).unwrap()
    }

    fn surfaces(scan: &Scan, noise: f64) -> Vec<Surface> {
        LineFitter::default().fit(Level::new(), scan, noise)
    }

    #[test]
    fn walls_are_found_up_to_the_corner() {
        let corner_at = 1.0_f64.atan2(2.0).to_degrees();
        for (i, surface) in surfaces(&corner(None), 1e-4).iter().enumerate() {
            let wall = if (i as f64) < corner_at { ([1.0, 0.0], 2.0) } else { ([0.0, 1.0], 1.0) };
            let near = (0..2).all(|k| (surface.normal()[k] - wall.0[k]).abs() < 1e-3) && (surface.offset() - wall.1).abs() < 1e-3;
            assert!(near, "{i}: {surface:?}");
        }
    }

    #[test]
    fn an_isolated_point_is_no_surface() {
        let surfaces = surfaces(&corner(Some(10)), 0.01);
        assert!(surfaces[10].is_none() && !surfaces[9].is_none() && !surfaces[11].is_none());
    }

    /// Scan from the middle of a square room of 10 m. `noise`: standard deviation of the ranges, m.
    fn square_room(beams: usize, noise: f64) -> Scan {
        let beams = BeamGeometry::new(-2.3, 4.6 / beams as f64, beams);
        let (normal, mut random) = (Normal::new(0.0, noise).unwrap(), Pcg64::seed_from_u64(3));
        let range = |v: &Point| 5.0 / v.x.abs().max(v.y.abs()) + normal.sample(&mut random);
        let ranges = beams.directions().iter().map(range).collect::<Vec<_>>();
        Scan::new(Stamp::default(), beams.into(), (0.0, 100.0), ranges).unwrap()
    }

    #[test]
    fn the_noise_is_estimated_from_lines_of_many_rays() {
        let mut fitter = LineFitter::default();
        for (beams, noise, assumed) in [(1081, 0.02, 0.01), (1081, 0.005, 0.01), (4000, 0.03, 0.03)] {
            fitter.fit(Level::new(), &square_room(beams, noise), assumed);
            let shown = fitter.observed_variance(assumed).unwrap().sqrt();
            assert!((shown / noise - 1.0).abs() < 0.15, "{beams} beams, {noise} m: {shown} m");
        }
        fitter.fit(Level::new(), &square_room(361, 0.02), 0.01);
        assert_eq!(fitter.observed_variance(0.01), None, "too few rays");
    }
}
