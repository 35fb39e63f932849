//! What a laser saw from one place, ready to be matched to: at every beam, the surface that it met.

use std::f64::consts::TAU;

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
        Self { scan: scan.clone(), surfaces }
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
    /// The beam that looks towards a point, next to it at least; past the last one when none does.
    #[inline]
    #[allow(clippy::cast_possible_truncation)] // clamped
    pub(super) fn beam(&self, x: f32, y: f32) -> i32 {
        let offset = (bearing(x, y) - self.angle_min) * self.per_radian + 0.5;
        let offset = if offset < 0.0 { offset + self.turn } else { offset };
        let offset = if offset >= self.turn { offset - self.turn } else { offset };
        offset.clamp(0.0, self.beams) as i32
    }
}

/// `atan2(y, x)` to 2e-5 rad, far less than the increment of any laser, without branches.
#[inline]
fn bearing(x: f32, y: f32) -> f32 {
    use std::f32::consts::{FRAC_PI_2, PI};
    let (ax, ay) = (x.abs(), y.abs());
    let (low, high) = (ax.min(ay), ax.max(ay).max(f32::MIN_POSITIVE));
    let t = low / high;
    let s = t * t;
    // The odd polynomial of degree 9 that is nearest to the arc tangent on 0 to 1.
    let angle = t * (0.999_866_3 + s * (-0.330_304_8 + s * (0.180_159_3 + s * (-0.085_156_35 + s * 0.020_845_11))));
    let angle = if ay > ax { FRAC_PI_2 - angle } else { angle };
    let angle = if x < 0.0 { PI - angle } else { angle };
    angle.copysign(y)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::BeamGeometry;
    use crate::time::Stamp;

    #[test]
    fn bearings_are_those_of_the_library() {
        for i in 0..10_000 {
            let angle = f64::from(i) * 1e-3 - 5.0;
            let (sin, cos) = angle.sin_cos();
            let range = 0.1 + f64::from(i % 37);
            let (x, y) = ((range * cos) as f32, (range * sin) as f32);
            assert!((bearing(x, y) - y.atan2(x)).abs() < 2e-5, "{x} {y}");
        }
    }

    #[test]
    fn every_beam_finds_itself_whichever_way_the_laser_sweeps() {
        let geometries =
            [(-2.3, 0.0044, 1080), (2.3, -0.0044, 1080), (0.0, TAU / 360.0, 360), (1.3, -TAU / 180.0, 180), (-1.57, 0.0175, 180)];
        for (angle_min, increment, count) in geometries {
            let beams = BeamGeometry::new(angle_min, increment, count);
            let scan = Scan::new(Stamp::default(), beams.into(), (0.0, 100.0), vec![2.0; count]).unwrap();
            let view = View::of(&scan, 0.01, &mut LineFitter::default());
            for (i, point) in view.points().enumerate() {
                assert_eq!(view.bearings().beam(point.x as f32, point.y as f32), i as i32, "{angle_min} {increment}");
            }
        }
    }

    #[test]
    fn out_of_sight_is_the_last_surface() {
        let beams = BeamGeometry::new(-1.0, 0.01, 201);
        let scan = Scan::new(Stamp::default(), beams.into(), (0.0, 100.0), vec![2.0; 201]).unwrap();
        let view = View::of(&scan, 0.01, &mut LineFitter::default());
        assert!(view.surfaces()[view.bearings().beam(-1.0, 0.1) as usize].is_none());
    }
}
