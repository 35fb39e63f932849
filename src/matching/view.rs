//! What a laser saw from one place, ready to be matched to: at every beam, the surface that it met.

use std::f32::consts::{FRAC_PI_2, PI};
use std::f64::consts::TAU;
use std::sync::Arc;

use fearless_simd::{Simd, f32x8, i32x8, prelude::*, u32x8};

use super::surface::{LANES, Surface};
use crate::geometry::{Point, Pose2};
use crate::scan::Scan;

/// A beam that has looked through something, and so many to either side, went so much farther, ...
const BESIDE: usize = 2;
/// ... as a part of the way there ...
const BEYOND: f64 = 0.02;
/// ... and m.
const BEYOND_METRES: f64 = 0.2;

/// A scan with the surfaces that were fitted to it.
#[derive(Clone, Debug)]
pub struct View {
    scan: Scan,
    /// By beam, and one more at the end for all that is out of sight; empty where none were asked for.
    surfaces: Vec<Surface>,
    /// Ranges where the beams of even spacing would be, m; empty where the scan's own are there.
    sorted_ranges: Vec<f64>,
}

impl View {
    /// A scan that no surfaces are needed of.
    pub(super) fn bare(scan: Scan) -> Self {
        Self { scan, surfaces: Vec::new(), sorted_ranges: Vec::new() }
    }

    /// A scan and the surface at each of its beams.
    pub(super) fn new(scan: Scan, mut surfaces: Vec<Surface>) -> Self {
        surfaces.push(Surface::NONE);
        let mut view = Self { scan, surfaces, sorted_ranges: Vec::new() };
        if !view.scan.beams().is_even() {
            view.sort_by_bearing();
        }
        view
    }

    /// Puts surfaces and ranges where the beams of even spacing would be.
    fn sort_by_bearing(&mut self) {
        let bearings = self.bearings();
        let mut surfaces = vec![Surface::NONE; self.surfaces.len()];
        let mut ranges = vec![f64::NAN; self.scan.len()];
        for ((direction, surface), range) in self.scan.beams().directions().iter().zip(&self.surfaces).zip(self.scan.ranges()) {
            let place = bearings.beam(direction);
            if place < self.scan.len() {
                if surface.variance() < surfaces[place].variance() {
                    surfaces[place] = *surface;
                }
                ranges[place] = range.min(ranges[place]);
            }
        }
        fill_gaps(&mut surfaces, Surface::is_none);
        fill_gaps(&mut ranges, |range| range.is_nan());
        (self.surfaces, self.sorted_ranges) = (surfaces, ranges);
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

    /// Two views forget the surfaces that the other's laser has looked through: what stood there has moved. `a_from_b`: pose of the laser of
    /// `b` in the frame of the laser of `a`.
    pub fn forget_moved(a: &mut Arc<Self>, b: &mut Arc<Self>, a_from_b: &Pose2) {
        let of_a: Vec<usize> = a.seen_through(b, &a_from_b.inverse()).collect();
        let of_b: Vec<usize> = b.seen_through(a, a_from_b).collect();
        for (view, places) in [(a, of_a), (b, of_b)] {
            if !places.is_empty() {
                let surfaces = &mut Arc::make_mut(view).surfaces;
                for place in places {
                    surfaces[place] = Surface::NONE;
                }
            }
        }
    }

    /// The places of surfaces that another laser has looked through: what stood there has moved. `other_from_self`: pose of this view's
    /// laser in the other's frame.
    fn seen_through<'a>(&'a self, other: &'a Self, other_from_self: &Pose2) -> impl Iterator<Item = usize> + 'a {
        let (bearings, transform) = (other.bearings(), other_from_self.transform());
        let (own_ranges, ranges) = (self.ranges_by_bearing(), other.ranges_by_bearing());
        (0..self.scan.len()).filter_map(move |place| {
            if self.surfaces.get(place)?.is_none() {
                return None;
            }
            let (sin, cos) = self.scan.beams().angle(place).sin_cos();
            let point = transform.apply(Point::new(cos, sin) * own_ranges[place]);
            let beam = bearings.beam(&point);
            // Beams to either side too: past an edge, and along a wall, the next one goes much farther.
            let around = ranges.get(beam.checked_sub(BESIDE)?..=beam + BESIDE)?;
            let beyond = (1.0 + BEYOND) * point.norm() + BEYOND_METRES;
            // No measurement says nothing.
            around.iter().all(|&range| range > beyond).then_some(place)
        })
    }

    /// Ranges where the beams of even spacing would be, m; NaN where there is no measurement.
    fn ranges_by_bearing(&self) -> &[f64] {
        if self.scan.beams().is_even() { self.scan.ranges() } else { &self.sorted_ranges }
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
            per_turn: (TAU * per_radian.abs()).recip() as f32,
            beams: self.scan.len() as f32,
        }
    }
}

/// Where beams are farther apart than even ones, one place now and then has none: it takes after the one before.
fn fill_gaps<T: Copy>(places: &mut [T], is_none: impl Fn(&T) -> bool) {
    for i in 1..places.len().saturating_sub(1) {
        if is_none(&places[i]) && !is_none(&places[i + 1]) {
            places[i] = places[i - 1];
        }
    }
}

/// Turns bearings into indices of beams.
#[derive(Clone, Copy, Debug)]
pub(super) struct Bearings {
    angle_min: f32,
    per_radian: f32,
    turn: f32,
    per_turn: f32,
    beams: f32,
}

impl Bearings {
    /// The beams that look towards points, next to it at least; past the last one where none does.
    #[inline(always)]
    pub(super) fn beams<S: Simd>(&self, x: f32x8<S>, y: f32x8<S>) -> [u32; LANES] {
        let offset = (angle(x, y) - self.angle_min) * self.per_radian + 0.5;
        let offset = offset - (offset * self.per_turn).floor() * self.turn;
        offset.max(0.0).min(self.beams).to_int::<i32x8<S>>().bitcast::<u32x8<S>>().into()
    }

    /// The beam that looks towards one point.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // at most the number of beams
    pub(super) fn beam(&self, point: &Point) -> usize {
        let offset = (point.y.atan2(point.x) - f64::from(self.angle_min)) * f64::from(self.per_radian) + 0.5;
        offset.rem_euclid(self.turn.into()).min(self.beams.into()) as usize
    }
}

/// Angles of vectors, rad: Abramowitz and Stegun 4.4.47, to 1e-5, a fiftieth of what lies between 10 000 beams.
#[inline(always)]
fn angle<S: Simd>(x: f32x8<S>, y: f32x8<S>) -> f32x8<S> {
    const COEFFICIENTS: [f32; 5] = [0.020_835_1, -0.085_133, 0.180_141, -0.330_299_5, 0.999_866];
    let (width, height) = (x.abs(), y.abs());
    let is_steep = height.simd_gt(width);
    let slope = width.min(height) / width.max(height).max(f32::MIN_POSITIVE);
    let square = slope * slope;
    let mut angle = f32x8::splat(x.token(), 0.0);
    for coefficient in COEFFICIENTS {
        angle = angle.mul_add(square, coefficient);
    }
    let angle = slope * angle;
    let angle = is_steep.select(-angle + FRAC_PI_2, angle);
    let angle = x.simd_lt(0.0).select(-angle + PI, angle);
    angle.copysign(y)
}

#[cfg(test)]
mod tests {
    use fearless_simd::{Level, dispatch};

    use super::*;
    use crate::geometry::Twist2;
    use crate::matching::classic::rejection::RejectionKnobs;
    use crate::matching::{Matcher, MatchingKnobs};
    use crate::scan::BeamGeometry;
    use crate::time::Stamp;

    fn beams_at(view: &View, point: &Point) -> [u32; LANES] {
        let bearings = view.bearings();
        let (x, y) = (point.x as f32, point.y as f32);
        dispatch!(Level::new(), simd => bearings.beams(f32x8::splat(simd, x), f32x8::splat(simd, y)))
    }

    #[test]
    fn every_beam_finds_itself_whichever_way_the_laser_sweeps() {
        let geometries =
            [(-2.3, 0.0044, 1080), (2.3, -0.0044, 1080), (0.0, TAU / 360.0, 360), (1.3, -TAU / 180.0, 180), (-1.57, 0.0175, 180)];
        for (angle_min, increment, count) in geometries {
            let beams = BeamGeometry::new(angle_min, increment, count);
            let scan = Scan::new(Stamp::default(), beams.into(), (0.0, 100.0), vec![2.0; count]).unwrap();
            let view = View::bare(scan);
            for (i, point) in view.points().enumerate() {
                assert_eq!(view.bearings().beam(&point), i, "{angle_min} {increment}");
                assert_eq!(beams_at(&view, &point), [u32::try_from(i).unwrap(); LANES], "{angle_min} {increment}");
            }
        }
    }

    fn with_surfaces(scan: Scan) -> View {
        View::clone(&Matcher::new(&MatchingKnobs::default(), &RejectionKnobs::default()).view(scan))
    }

    /// A wall 4 m ahead, and someone before it at 2 m from -0.1 to 0 rad, if so; taken while the laser turned by `turn`, which has been
    /// undone.
    fn wall(is_someone_there: bool, turn: f64) -> View {
        let beams = BeamGeometry::new(-0.5, 0.01, 101);
        let range = |i: usize| {
            let angle = beams.angle(i) + turn * i as f64 / 100.0;
            if is_someone_there && (-0.101..-0.009).contains(&angle) { 2.0 } else { 4.0 / angle.cos() }
        };
        let ranges: Vec<f64> = (0..beams.len()).map(range).collect();
        let scan = Scan::new(Stamp::default(), beams.into(), (0.0, 100.0), ranges).unwrap();
        let scan = if turn == 0.0 { scan } else { scan.undistorted(&Twist2 { omega: turn, ..Twist2::default() }, 0.0, 1.0) };
        with_surfaces(scan)
    }

    #[test]
    fn who_has_gone_is_forgotten() {
        for (turn_before, turn_after) in [(0.0, 0.0), (0.0, 0.2), (0.2, 0.0)] {
            let (before, after) = (wall(true, turn_before), wall(false, turn_after));
            let still = Pose2::IDENTITY;
            let gone: Vec<usize> = before.seen_through(&after, &still).collect();
            assert!(gone.len() >= 7 && gone.iter().all(|place| (39..51).contains(place)), "{gone:?}");
            let (mut forgetful, mut later) = (Arc::new(before), Arc::new(after.clone()));
            View::forget_moved(&mut forgetful, &mut later, &still);
            assert!(forgetful.surfaces()[45].is_none() && !forgetful.surfaces()[60].is_none());
            let kept = |view: &View| view.surfaces().iter().filter(|surface| !surface.is_none()).count();
            assert_eq!(kept(&later), kept(&after));
            assert_eq!(after.seen_through(&wall(true, turn_before), &still).count(), 0, "who has come hides the wall");
            let moved = wall(false, 0.0);
            assert_eq!(after.seen_through(&moved, &Pose2::new(0.3, 0.2, 0.01)).count(), 0, "nothing has moved but the laser");
        }
    }

    #[test]
    fn beams_without_a_measurement_look_through_nothing() {
        let before = wall(true, 0.0);
        let mut ranges = wall(false, 0.0).scan().ranges().to_vec();
        ranges.iter_mut().step_by(4).for_each(|range| *range = f64::NAN);
        let scan = Scan::new(Stamp::default(), before.scan().beams().clone().into(), (0.0, 100.0), ranges).unwrap();
        assert_eq!(before.seen_through(&View::bare(scan), &Pose2::IDENTITY).count(), 0);
    }

    #[test]
    fn out_of_sight_is_the_last_surface() {
        let beams = BeamGeometry::new(-1.0, 0.01, 201);
        let scan = Scan::new(Stamp::default(), beams.into(), (0.0, 100.0), vec![2.0; 201]).unwrap();
        let view = with_surfaces(scan);
        let out_of_sight = Point::new(-1.0, 0.1);
        assert!(view.surfaces()[view.bearings().beam(&out_of_sight)].is_none());
        assert!(view.surfaces()[beams_at(&view, &out_of_sight)[0] as usize].is_none());
    }
}
