//! Classic PL-ICP (Censi 2008): pairs each point with the segment at its nearest reference point, and rejects the worst
//! correspondences. Only the first view of the reference is used.

pub mod correspondence;
mod covariance;
pub mod reference;
pub mod rejection;

use std::sync::Arc;

use nalgebra::{Matrix2, Vector3};

use super::MatchingKnobs;
use super::data_association::{Correspondences, DataAssociation, PlacedView};
use super::first_guess::FirstGuess;
use super::ray_order::RayOrder;
use super::solver::{Metric, QuadraticForm};
use super::uncertainty::Uncertainty;
use super::view::View;
use crate::geometry::{Point, Pose2};
use crate::scan::Scan;
use correspondence::{CorrespondenceSearch, Nearest};
use reference::Reference;
use rejection::{Correspondence, Rejection, RejectionKnobs};

/// Nearest-point data association.
pub(super) struct ClosestPoint {
    max_distance: f64,
    range_noise: f64,
    metric: Metric,
    search: Box<dyn CorrespondenceSearch>,
    rejection: Rejection,
    /// The view that the reference was made of.
    view: Option<Arc<View>>,
    reference: Reference,
    /// All points of the sensed scan, in its own frame.
    points: Vec<Point>,
    /// The selected ones, in the frame of the sensed scan.
    sensed: Vec<Point>,
    moved: Vec<Point>,
    nearest: Vec<Nearest>,
    pairs: Vec<Correspondence>,
    /// Derivatives of half the gradient by the ranges of the reference rays: a buffer for the covariance.
    by_reference_range: Vec<Vector3<f64>>,
}

impl ClosestPoint {
    pub(super) fn new(
        search: Box<dyn CorrespondenceSearch>,
        rejection: &RejectionKnobs,
        knobs: &MatchingKnobs,
        metric: Metric,
    ) -> Self {
        Self {
            max_distance: knobs.max_correspondence_distance,
            range_noise: knobs.range_noise,
            metric,
            search,
            rejection: Rejection::new(rejection.clone()),
            view: None,
            reference: Reference::default(),
            points: Vec::new(),
            sensed: Vec::new(),
            moved: Vec::new(),
            nearest: Vec::new(),
            pairs: Vec::new(),
            by_reference_range: Vec::new(),
        }
    }

    fn mean_residual(&self) -> f64 {
        let sum: f64 = self.pairs.iter().map(|pair| pair.squared_error.sqrt()).sum();
        sum / self.pairs.len() as f64
    }

    fn quadratic_form(&self) -> QuadraticForm {
        let mut form = QuadraticForm::default();
        for pair in &self.pairs {
            let p = self.sensed[pair.sensed as usize];
            match self.metric {
                Metric::PointToLine => {
                    let segment = self.reference.segment(pair.segment as usize);
                    form.add_line(p, segment.normal, segment.offset, 1.0);
                }
                Metric::PointToPoint => {
                    form.add(p, self.reference.points()[pair.ray as usize], &Matrix2::identity());
                }
            }
        }
        form
    }
}

#[allow(clippy::cast_possible_truncation)] // a scan has at most 10 000 rays
impl DataAssociation for ClosestPoint {
    fn view(&mut self, scan: Scan) -> View {
        View::bare(scan)
    }

    fn set_views(&mut self, views: &[PlacedView]) {
        let first = views.first().map(|placed| &placed.view);
        if let Some(view) = first.filter(|view| self.view.as_ref().is_none_or(|known| !Arc::ptr_eq(known, view))) {
            self.reference.set(view.scan());
            self.search.prepare(&self.reference);
            self.view = Some(Arc::clone(view));
        }
    }

    fn begin(&mut self, _guess: &FirstGuess) {
        self.pairs.clear();
    }

    fn set_sensed(&mut self, scan: &Scan) {
        self.points.clear();
        self.points.extend(scan.rays().map(|(_, direction, range)| direction * range));
    }

    fn select_rays(&mut self, order: RayOrder, _max_views: usize) {
        self.sensed.clear();
        self.sensed.extend(order.rays().map(|ray| self.points[ray]));
        self.nearest.clear();
        self.nearest.resize(self.sensed.len(), Nearest::NONE);
    }

    fn ray_count(&self) -> usize {
        self.sensed.len()
    }

    fn find_correspondences(&mut self, pose: &Pose2) -> Option<Correspondences> {
        if self.reference.is_empty() {
            return None;
        }
        let transform = pose.transform();
        self.moved.clear();
        self.moved.extend(self.sensed.iter().map(|&p| transform.apply(p)));
        self.search.find(&self.reference, &self.moved, self.max_distance, &mut self.nearest);
        pair_up(&self.reference, &self.moved, &self.nearest, self.metric, &mut self.pairs);
        let count = self.pairs.len() as u32;
        self.rejection.apply(&mut self.pairs, &self.nearest, self.reference.len());
        Some(Correspondences {
            form: self.quadratic_form(),
            count,
            inliers: self.pairs.len() as u32,
            mean_residual: self.mean_residual(),
            fingerprint: Some(fingerprint(&self.pairs)),
            is_kernel_settled: true,
        })
    }

    fn uncertainty(&mut self, pose: &Pose2) -> Uncertainty {
        // The residuals contain the noise of both scans, and the mean of |e| is sqrt(2/pi) times the standard deviation of a
        // normally distributed e.
        let observed_noise = self.mean_residual() * (std::f64::consts::PI / 4.0).sqrt();
        self.uncertainty_of(pose, observed_noise.max(self.range_noise))
    }

    fn matched_points(&self, pose: &Pose2, points: &mut Vec<(Point, Point)>) {
        let transform = pose.transform();
        let of = |pair: &Correspondence| {
            (transform.apply(self.sensed[pair.sensed as usize]), self.reference.points()[pair.ray as usize])
        };
        points.extend(self.pairs.iter().map(of));
    }
}

/// Pairs each sensed point that has a nearest ray with the segment at that ray.
#[allow(clippy::cast_possible_truncation)] // a scan has at most 10 000 rays
fn pair_up(reference: &Reference, moved: &[Point], nearest: &[Nearest], metric: Metric, pairs: &mut Vec<Correspondence>) {
    pairs.clear();
    for (i, (&point, found)) in moved.iter().zip(nearest).enumerate() {
        if !found.is_match() {
            continue;
        }
        let Some(segment) = reference.segment_at(found.ray as usize, point) else { continue };
        let squared_error = match metric {
            Metric::PointToLine => {
                let line = reference.segment(segment);
                (line.normal.dot(&point) - line.offset).powi(2)
            }
            Metric::PointToPoint => found.squared_distance,
        };
        pairs.push(Correspondence { sensed: i as u32, ray: found.ray, segment: segment as u32, squared_error });
    }
}

/// Hash of the set of correspondences (FNV-1a, by words).
fn fingerprint(pairs: &[Correspondence]) -> u64 {
    pairs.iter().fold(0xcbf2_9ce4_8422_2325, |hash, pair| {
        let word = u64::from(pair.sensed) << 32 | u64::from(pair.ray) << 1 | u64::from(pair.segment == pair.ray);
        (hash ^ word).wrapping_mul(0x0000_0100_0000_01b3)
    })
}
