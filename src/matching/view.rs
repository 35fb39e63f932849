//! A scan prepared as a reference for matching: the surface that each beam hit.

use std::f32::consts::{FRAC_PI_2, PI};
use std::f64::consts::TAU;
use std::sync::Arc;

use fearless_simd::{Simd, f32x8, i32x8, prelude::*, u32x8};

use super::surface::{LANES, Surface};
use crate::geometry::{Point, Pose2};
use crate::scan::Scan;

/// A surface has been seen through only if the beam in its direction and this many beams to either side all range beyond it.
const MARGIN_BEAMS: usize = 2;
/// Such beams must range beyond the surface by this fraction of its distance, plus [`MIN_CLEARANCE`].
const MIN_RELATIVE_CLEARANCE: f64 = 0.02;
/// Distance by which such beams must range beyond the surface, m, in addition to [`MIN_RELATIVE_CLEARANCE`].
const MIN_CLEARANCE: f64 = 0.2;

/// A scan with the surfaces that were fitted to it.
#[derive(Clone, Debug)]
pub struct View {
    scan: Scan,
    /// One surface per beam, and [`Surface::NONE`] at the end for everything outside the field of view; empty if no surfaces are
    /// needed.
    surfaces: Vec<Surface>,
    /// Ranges resampled to evenly spaced beams, m; empty if the beams of the scan are evenly spaced already.
    resampled_ranges: Vec<f64>,
}

impl View {
    /// A view without surfaces, for matching to nearest points.
    pub(super) fn bare(scan: Scan) -> Self {
        Self { scan, surfaces: Vec::new(), resampled_ranges: Vec::new() }
    }

    /// A view of a scan and the surface at each of its beams.
    pub(super) fn new(scan: Scan, mut surfaces: Vec<Surface>) -> Self {
        surfaces.push(Surface::NONE);
        let mut view = Self { scan, surfaces, resampled_ranges: Vec::new() };
        if !view.scan.beams().is_uniform() {
            view.resample_evenly();
        }
        view
    }

    /// Resamples surfaces and ranges to evenly spaced beams.
    fn resample_evenly(&mut self) {
        let bearings = self.bearings();
        let mut surfaces = vec![Surface::NONE; self.surfaces.len()];
        let mut ranges = vec![f64::NAN; self.scan.len()];
        for ((direction, surface), range) in self.scan.beams().directions().iter().zip(&self.surfaces).zip(self.scan.ranges()) {
            let beam = bearings.beam(direction);
            if beam < self.scan.len() {
                if surface.variance() < surfaces[beam].variance() {
                    surfaces[beam] = *surface;
                }
                ranges[beam] = range.min(ranges[beam]);
            }
        }
        fill_gaps(&mut surfaces, Surface::is_none);
        fill_gaps(&mut ranges, |range| range.is_nan());
        (self.surfaces, self.resampled_ranges) = (surfaces, ranges);
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

    /// Removes from each of two views the surfaces that the laser of the other view has seen through: these belong to objects
    /// that have moved. `a_from_b`: pose of the laser of `b` in the frame of the laser of `a`.
    pub fn remove_moved(a: &mut Arc<Self>, b: &mut Arc<Self>, a_from_b: &Pose2) {
        let of_a: Vec<usize> = a.seen_through(b, &a_from_b.inverse()).collect();
        let of_b: Vec<usize> = b.seen_through(a, a_from_b).collect();
        for (view, beams) in [(a, of_a), (b, of_b)] {
            if !beams.is_empty() {
                let surfaces = &mut Arc::make_mut(view).surfaces;
                for beam in beams {
                    surfaces[beam] = Surface::NONE;
                }
            }
        }
    }

    /// Beams of the surfaces that another laser has seen through: these belong to objects that have moved. `other_from_self`:
    /// pose of the laser of this view in the frame of the other.
    fn seen_through<'a>(&'a self, other: &'a Self, other_from_self: &Pose2) -> impl Iterator<Item = usize> + 'a {
        let (bearings, transform) = (other.bearings(), other_from_self.transform());
        let (own_ranges, ranges) = (self.even_ranges(), other.even_ranges());
        (0..self.scan.len()).filter_map(move |own_beam| {
            if self.surfaces.get(own_beam)?.is_none() {
                return None;
            }
            let (sin, cos) = self.scan.beams().angle(own_beam).sin_cos();
            let point = transform.apply(Point::new(cos, sin) * own_ranges[own_beam]);
            let beam = bearings.beam(&point);
            // Check the neighbouring beams, too: past an edge or along a wall, the next beam may range much farther.
            let neighbours = ranges.get(beam.checked_sub(MARGIN_BEAMS)?..=beam + MARGIN_BEAMS)?;
            let min_range = (1.0 + MIN_RELATIVE_CLEARANCE) * point.norm() + MIN_CLEARANCE;
            // A missing measurement is no evidence.
            neighbours.iter().all(|&range| range > min_range).then_some(own_beam)
        })
    }

    /// Ranges at evenly spaced beams, m; NaN without a measurement.
    fn even_ranges(&self) -> &[f64] {
        if self.scan.beams().is_uniform() { self.scan.ranges() } else { &self.resampled_ranges }
    }

    /// The mapping from bearings to beams.
    #[allow(clippy::cast_possible_truncation)] // conversion to single precision
    pub(super) fn bearings(&self) -> Bearings {
        let beams = self.scan.beams();
        let beams_per_radian = beams.angle_increment().recip();
        Bearings {
            angle_min: beams.angle(0) as f32,
            beams_per_radian: beams_per_radian as f32,
            beams_per_turn: (TAU * beams_per_radian.abs()) as f32,
            turns_per_beam: (TAU * beams_per_radian.abs()).recip() as f32,
            beams: self.scan.len() as f32,
        }
    }
}

/// Fills single gaps with the entry before them: if beams are locally farther apart than evenly spaced ones, some resampled
/// entries stay empty.
fn fill_gaps<T: Copy>(entries: &mut [T], is_none: impl Fn(&T) -> bool) {
    for i in 1..entries.len().saturating_sub(1) {
        if is_none(&entries[i]) && !is_none(&entries[i + 1]) {
            entries[i] = entries[i - 1];
        }
    }
}

/// Maps bearings to beam indices.
#[derive(Clone, Copy, Debug)]
pub(super) struct Bearings {
    angle_min: f32,
    beams_per_radian: f32,
    beams_per_turn: f32,
    turns_per_beam: f32,
    beams: f32,
}

impl Bearings {
    /// The beams that point towards the given points, accurate to one beam; the number of beams if a point is outside the field
    /// of view.
    #[inline(always)]
    pub(super) fn beams<S: Simd>(&self, x: f32x8<S>, y: f32x8<S>) -> [u32; LANES] {
        let offset = (angle(x, y) - self.angle_min) * self.beams_per_radian + 0.5;
        let offset = offset - (offset * self.turns_per_beam).floor() * self.beams_per_turn;
        offset.max(0.0).min(self.beams).to_int::<i32x8<S>>().bitcast::<u32x8<S>>().into()
    }

    /// The beam that points towards a point; the number of beams if it is outside the field of view.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // at most the number of beams
    pub(super) fn beam(&self, point: &Point) -> usize {
        let offset = (point.y.atan2(point.x) - f64::from(self.angle_min)) * f64::from(self.beams_per_radian) + 0.5;
        offset.rem_euclid(self.beams_per_turn.into()).min(self.beams.into()) as usize
    }
}

/// Angles of vectors, rad, by the polynomial 4.4.47 of Abramowitz and Stegun. The error is below 1e-5, a fiftieth of the angle
/// between 10 000 beams.
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
    fn every_beam_maps_to_itself_in_both_sweep_directions() {
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

    /// Scan of a wall 4 m ahead, with a person in front of it at 2 m from -0.1 to 0 rad if `is_someone_there`. The laser rotates
    /// by `rotation` during the sweep, and the scan is deskewed.
    fn wall(is_someone_there: bool, rotation: f64) -> View {
        let beams = BeamGeometry::new(-0.5, 0.01, 101);
        let range = |i: usize| {
            let angle = beams.angle(i) + rotation * i as f64 / 100.0;
            if is_someone_there && (-0.101..-0.009).contains(&angle) { 2.0 } else { 4.0 / angle.cos() }
        };
        let ranges: Vec<f64> = (0..beams.len()).map(range).collect();
        let scan = Scan::new(Stamp::default(), beams.into(), (0.0, 100.0), ranges).unwrap();
        let scan =
            if rotation == 0.0 { scan } else { scan.undistorted(&Twist2 { omega: rotation, ..Twist2::default() }, 0.0, 1.0) };
        with_surfaces(scan)
    }

    #[test]
    fn surfaces_of_a_person_who_has_left_are_removed() {
        for (rotation_before, rotation_after) in [(0.0, 0.0), (0.0, 0.2), (0.2, 0.0)] {
            let (before, after) = (wall(true, rotation_before), wall(false, rotation_after));
            let still = Pose2::IDENTITY;
            let gone: Vec<usize> = before.seen_through(&after, &still).collect();
            assert!(gone.len() >= 7 && gone.iter().all(|beam| (39..51).contains(beam)), "{gone:?}");
            let (mut cleaned, mut later) = (Arc::new(before), Arc::new(after.clone()));
            View::remove_moved(&mut cleaned, &mut later, &still);
            assert!(cleaned.surfaces()[45].is_none() && !cleaned.surfaces()[60].is_none());
            let kept = |view: &View| view.surfaces().iter().filter(|surface| !surface.is_none()).count();
            assert_eq!(kept(&later), kept(&after));
            assert_eq!(after.seen_through(&wall(true, rotation_before), &still).count(), 0, "a new person hides the wall");
            let moved = wall(false, 0.0);
            assert_eq!(after.seen_through(&moved, &Pose2::new(0.3, 0.2, 0.01)).count(), 0, "only the laser has moved");
        }
    }

    #[test]
    fn missing_measurements_do_not_see_through_surfaces() {
        let before = wall(true, 0.0);
        let mut ranges = wall(false, 0.0).scan().ranges().to_vec();
        ranges.iter_mut().step_by(4).for_each(|range| *range = f64::NAN);
        let scan = Scan::new(Stamp::default(), before.scan().beams().clone().into(), (0.0, 100.0), ranges).unwrap();
        assert_eq!(before.seen_through(&View::bare(scan), &Pose2::IDENTITY).count(), 0);
    }

    #[test]
    fn points_outside_the_field_of_view_have_no_surface() {
        let beams = BeamGeometry::new(-1.0, 0.01, 201);
        let scan = Scan::new(Stamp::default(), beams.into(), (0.0, 100.0), vec![2.0; 201]).unwrap();
        let view = with_surfaces(scan);
        let out_of_sight = Point::new(-1.0, 0.1);
        assert!(view.surfaces()[view.bearings().beam(&out_of_sight)].is_none());
        assert!(view.surfaces()[beams_at(&view, &out_of_sight)[0] as usize].is_none());
    }
}
