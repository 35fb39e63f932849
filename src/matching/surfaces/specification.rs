//! Reference implementation of [`Projective::find_correspondences`] for tests: one ray at a time, in double precision, without
//! SIMD.

use nalgebra::Matrix2;
use proptest::prelude::*;

use super::rays::Block;
use super::*;
use crate::matching::surface::DIRECTION_SHIFT;
use crate::matching::surfaces::view_consistency::MIN_CONFIRMED;
use crate::matching::view::Bearings;
use crate::scan::BeamGeometry;
use crate::time::Stamp;

/// Maximum relative difference between sums in single and in double precision.
const PRECISION: f64 = 1e-3;
/// Number of beams of a view, and the angle between them, rad.
const BEAMS: (usize, f64) = (181, 0.03);

/// The correspondences at one pose, and the state for the next iteration.
#[derive(Default)]
struct ReferenceResult {
    form: QuadraticForm,
    totals: Sums,
    /// Distance of each ray from its nearest surface, m.
    distances: Vec<f64>,
    /// Consistency weight of each ray in the next iteration.
    weights: Vec<f64>,
    kernel_variance: f64,
    /// Whether some ray is so near the inlier limit that rounding decides.
    is_ambiguous: bool,
}

/// Finds the correspondences of points (each with its chord) with the views at a pose. `noise`: standard deviation of a range, m.
fn reference_correspondences(
    views: &[PlacedView],
    sensed: &[(Point, Point)],
    pose: &Pose2,
    noise: f64,
    kernel_variance: f64,
    weights: &[f64],
) -> ReferenceResult {
    let mut all = ReferenceResult { distances: vec![f64::INFINITY; sensed.len()], ..ReferenceResult::default() };
    for (i, &(point, chord)) in sensed.iter().enumerate() {
        let (mut pairs, mut inliers) = (0.0, 0.0);
        for PlacedView { reference_from_view, view } in views {
            let view_from_sensed = reference_from_view.between(pose);
            let moved = view_from_sensed.transform().apply(point);
            let surface = view.surfaces()[view.bearings().beam(&moved)];
            if surface.is_none() {
                continue;
            }
            let normal = Point::from(surface.normal().map(f64::from));
            let error = normal.dot(&moved) - f64::from(surface.offset());
            let incidence = normal.dot(&(rotation(&view_from_sensed) * point)) / point.norm();
            let variance = incidence.powi(2) + kernel_variance + f64::from(surface.variance());
            // Kernel of Geman and McClure.
            let limit = variance * (KERNEL_SIGMAS * noise).powi(2);
            let across = normal.dot(&(rotation(&view_from_sensed) * chord));
            let weight = (limit / (limit + error.powi(2) + across.powi(2))).powi(2) / variance * weights[i];
            let is_inlier = f64::from(u8::from(error.powi(2) < limit));
            all.is_ambiguous |= (error.powi(2) / limit - 1.0).abs() < PRECISION;
            all.distances[i] = all.distances[i].min(error.abs());
            (pairs, inliers) = (pairs + 1.0, inliers + is_inlier);
            // The line in the reference frame.
            let line = rotation(reference_from_view) * normal;
            all.form.add_line(point, line, f64::from(surface.offset()) + line.dot(&reference_from_view.translation()), weight);
            let direction_variance = f32::from_bits(surface.variance().to_bits() << DIRECTION_SHIFT);
            let mut add = |sum: Sum, term: f64| all.totals.0[sum as usize] += term;
            add(Sum::Squares, weight * error.powi(2));
            add(Sum::Expected, weight * variance);
            add(Sum::Weights, weight);
            add(Sum::SpuriousInformation, weight * f64::from(direction_variance));
            add(Sum::Excess, weight / variance * ((error / noise).powi(2) - variance));
            add(Sum::ExcessWeights, weight / variance);
            add(Sum::Residuals, is_inlier * error.abs());
            add(Sum::Correspondences, 1.0);
            add(Sum::Inliers, is_inlier);
        }
        let confirmed: f64 = if pairs > 0.0 { inliers / pairs } else { 1.0 };
        all.weights.push(if views.len() > 1 { confirmed.max(f64::from(MIN_CONFIRMED)).sqrt() } else { 1.0 });
    }
    let views_per_ray = (all.totals.of(Sum::Correspondences) / sensed.len() as f64).max(1.0);
    all.form = all.form.scaled(1.0 / views_per_ray);
    let upper = if kernel_variance > MAX_SURFACE_VARIANCE {
        (MAX_SHRINK * kernel_variance).max(MAX_SURFACE_VARIANCE)
    } else {
        kernel_variance
    };
    let observed = kernel_variance + all.totals.of(Sum::Excess) / all.totals.of(Sum::ExcessWeights).max(f64::MIN_POSITIVE);
    all.kernel_variance = observed.max(MIN_SHRINK * kernel_variance).max(MIN_KERNEL_VARIANCE).min(upper);
    all
}

fn rotation(pose: &Pose2) -> Matrix2<f64> {
    let (sin, cos) = pose.theta.sin_cos();
    Matrix2::new(cos, -sin, sin, cos)
}

/// A rectangular room with corners at `(left, back)` and `(right, front)`, m.
#[derive(Clone, Debug)]
struct Room {
    walls: [f64; 4],
}

impl Room {
    /// Scan from a pose. `off`: error of each range, m.
    fn scan(&self, pose: &Pose2, off: &[f64]) -> Scan {
        let [left, right, back, front] = self.walls;
        let beams = BeamGeometry::new(-0.5 * BEAMS.1 * (BEAMS.0 - 1) as f64, BEAMS.1, BEAMS.0);
        let range = |(i, off): (usize, &f64)| {
            let (sin, cos) = (pose.theta + beams.angle(i)).sin_cos();
            let along_x = (if cos > 0.0 { right } else { left } - pose.x) / cos;
            let along_y = (if sin > 0.0 { front } else { back } - pose.y) / sin;
            along_x.min(along_y) + off
        };
        let ranges: Vec<f64> = off.iter().enumerate().map(range).collect();
        Scan::new(Stamp::default(), beams.into(), (0.1, 30.0), ranges).unwrap()
    }
}

/// The scan without the rays that end midway between two beams of a view: there, rounding decides which beam they are paired
/// with.
fn unambiguous(scan: &Scan, views: &[PlacedView], poses: &[Pose2]) -> Scan {
    let is_unambiguous = |bearings: &Bearings, point: &Point| {
        let beam = |by: f64| bearings.beam(&Pose2::new(0.0, 0.0, by).transform().apply(*point));
        beam(0.02 * BEAMS.1) == beam(-0.02 * BEAMS.1)
    };
    let is_unambiguous_in_all = |point: &Point| {
        views.iter().all(|placed| {
            let bearings = placed.view.bearings();
            poses
                .iter()
                .all(|pose| is_unambiguous(&bearings, &placed.reference_from_view.between(pose).transform().apply(*point)))
        })
    };
    let mut ranges = vec![f64::NAN; scan.len()];
    for (ray, direction, range) in scan.rays() {
        if is_unambiguous_in_all(&(direction * range)) {
            ranges[ray] = range;
        }
    }
    Scan::new(Stamp::default(), scan.beams().clone().into(), (0.1, 30.0), ranges).unwrap()
}

fn pose(distance: f64, angle: f64) -> impl Strategy<Value = Pose2> {
    (-distance..distance, -distance..distance, -angle..angle).prop_map(|(x, y, theta)| Pose2::new(x, y, theta))
}

/// Range errors, m: mostly small ones, some large ones as from objects that have moved, and missing measurements.
fn errors() -> impl Strategy<Value = Vec<f64>> {
    proptest::collection::vec(prop_oneof![8 => -0.02..0.02, 1 => -1.0..1.0, 1 => Just(f64::NAN)], BEAMS.0)
}

fn assert_near(name: &str, fast: f64, plain: f64, scale: f64) -> Result<(), TestCaseError> {
    prop_assert!((fast - plain).abs() <= PRECISION * (plain.abs() + scale), "{name}: {fast}, reference {plain}");
    Ok(())
}

fn assert_same_results(fast: &Projective, plain: &ReferenceResult, pose: &Pose2) -> Result<(), TestCaseError> {
    let (a, b) = (&fast.totals, &plain.totals);
    let expected = b.of(Sum::Expected);
    for (sum, scale) in [
        (Sum::Correspondences, 0.0),
        (Sum::Inliers, 0.0),
        (Sum::Squares, 1e-6 * expected),
        (Sum::Expected, 0.0),
        (Sum::SpuriousInformation, 0.0),
        (Sum::Weights, 0.0),
        (Sum::Excess, b.of(Sum::ExcessWeights)),
        (Sum::ExcessWeights, 0.0),
        (Sum::Residuals, 1e-3),
    ] {
        assert_near(&format!("{sum:?}"), a.of(sum), b.of(sum), scale)?;
    }
    assert_near("kernel variance", fast.kernel_variance, plain.kernel_variance, 1.0)?;
    let ((gradient, information), (gradient_b, information_b)) = (fast.form.linearize(pose), plain.form.linearize(pose));
    prop_assert!((information - information_b).norm() <= PRECISION * information_b.norm(), "{information}{information_b}");
    let scale = gradient_b.norm() + 1e-3 * information_b.norm();
    prop_assert!((gradient - gradient_b).norm() <= PRECISION * scale, "{gradient}{gradient_b}");
    assert_near("value", fast.form.value(pose), plain.form.value(pose), 1e-6 * expected)?;
    let distances = fast.consistency.iter().flat_map(|consistency| consistency.nearest).map(f64::from);
    for (fast, &plain) in distances.zip(&plain.distances) {
        prop_assert!(fast.to_bits() == plain.to_bits() || (fast - plain).abs() < 1e-5, "{fast}, reference {plain}");
    }
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, ..ProptestConfig::default() })]

    #[test]
    fn the_simd_kernel_agrees_with_the_reference_implementation(
        walls in [-6.0..-1.5, 1.5..6.0, -6.0..-1.5, 1.5..6.0],
        second in pose(0.8, 0.5),
        (views, rays) in (1..3_usize, prop_oneof![Just(BEAMS.0), 5..BEAMS.0]),
        sensed in pose(0.8, 0.5),
        (first_off, second_off, sensed_off) in (errors(), errors(), errors()),
        guesses in [pose(0.15, 0.1), pose(0.03, 0.02)],
    ) {
        let (room, noise) = (Room { walls }, 0.01);
        let mut fast = Projective::new(noise);
        let placed = [(Pose2::IDENTITY, first_off), (second, second_off)];
        let views: Vec<PlacedView> = placed.iter().take(views).map(|(reference_from_view, off)| {
            PlacedView { reference_from_view: *reference_from_view, view: fast.view(room.scan(reference_from_view, off)).into() }
        }).collect();
        let poses = guesses.map(|off| sensed * off);
        let scan = unambiguous(&room.scan(&sensed, &sensed_off), &views, &poses);
        prop_assume!(scan.valid_len() > 0);
        fast.set_views(&views);
        fast.begin(&poses[0].into());
        fast.set_sensed(&scan);
        fast.select_rays(RayOrder::first(rays, scan.valid_len()), usize::MAX);
        let in_double = |of: [f32; 2]| Point::from(of.map(f64::from));
        let lanes = |of: &[[f32; LANES]; 2]| -> [Point; LANES] { std::array::from_fn(|lane| in_double(of.map(|axis| axis[lane]))) };
        let of_block = |block: &Block| lanes(&block.point).into_iter().zip(lanes(&block.chord));
        let rays: Vec<(Point, Point)> = fast.selected.blocks.iter().flat_map(of_block).take(fast.selected.len).collect();
        let mut weights = vec![1.0; rays.len()];
        for pose in &poses {
            let plain = reference_correspondences(&views, &rays, pose, noise, fast.kernel_variance, &weights);
            prop_assume!(!plain.is_ambiguous);
            prop_assert!(fast.find_correspondences(pose).is_some());
            assert_same_results(&fast, &plain, pose)?;
            weights = plain.weights;
        }
    }
}
