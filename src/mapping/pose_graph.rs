//! Pose graph: poses in the plane, motion constraints between them, and the robust least-squares solution.
//!
//! An edge from pose `a` to pose `b` constrains the motion `m`, the pose of `b` in the frame of `a`, with covariance `C` along the axes
//! of `a`. Its error is `e = (R_a' (t_b - t_a) - t_m, theta_b - theta_a - theta_m)`, and its Jacobians are
//!
//! ```text
//! de/d(t_a, theta_a) = [ -R_a'  J' R_a' (t_b - t_a) ]      de/d(t_b, theta_b) = [ R_a'  0 ]
//!                      [   0            -1          ]                           [  0    1 ]
//! ```
//!
//! where `J` rotates by 90 degrees. The sum of `rho(e' C^-1 e)` over the edges is minimised by iteratively reweighted least squares:
//! Gauss-Newton steps, solved by sparse Cholesky decomposition ([`super::sparse`]). The kernel `rho` is robust, so a wrong edge does
//! not distort the map. Huber's kernel comes first, because it converges from far away; then that of Geman and `McClure` (1987), which
//! gives outlier edges almost no weight.

use std::ops::Range;

use nalgebra::{Matrix3, Vector3};

use super::sparse::Pattern;
use crate::geometry::{Pose2, PoseCovariance};
use crate::odometry::uncertainty::rotation;

/// Kernel width, standard deviations: a larger error is more likely an outlier than noise.
const KERNEL_SIGMAS: f64 = 3.0;
/// Maximum number of Gauss-Newton steps with one kernel.
const MAX_STEPS: usize = 15;
/// Maximum number of times that a step is halved if it increases the cost.
const MAX_HALVINGS: usize = 6;

/// Source of an edge.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EdgeKind {
    /// The odometry's motion from one keyframe to the next.
    Odometry,
    /// A match of consecutive keyframes; if they do not match, the motion by odometry with its full information.
    Sequence,
    /// A loop closure: a match of keyframes of two visits.
    Loop,
}

/// A constraint on the motion between two poses.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Edge {
    /// Index of the first pose.
    pub from: usize,
    /// Index of the second pose.
    pub to: usize,
    /// Measured motion: the second pose in the frame of the first.
    pub motion: Pose2,
    /// Covariance of the motion, along the axes of the first pose.
    pub covariance: PoseCovariance,
    /// Source of the edge.
    pub kind: EdgeKind,
}

/// Robust kernel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kernel {
    Huber,
    GemanMcClure,
}

impl Kernel {
    /// Robust cost of a squared error; both in units of the variance.
    fn cost(self, square: f64) -> f64 {
        let delta = KERNEL_SIGMAS;
        match self {
            Self::Huber if square <= delta * delta => square,
            Self::Huber => 2.0 * delta * square.sqrt() - delta * delta,
            Self::GemanMcClure => square * delta * delta / (delta * delta + square),
        }
    }

    /// Robust weight: the derivative of the cost.
    fn weight(self, square: f64) -> f64 {
        let delta = KERNEL_SIGMAS;
        match self {
            Self::Huber if square <= delta * delta => 1.0,
            Self::Huber => delta / square.sqrt(),
            Self::GemanMcClure => (delta * delta / (delta * delta + square)).powi(2),
        }
    }
}

/// Poses, and the edges between them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PoseGraph {
    poses: Vec<Pose2>,
    edges: Vec<Edge>,
    /// Information matrix of each edge: the inverse of its covariance.
    information: Vec<Matrix3<f64>>,
}

impl PoseGraph {
    /// Adds a pose; returns its index.
    pub fn add_pose(&mut self, pose: Pose2) -> usize {
        self.poses.push(pose);
        self.poses.len() - 1
    }

    /// Adds an edge between existing poses. Invalid edges are ignored: equal or missing poses, not finite, or a covariance that is not
    /// positive definite.
    pub fn add_edge(&mut self, edge: Edge) {
        let is_valid = edge.from != edge.to && edge.from.max(edge.to) < self.poses.len() && edge.motion.is_finite();
        if let Some(cholesky) = edge.covariance.cholesky().filter(|_| is_valid) {
            self.edges.push(edge);
            self.information.push(cholesky.inverse());
        }
    }

    /// The poses.
    pub fn poses(&self) -> &[Pose2] {
        &self.poses
    }

    /// The edges.
    pub fn edges(&self) -> &[Edge] {
        &self.edges
    }

    /// Transforms a range of poses by `correction`, as a rigid body.
    pub fn move_poses(&mut self, which: Range<usize>, correction: &Pose2) {
        for pose in self.poses.iter_mut().take(which.end).skip(which.start) {
            *pose = *correction * *pose;
        }
    }

    /// Squared Mahalanobis distance between an edge and the current poses.
    pub fn squared_error(&self, edge: usize) -> f64 {
        self.squared_error_at(edge, &self.poses)
    }

    /// Information matrix of an edge.
    pub fn information(&self, edge: usize) -> &Matrix3<f64> {
        &self.information[edge]
    }

    /// Robust weight of an edge at the current poses: 1 without error, near 0 for an outlier.
    pub fn weight(&self, edge: usize) -> f64 {
        Kernel::GemanMcClure.weight(self.squared_error(edge))
    }

    /// Weighted root mean square error of all edges, in standard deviations of one coordinate.
    pub fn residual(&self) -> f64 {
        let (mut sum, mut weights) = (0.0, 0.0);
        for edge in 0..self.edges.len() {
            let weight = self.weight(edge);
            sum += weight * self.squared_error(edge);
            weights += weight;
        }
        if weights > 0.0 { (sum / (3.0 * weights)).sqrt() } else { 0.0 }
    }

    /// Optimizes the poses until a step moves none of them by `epsilon` (m, rad) or more. The first pose of each connected component is
    /// fixed.
    pub fn optimize(&mut self, epsilon: f64) {
        let fixed: Vec<bool> = self.components().iter().enumerate().map(|(i, first)| i == *first).collect();
        let pairs = self.edges.iter().map(|edge| (edge.from, edge.to));
        let pattern = Pattern::new(self.poses.len(), pairs);
        for kernel in [Kernel::Huber, Kernel::GemanMcClure] {
            for _ in 0..MAX_STEPS {
                if self.step(kernel, &pattern, &fixed).is_none_or(|moved| moved < epsilon) {
                    break;
                }
            }
        }
    }

    /// By pose: index of the first pose of its connected component.
    pub fn components(&self) -> Vec<usize> {
        let mut first: Vec<usize> = (0..self.poses.len()).collect();
        for edge in &self.edges {
            let (a, b) = (find_root(&mut first, edge.from), find_root(&mut first, edge.to));
            first[a.max(b)] = a.min(b);
        }
        (0..first.len()).map(|i| find_root(&mut first, i)).collect()
    }

    /// Performs one step; returns the largest change of any coordinate, or `None` if the step does not reduce the cost.
    fn step(&mut self, kernel: Kernel, pattern: &Pattern, fixed: &[bool]) -> Option<f64> {
        let before = self.cost(kernel, &self.poses);
        let mut step = self.gauss_newton(kernel, pattern, fixed)?;
        for _ in 0..=MAX_HALVINGS {
            let moved: Vec<Pose2> = self.poses.iter().zip(&step).map(|(pose, step)| apply_step(pose, step)).collect();
            if self.cost(kernel, &moved) <= before {
                self.poses = moved;
                return Some(step.iter().map(Vector3::amax).fold(0.0, f64::max));
            }
            for step in &mut step {
                *step *= 0.5;
            }
        }
        None
    }

    fn cost(&self, kernel: Kernel, poses: &[Pose2]) -> f64 {
        (0..self.edges.len()).map(|edge| kernel.cost(self.squared_error_at(edge, poses))).sum()
    }

    fn squared_error_at(&self, edge: usize, poses: &[Pose2]) -> f64 {
        let Edge { from, to, motion, .. } = &self.edges[edge];
        let error = error(&poses[*from], &poses[*to], motion);
        error.dot(&(self.information[edge] * error))
    }

    /// The Gauss-Newton step with the current robust weights.
    fn gauss_newton(&self, kernel: Kernel, pattern: &Pattern, fixed: &[bool]) -> Option<Vec<Vector3<f64>>> {
        let mut matrix = pattern.zeros();
        let mut gradient = vec![Vector3::zeros(); self.poses.len()];
        for (edge, information) in self.edges.iter().zip(&self.information) {
            let [a, b] = [edge.from, edge.to];
            let error = error(&self.poses[a], &self.poses[b], &edge.motion);
            let information = information * kernel.weight(error.dot(&(information * error)));
            let [by_a, by_b] = jacobians(&self.poses[a], &self.poses[b]);
            for (i, by_i) in [(a, by_a), (b, by_b)] {
                if !fixed[i] {
                    matrix.add(i, i, &(by_i.transpose() * information * by_i));
                    gradient[i] -= by_i.transpose() * information * error;
                }
            }
            if !fixed[a] && !fixed[b] {
                matrix.add(a, b, &(by_a.transpose() * information * by_b));
            }
        }
        for (i, _) in fixed.iter().enumerate().filter(|(_, fixed)| **fixed) {
            matrix.add(i, i, &Matrix3::identity());
        }
        Some(matrix.factorize()?.solve(&gradient))
    }
}

/// Finds the root of `i` in a union-find structure, with path compression.
fn find_root(first: &mut [usize], mut i: usize) -> usize {
    while first[i] != i {
        first[i] = first[first[i]];
        i = first[i];
    }
    i
}

fn apply_step(pose: &Pose2, step: &Vector3<f64>) -> Pose2 {
    Pose2::new(pose.x + step.x, pose.y + step.y, pose.theta + step.z)
}

/// Error of the measured `motion`, given the poses `a` and `b`.
fn error(a: &Pose2, b: &Pose2, motion: &Pose2) -> Vector3<f64> {
    motion.difference(&a.between(b))
}

/// Jacobians of the error with respect to `a` and `b`.
pub(super) fn jacobians(a: &Pose2, b: &Pose2) -> [Matrix3<f64>; 2] {
    let (sin, cos) = a.theta.sin_cos();
    let motion = a.between(b);
    #[rustfmt::skip]
    let by_a = Matrix3::new(
        -cos, -sin, motion.y,
        sin, -cos, -motion.x,
        0.0, 0.0, -1.0,
    );
    [by_a, rotation(-a.theta)]
}

#[cfg(test)]
mod tests {
    use nalgebra::{DMatrix, DVector};
    use proptest::prelude::*;
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64;

    use super::*;
    use crate::geometry::wrap_angle;

    fn poses() -> impl Strategy<Value = Pose2> {
        (-20.0..20.0, -20.0..20.0, -3.0..3.0).prop_map(|(x, y, theta)| Pose2::new(x, y, theta))
    }

    proptest! {
        #[test]
        fn jacobians_match_finite_differences(a in poses(), b in poses(), m in poses()) {
            let step = 1e-6;
            for (which, by) in jacobians(&a, &b).iter().enumerate() {
                for i in 0..3 {
                    let mut change = Vector3::zeros();
                    change[i] = step;
                    let moved = |pose: &Pose2, is_moved: bool, sign: f64| if is_moved { apply_step(pose, &(change * sign)) } else { *pose };
                    let at = |sign: f64| error(&moved(&a, which == 0, sign), &moved(&b, which == 1, sign), &m);
                    let mut difference = at(1.0) - at(-1.0);
                    difference.z = wrap_angle(difference.z);
                    prop_assert!((difference / (2.0 * step) - by.column(i)).amax() < 1e-6);
                }
            }
        }
    }

    /// A square of four sides with `steps` poses each, driven `laps` times; every edge has noise.
    fn square(steps: usize, laps: usize, seed: u64) -> (Vec<Pose2>, PoseGraph) {
        let mut random = Pcg64::seed_from_u64(seed);
        let mut noise = |sigma: f64| sigma * (0..12).map(|_| random.random_range(-0.5..0.5)).sum::<f64>();
        let mut truth = vec![Pose2::IDENTITY];
        for i in 1..4 * steps * laps {
            let rotation = if i % steps == 0 { 1.57 } else { 0.0 };
            truth.push(truth[i - 1] * Pose2::new(0.5, 0.0, rotation));
        }
        let covariance = PoseCovariance::from_diagonal(&[1e-4, 1e-4, 4e-6].into());
        let mut edge = |from: usize, to: usize, kind| {
            let motion = truth[from].between(&truth[to]);
            let motion = Pose2::new(motion.x + noise(0.01), motion.y + noise(0.01), motion.theta + noise(0.002));
            Edge { from, to, motion, covariance, kind }
        };
        let mut graph = PoseGraph::default();
        graph.add_pose(truth[0]);
        for i in 1..truth.len() {
            let step = edge(i - 1, i, EdgeKind::Sequence);
            graph.add_pose(graph.poses()[i - 1] * step.motion);
            graph.add_edge(step);
        }
        for i in (4 * steps..truth.len()).step_by(3) {
            graph.add_edge(edge(i - 4 * steps, i, EdgeKind::Loop));
        }
        (truth, graph)
    }

    fn max_error(truth: &[Pose2], graph: &PoseGraph) -> f64 {
        truth.iter().zip(graph.poses()).map(|(a, b)| a.between(b).distance()).fold(0.0, f64::max)
    }

    #[test]
    fn a_step_matches_the_dense_solution() {
        let (_, graph) = square(5, 2, 1);
        let fixed: Vec<bool> = graph.components().iter().enumerate().map(|(i, first)| i == *first).collect();
        let count = graph.poses().len();
        let pattern = Pattern::new(count, graph.edges().iter().map(|edge| (edge.from, edge.to)));
        let step = graph.gauss_newton(Kernel::Huber, &pattern, &fixed).unwrap();
        let (mut matrix, mut rhs) = (DMatrix::<f64>::zeros(3 * count, 3 * count), DVector::<f64>::zeros(3 * count));
        for (number, edge) in graph.edges().iter().enumerate() {
            let (a, b) = (&graph.poses()[edge.from], &graph.poses()[edge.to]);
            let mut jacobian = DMatrix::<f64>::zeros(3, 3 * count);
            for (i, by) in [edge.from, edge.to].iter().zip(jacobians(a, b)) {
                if !fixed[*i] {
                    jacobian.view_mut((0, 3 * i), (3, 3)).copy_from(&by);
                }
            }
            let information = graph.information[number] * Kernel::Huber.weight(graph.squared_error(number));
            matrix += jacobian.transpose() * information * &jacobian;
            rhs -= jacobian.transpose() * (information * error(a, b, &edge.motion));
        }
        matrix.view_mut((0, 0), (3, 3)).fill_with_identity();
        let expected = matrix.cholesky().unwrap().solve(&rhs);
        for (i, value) in step.iter().flat_map(|v| [v.x, v.y, v.z]).enumerate() {
            assert!((value - expected[i]).abs() < 1e-9, "{i}");
        }
    }

    #[test]
    fn loop_closures_correct_a_path() {
        let (truth, mut graph) = square(20, 3, 2);
        let before = max_error(&truth, &graph);
        graph.optimize(1e-6);
        let after = max_error(&truth, &graph);
        assert!(before > 0.15 && after < 0.1 && graph.residual() < 1.2, "{before} {after} {}", graph.residual());
    }

    #[test]
    fn outlier_edges_do_not_distort_the_graph() {
        let (truth, mut graph) = square(20, 3, 3);
        let mut undistorted = graph.clone();
        undistorted.optimize(1e-6);
        let covariance = PoseCovariance::from_diagonal(&[1e-4, 1e-4, 4e-6].into());
        for (from, to) in [(10, 90), (30, 150), (47, 200)] {
            let motion = truth[from].between(&truth[to]) * Pose2::new(2.0, -1.0, 0.4);
            graph.add_edge(Edge { from, to, motion, covariance, kind: EdgeKind::Loop });
        }
        graph.optimize(1e-6);
        let distortion = undistorted.poses().iter().zip(graph.poses()).map(|(a, b)| a.between(b).distance()).fold(0.0, f64::max);
        assert!(distortion < 0.01, "{distortion}");
        let wrong = graph.edges().len() - 1;
        assert!(graph.weight(wrong) < 1e-3 && graph.weight(0) > 0.3);
    }

    #[test]
    fn disconnected_components_keep_their_first_pose() {
        let mut graph = PoseGraph::default();
        for x in 0..4 {
            graph.add_pose(Pose2::new(f64::from(x), 0.0, 0.0));
        }
        let covariance = PoseCovariance::identity();
        for from in [0, 2] {
            let motion = Pose2::new(1.5, 0.0, 0.0);
            graph.add_edge(Edge { from, to: from + 1, motion, covariance, kind: EdgeKind::Sequence });
        }
        graph.optimize(1e-6);
        let x: Vec<f64> = graph.poses().iter().map(|pose| pose.x).collect();
        assert!(x.iter().zip([0.0, 1.5, 2.0, 3.5]).all(|(x, expected)| (x - expected).abs() < 1e-9), "{x:?}");
    }

    #[test]
    fn invalid_edges_are_ignored() {
        let mut graph = PoseGraph::default();
        graph.add_pose(Pose2::IDENTITY);
        graph.add_edge(Edge {
            from: 0,
            to: 0,
            motion: Pose2::IDENTITY,
            covariance: PoseCovariance::identity(),
            kind: EdgeKind::Loop,
        });
        graph.add_edge(Edge {
            from: 0,
            to: 1,
            motion: Pose2::IDENTITY,
            covariance: PoseCovariance::identity(),
            kind: EdgeKind::Loop,
        });
        assert!(graph.edges().is_empty());
        graph.optimize(1e-6);
        assert_eq!((graph.poses(), graph.residual()), (&[Pose2::IDENTITY][..], 0.0));
    }
}
