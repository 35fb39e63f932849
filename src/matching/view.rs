//! What a laser saw from one place, ready to be matched to: at every beam, the surface that it met.

use std::f64::consts::TAU;

use wide::f32x8;

use super::line_fit::LineFitter;
use crate::geometry::Point;
use crate::scan::Scan;

/// Variance of a surface that is none: it weighs nothing.
const NO_VARIANCE: f32 = 1e30;

/// The line that a beam met, in the laser's frame. Single precision holds micrometres.
#[derive(Clone, Copy, Debug)]
pub(super) struct Surface {
    /// Unit normal.
    pub(super) normal: [f32; 2],
    /// The line is where `normal . x` has this value, m.
    pub(super) offset: f32,
    /// Variance of a point's distance from it, its own noise left out, in units of a range's variance.
    pub(super) variance: f32,
    /// Variance of its direction, rad^2.
    pub(super) turn_variance: f32,
}

impl Surface {
    /// No measurement, a corner, a lone point.
    pub(super) const NONE: Self = Self { normal: [0.0; 2], offset: 0.0, variance: NO_VARIANCE, turn_variance: 0.0 };

    pub(super) fn is_none(&self) -> bool {
        self.variance >= NO_VARIANCE
    }
}

/// A scan with the surfaces that were fitted to it.
#[derive(Clone, Debug)]
pub struct View {
    scan: Scan,
    /// By beam; one more at the end, for all that is out of sight.
    surfaces: Vec<Surface>,
}

impl View {
    /// Fits the surfaces of a scan. `noise`: standard deviation of a range, m.
    pub(super) fn of(scan: &Scan, noise: f64, fitter: &mut LineFitter) -> Self {
        let mut surfaces = Vec::with_capacity(scan.len() + 1);
        fitter.fit(scan, noise, &mut surfaces);
        surfaces.push(Surface::NONE);
        let mut view = Self { scan: scan.clone(), surfaces };
        if !scan.beams().is_even() {
            view.sort_by_bearing();
        }
        view
    }

    /// Puts the surfaces where the beams of even spacing would be.
    fn sort_by_bearing(&mut self) {
        let bearings = self.bearings();
        let mut sorted = vec![Surface::NONE; self.surfaces.len()];
        for (direction, surface) in self.scan.beams().directions().iter().zip(&self.surfaces) {
            let place = bearings.beam(direction);
            if place < self.scan.len() && surface.variance < sorted[place].variance {
                sorted[place] = *surface;
            }
        }
        // Where beams are farther apart than even ones, one place now and then has none.
        for i in 1..self.scan.len() {
            if sorted[i].is_none() && !sorted[i + 1].is_none() {
                sorted[i] = sorted[i - 1];
            }
        }
        self.surfaces = sorted;
    }

    /// The scan itself.
    pub fn scan(&self) -> &Scan {
        &self.scan
    }

    /// Points of the scan, m, in the laser's frame.
    pub fn points(&self) -> impl Iterator<Item = Point> + '_ {
        self.scan.rays().map(|(_, direction, range)| direction * range)
    }

    pub(super) fn surfaces(&self) -> &[Surface] {
        &self.surfaces
    }

    /// Which beam looks which way.
    #[allow(clippy::cast_possible_truncation)] // to single precision
    pub(super) fn bearings(&self) -> Bearings {
        let beams = self.scan.beams();
        let per_radian = beams.angle_increment().recip();
        Bearings {
            angle_min: beams.angle(0) as f32,
            per_radian: per_radian as f32,
            turn: (TAU * per_radian.abs()) as f32,
            beams: self.scan.len() as f32,
        }
    }
}

/// Turns bearings into indices of beams.
#[derive(Clone, Copy, Debug)]
pub(super) struct Bearings {
    angle_min: f32,
    per_radian: f32,
    turn: f32,
    beams: f32,
}

impl Bearings {
    /// The beams that look towards points, next to it at least; past the last one where none does.
    #[inline]
    #[allow(clippy::cast_sign_loss)] // clamped
    pub(super) fn beams(&self, x: f32x8, y: f32x8) -> [usize; 8] {
        let turn = f32x8::splat(self.turn);
        let offset = (y.atan2(x) - f32x8::splat(self.angle_min)) * f32x8::splat(self.per_radian) + f32x8::HALF;
        let offset = offset + (offset.simd_lt(f32x8::ZERO) & turn);
        let offset = offset - (offset.simd_ge(turn) & turn);
        let beams = offset.fast_max(f32x8::ZERO).fast_min(f32x8::splat(self.beams));
        beams.fast_trunc_int().to_array().map(|beam| beam as usize)
    }

    /// The beam that looks towards one point.
    #[allow(clippy::cast_possible_truncation)] // to single precision
    pub(super) fn beam(&self, point: &Point) -> usize {
        self.beams(f32x8::splat(point.x as f32), f32x8::splat(point.y as f32))[0]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::BeamGeometry;
    use crate::time::Stamp;

    #[test]
    fn every_beam_finds_itself_whichever_way_the_laser_sweeps() {
        let geometries =
            [(-2.3, 0.0044, 1080), (2.3, -0.0044, 1080), (0.0, TAU / 360.0, 360), (1.3, -TAU / 180.0, 180), (-1.57, 0.0175, 180)];
        for (angle_min, increment, count) in geometries {
            let beams = BeamGeometry::new(angle_min, increment, count);
            let scan = Scan::new(Stamp::default(), beams.into(), (0.0, 100.0), vec![2.0; count]).unwrap();
            let view = View::of(&scan, 0.01, &mut LineFitter::default());
            for (i, point) in view.points().enumerate() {
                assert_eq!(view.bearings().beam(&point), i, "{angle_min} {increment}");
            }
        }
    }

    #[test]
    fn out_of_sight_is_the_last_surface() {
        let beams = BeamGeometry::new(-1.0, 0.01, 201);
        let scan = Scan::new(Stamp::default(), beams.into(), (0.0, 100.0), vec![2.0; 201]).unwrap();
        let view = View::of(&scan, 0.01, &mut LineFitter::default());
        assert!(view.surfaces()[view.bearings().beam(&Point::new(-1.0, 0.1))].is_none());
    }
}
