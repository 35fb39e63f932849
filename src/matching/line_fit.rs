//! Lines fitted to stretches of a scan: what two neighbouring points say of a wall drowns in their noise, what a whole stretch of it
//! says does not.
//!
//! A line `n . x = d` seen from the laser has the inverse range `1/r = (n . v)/d` along the unit vector v: linear in `n/d`, so that
//! a weighted linear least-squares fit finds it. A range of standard deviation sigma makes an inverse range of sigma/r^2: weight r^4.
//! Sums over any stretch are differences of running sums. The stretch around a ray grows as long as that makes its line surer: the
//! noise averages out, while what is no line shows as an excess of the residuals over the noise and does not. A ray near a corner,
//! where its own stretch is short, belongs to a longer one of its neighbours.

use super::view::Surface;
use crate::geometry::Point;
use crate::scan::Scan;

/// Longest stretch, rays to either side.
const LONGEST: usize = 32;
/// A point farther from a line than this many standard deviations is not on it.
const FARTHEST: f64 = 3.0;
/// What is more uneven is no surface: standard deviation, m.
const ROUGHEST: f64 = 0.1;
/// Points are paired with a surface up to so far along it from the place that it was fitted at, m: the lever of its direction's error.
const LEVER: f64 = 0.05;

/// Running sums over the rays: of `w v v'`, `w v / r` and `w / r^2`, with `w = r^4`.
#[derive(Clone, Copy, Debug, Default)]
struct Sums {
    xx: f64,
    xy: f64,
    yy: f64,
    x: f64,
    y: f64,
    inverse_squares: f64,
}

impl Sums {
    fn with(&self, point: Point) -> Self {
        let squared = point.norm_squared();
        Self {
            xx: self.xx + squared * point.x * point.x,
            xy: self.xy + squared * point.x * point.y,
            yy: self.yy + squared * point.y * point.y,
            x: self.x + squared * point.x,
            y: self.y + squared * point.y,
            inverse_squares: self.inverse_squares + squared,
        }
    }

    fn since(&self, start: &Self) -> Self {
        Self {
            xx: self.xx - start.xx,
            xy: self.xy - start.xy,
            yy: self.yy - start.yy,
            x: self.x - start.x,
            y: self.y - start.y,
            inverse_squares: self.inverse_squares - start.inverse_squares,
        }
    }

    /// `n/d` of the best line, and the sum of the squared range errors about it, m^2.
    fn fit(&self) -> (Point, f64) {
        let determinant = self.xx * self.yy - self.xy * self.xy;
        let a = (self.yy * self.x - self.xy * self.y) / determinant;
        let b = (self.xx * self.y - self.xy * self.x) / determinant;
        (Point::new(a, b), self.inverse_squares - a * self.x - b * self.y)
    }
}

/// Rays taken to be on one line.
#[derive(Clone, Copy, Debug)]
struct Stretch {
    start: usize,
    end: usize,
    normal: Point,
    offset: f64,
    /// Mean squared range error about the line beyond the noise's: what is uneven. In units of the noise's variance, as all that follows.
    excess: f64,
    /// Variance of the line's place in its middle, as a range.
    mean: f64,
    /// Variance of its direction, rad^2.
    turn: f64,
    /// Variance of a point's distance from it.
    variance: f64,
}

impl Stretch {
    /// The surface at ray `i`, whose point is given; `None` when that is not on it.
    fn surface(&self, i: usize, point: Point, noise: f64) -> Option<Surface> {
        let incidence = self.normal.dot(&point) / point.norm();
        let error = self.normal.dot(&point) - self.offset;
        let deviation = noise * incidence.abs() * (1.0 + self.excess).sqrt();
        if i < self.start || i >= self.end || error.abs() > FARTHEST * deviation {
            return None;
        }
        // A regression line is surest in the middle.
        let from_middle = (2.0 * i as f64 + 1.0 - (self.start + self.end) as f64) / (self.end - self.start) as f64;
        let place = self.excess + (1.0 + 3.0 * from_middle * from_middle) * self.mean;
        let variance = incidence * incidence * place + self.turn * (LEVER / noise).powi(2);
        #[allow(clippy::cast_possible_truncation)] // to single precision
        Some(Surface {
            normal: [self.normal.x as f32, self.normal.y as f32],
            offset: self.offset as f32,
            variance: variance as f32,
            turn_variance: self.turn as f32,
        })
    }
}

/// Fits lines; keeps the memory that takes.
#[derive(Debug, Default)]
pub(super) struct LineFitter {
    points: Vec<Point>,
    beams: Vec<usize>,
    running: Vec<Sums>,
    stretches: Vec<Option<Stretch>>,
}

impl LineFitter {
    /// The surface at each beam of a scan. `noise`: standard deviation of a range, m.
    pub(super) fn fit(&mut self, scan: &Scan, noise: f64, surfaces: &mut Vec<Surface>) {
        self.points.clear();
        self.beams.clear();
        self.running.clear();
        let mut sums = Sums::default();
        self.running.push(sums);
        for (beam, direction, range) in scan.rays() {
            let point = direction * range;
            sums = sums.with(point);
            self.points.push(point);
            self.beams.push(beam);
            self.running.push(sums);
        }
        self.find_stretches(noise);
        surfaces.clear();
        surfaces.resize(scan.len(), Surface::NONE);
        self.spread(noise, surfaces, 0..self.points.len());
        self.spread(noise, surfaces, (0..self.points.len()).rev());
    }

    /// The stretch with each ray in its middle that fixes its line best. Where the last ray's ended, the next one's is sought.
    fn find_stretches(&mut self, noise: f64) {
        self.stretches.clear();
        let mut reach = 1;
        for i in 0..self.points.len() {
            let mut best = self.stretch(i, reach, noise);
            let first = reach;
            while reach < LONGEST {
                let longer = self.stretch(i, 2 * reach, noise);
                if !is_surer(longer.as_ref(), best.as_ref()) {
                    break;
                }
                (best, reach) = (longer, 2 * reach);
            }
            while reach <= first && reach > 1 {
                let shorter = self.stretch(i, reach / 2, noise);
                if is_surer(best.as_ref(), shorter.as_ref()) {
                    break;
                }
                (best, reach) = (shorter, reach / 2);
            }
            self.stretches.push(best);
        }
    }

    /// Gives each ray the surface of its own stretch, or of the best one that the way over the rays has come by and that reaches up to it.
    fn spread(&self, noise: f64, surfaces: &mut [Surface], rays: impl Iterator<Item = usize>) {
        let mut carried: Option<Stretch> = None;
        for i in rays {
            let point = self.points[i];
            let of = |stretch: Option<Stretch>| stretch.and_then(|s| Some((s, s.surface(i, point, noise)?)));
            let own = of(self.stretches[i]);
            let known = of(carried);
            let best = match (own, known) {
                (Some(own), Some(known)) => Some(if known.1.variance < own.1.variance { known } else { own }),
                (own, known) => own.or(known),
            };
            if let Some((stretch, surface)) = best {
                carried = Some(stretch);
                let place = &mut surfaces[self.beams[i]];
                if surface.variance < place.variance {
                    *place = surface;
                }
            }
        }
    }

    /// The line through the rays up to `reach` from ray `i`, if there is any.
    fn stretch(&self, i: usize, reach: usize, noise: f64) -> Option<Stretch> {
        let (start, end) = (i.saturating_sub(reach), (i + reach + 1).min(self.points.len()));
        let rays = end - start;
        let degrees = rays.checked_sub(2).filter(|&degrees| degrees > 0)? as f64;
        let (inverse, squared_errors) = self.running[end].since(&self.running[start]).fit();
        let offset = inverse.norm().recip();
        let normal = inverse * offset;
        let point = self.points[i];
        let squared_incidence = normal.dot(&point).powi(2) / point.norm_squared();
        let observed = squared_errors / (degrees * noise * noise);
        let excess = (observed - 1.0).max(0.0);
        let mean = observed.max(1.0) / rays as f64;
        let squared_length = (self.points[end - 1] - self.points[start]).norm_squared();
        // Variance of the slope of a regression over evenly spaced points.
        let turn = 12.0 * squared_incidence * (mean + excess) * noise * noise / squared_length;
        let variance = squared_incidence * (mean + excess) + turn * (LEVER / noise).powi(2);
        let is_surface = excess * squared_incidence * noise * noise < ROUGHEST * ROUGHEST;
        (is_surface && variance.is_finite()).then_some(Stretch { start, end, normal, offset, excess, mean, turn, variance })
    }
}

fn is_surer(one: Option<&Stretch>, other: Option<&Stretch>) -> bool {
    match (one, other) {
        (Some(one), Some(other)) => one.variance < other.variance,
        (one, _) => one.is_some(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::BeamGeometry;
    use crate::time::Stamp;

    /// What a laser at the origin sees of a corner of two walls, x = 2 and y = 1.
    fn corner(lone: Option<usize>) -> Scan {
        let beams = BeamGeometry::new(0.0, 1_f64.to_radians(), 91);
        let ranges = beams.directions().iter().enumerate();
        let ranges = ranges.map(|(i, v)| if lone == Some(i) { 0.5 } else { (2.0 / v.x).min(1.0 / v.y) }).collect::<Vec<_>>();
        Scan::new(Stamp::default(), beams.into(), (0.0, 100.0), ranges).unwrap()
    }

    fn surfaces(scan: &Scan, noise: f64) -> Vec<Surface> {
        let mut surfaces = Vec::new();
        LineFitter::default().fit(scan, noise, &mut surfaces);
        surfaces
    }

    #[test]
    fn walls_are_found_up_to_their_corner() {
        let corner_at = 1.0_f64.atan2(2.0).to_degrees();
        for (i, surface) in surfaces(&corner(None), 1e-4).iter().enumerate() {
            let wall = if (i as f64) < corner_at { ([1.0, 0.0], 2.0) } else { ([0.0, 1.0], 1.0) };
            let near = (0..2).all(|k| (surface.normal[k] - wall.0[k]).abs() < 1e-3) && (surface.offset - wall.1).abs() < 1e-3;
            assert!(near, "{i}: {surface:?}");
        }
    }

    #[test]
    fn a_lone_point_is_no_surface() {
        let surfaces = surfaces(&corner(Some(10)), 0.01);
        assert!(surfaces[10].is_none() && !surfaces[9].is_none() && !surfaces[11].is_none());
    }
}
