//! Solvers: the pose that minimises the error of the correspondences.
//!
//! One pass over the correspondences sums their squared errors into a [`QuadraticForm`] of `(x, y, cos, sin)`. Each solver
//! minimises that form, in constant time whatever the number of correspondences.
//!
//! To add a solver, write a file with a function like the other `solve` functions, and add a variant to [`SolverKind`] and a line
//! to `SolverKind::function`.

mod levenberg_marquardt;
mod linearized;
mod point_to_line;
mod point_to_point;

use std::ops::AddAssign;

use nalgebra::{Matrix2, Matrix3, Matrix4, Matrix4x3, Vector3, Vector4};

use crate::geometry::{Point, Pose2, PoseCovariance};

/// Error metric of a correspondence.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Metric {
    /// Distance of the sensed point from the line of the reference segment.
    PointToLine,
    /// Distance of the sensed point from the reference point.
    PointToPoint,
}

crate::choices! {
    /// Solvers.
    pub enum SolverKind {
        /// Point-to-line error, global minimum in closed form (Censi 2008).
        PointToLine = "point_to_line",
        /// Point-to-point error, global minimum in closed form (Lu and Milios 1997).
        PointToPoint = "point_to_point",
        /// Point-to-line error, nonlinear least squares.
        LevenbergMarquardt = "levenberg_marquardt",
        /// Point-to-line error, one step of linear least squares.
        Linearized = "linearized",
    }
}

impl SolverKind {
    /// The error metric that the solver minimises.
    pub fn metric(self) -> Metric {
        if self == Self::PointToPoint { Metric::PointToPoint } else { Metric::PointToLine }
    }

    /// The pose that minimises a form. `prior` decides along unconstrained directions, and iterative solvers start there. `None`:
    /// there is no finite solution.
    pub fn solve(self, form: &QuadraticForm, prior: &Pose2) -> Option<Pose2> {
        self.function()(form, prior).filter(Pose2::is_finite)
    }

    pub(super) fn function(self) -> fn(&QuadraticForm, &Pose2) -> Option<Pose2> {
        match self {
            Self::PointToLine => point_to_line::solve,
            Self::PointToPoint => point_to_point::solve,
            Self::LevenbergMarquardt => levenberg_marquardt::solve,
            Self::Linearized => linearized::solve,
        }
    }
}

/// The sum over correspondences of `(R p + t - q)' C (R p + t - q)` as a function of `x = (t, cos, sin)`: `x' M x + g' x + c`
/// (Censi 2008, section III).
#[derive(Clone, Copy, Debug, Default)]
pub struct QuadraticForm {
    matrix: Matrix4<f64>,
    gradient: Vector4<f64>,
    constant: f64,
}

impl QuadraticForm {
    /// Adds `weight` times the squared distance of the moved point `p` from the line `normal . x = offset`.
    #[inline]
    pub fn add_line(&mut self, p: Point, normal: Point, offset: f64, weight: f64) {
        // The distance is a'x - offset, with a = M_i' n.
        let a = Vector4::new(normal.x, normal.y, normal.dot(&p), normal.y * p.x - normal.x * p.y);
        let weighted = weight * a;
        self.matrix += weighted * a.transpose();
        self.gradient -= 2.0 * offset * weighted;
        self.constant += weight * offset * offset;
    }

    /// Adds `(R p + t - q)' C (R p + t - q)` for a symmetric C.
    pub fn add(&mut self, p: Point, q: Point, c: &Matrix2<f64>) {
        let m = nalgebra::Matrix2x4::new(1.0, 0.0, p.x, -p.y, 0.0, 1.0, p.y, p.x);
        let weighted = c * m;
        self.matrix += m.transpose() * weighted;
        self.gradient -= 2.0 * weighted.transpose() * q;
        self.constant += q.dot(&(c * q));
    }

    /// The form from sums at a pose, where the errors are `e`: of `w a a'` (upper triangle, row by row), of `w a e` and of `w
    /// e^2`. Sums of errors at the pose lose no digits to the size of its coordinates.
    pub fn from_sums(pose: &Pose2, upper: &[f64; 10], gradient: &[f64; 4], value: f64) -> Self {
        let [m11, m12, m13, m14, m22, m23, m24, m33, m34, m44] = *upper;
        #[rustfmt::skip]
        let matrix = Matrix4::new(
            m11, m12, m13, m14,
            m12, m22, m23, m24,
            m13, m23, m33, m34,
            m14, m24, m34, m44,
        );
        let x = lift(pose);
        let gradient = 2.0 * (Vector4::from(*gradient) - matrix * x);
        Self { matrix, gradient, constant: value - x.dot(&(matrix * x)) - gradient.dot(&x) }
    }

    /// The form of a prior with `covariance` (m, m, rad) about `pose`. `unit`: variance of an error of weight 1.
    pub fn from_prior(pose: &Pose2, covariance: &PoseCovariance, unit: f64) -> Self {
        let Some(information) = covariance.try_inverse().map(|inverse| inverse * unit) else { return Self::default() };
        // For small angles, |u - u0| is the angle between the two, along the perpendicular of u0.
        let (sin, cos) = pose.theta.sin_cos();
        let by_pose = nalgebra::Matrix3x4::new(1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, -sin, cos);
        let coupled = by_pose.transpose() * information * by_pose;
        let x = lift(pose);
        let mut form = Self { matrix: coupled, gradient: -2.0 * coupled * x, constant: x.dot(&(coupled * x)) };
        // The sine of the angle alone, measured along the perpendicular, could not tell a heading from its opposite.
        let kappa = information.m33;
        let along = Vector4::new(0.0, 0.0, cos, sin);
        form.matrix += kappa * along * along.transpose();
        form.gradient -= 2.0 * kappa * along;
        form.constant += kappa;
        form
    }

    /// Converts a form of poses in `frame` to one of poses in the parent frame of `frame`.
    #[must_use]
    pub fn in_parent_frame(&self, frame: &Pose2) -> Self {
        if *frame == Pose2::IDENTITY {
            return *self;
        }
        let (sin, cos) = frame.theta.sin_cos();
        #[rustfmt::skip]
        let rotation = Matrix4::new(
            cos, sin, 0.0, 0.0,
            -sin, cos, 0.0, 0.0,
            0.0, 0.0, cos, sin,
            0.0, 0.0, -sin, cos,
        );
        let shift = -rotation * Vector4::new(frame.x, frame.y, 0.0, 0.0);
        let gradient = self.gradient + 2.0 * self.matrix * shift;
        Self {
            matrix: rotation.transpose() * self.matrix * rotation,
            gradient: rotation.transpose() * gradient,
            constant: self.constant + self.gradient.dot(&shift) + shift.dot(&(self.matrix * shift)),
        }
    }

    /// The form multiplied by a factor.
    #[must_use]
    pub fn scaled(&self, factor: f64) -> Self {
        Self { matrix: self.matrix * factor, gradient: self.gradient * factor, constant: self.constant * factor }
    }

    /// The value of the sum at a pose. Rounding can make it slightly negative.
    pub fn value(&self, pose: &Pose2) -> f64 {
        let x = lift(pose);
        x.dot(&(self.matrix * x)) + self.gradient.dot(&x) + self.constant
    }

    /// Gradient of the sum at a pose and Gauss-Newton approximation of its Hessian, in (x, y, heading).
    pub fn linearize(&self, pose: &Pose2) -> (Vector3<f64>, Matrix3<f64>) {
        let (sin, cos) = pose.theta.sin_cos();
        #[rustfmt::skip]
        let tangent = Matrix4x3::new(
            1.0, 0.0, 0.0,
            0.0, 1.0, 0.0,
            0.0, 0.0, -sin,
            0.0, 0.0, cos,
        );
        let gradient = 2.0 * self.matrix * Vector4::new(pose.x, pose.y, cos, sin) + self.gradient;
        (tangent.transpose() * gradient, 2.0 * tangent.transpose() * self.matrix * tangent)
    }

    /// The blocks A, B and D of `2M = [A B; B' D]`, and the parts of the gradient by translation and rotation.
    fn blocks(&self) -> ([Matrix2<f64>; 3], [Point; 2]) {
        let blocks = [(0, 0), (0, 2), (2, 2)].map(|(row, column)| 2.0 * self.matrix.fixed_view::<2, 2>(row, column));
        (blocks, [0, 2].map(|row| self.gradient.fixed_rows::<2>(row).into()))
    }
}

impl AddAssign for QuadraticForm {
    fn add_assign(&mut self, other: Self) {
        self.matrix += other.matrix;
        self.gradient += other.gradient;
        self.constant += other.constant;
    }
}

/// The vector `x = (t, cos, sin)` of a pose.
fn lift(pose: &Pose2) -> Vector4<f64> {
    let (sin, cos) = pose.theta.sin_cos();
    Vector4::new(pose.x, pose.y, cos, sin)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn poses() -> impl Strategy<Value = Pose2> {
        (-5.0..5.0, -5.0..5.0, -3.0..3.0).prop_map(|(x, y, theta)| Pose2::new(x, y, theta))
    }

    fn pairs() -> impl Strategy<Value = Vec<(Point, Point, f64, f64)>> {
        let pair = (-9.0..9.0, -9.0..9.0, -3.0_f64..3.0, -9.0..9.0, 0.1..9.0);
        let pair = pair
            .prop_map(|(x, y, angle, offset, weight)| (Point::new(x, y), Point::new(angle.cos(), angle.sin()), offset, weight));
        proptest::collection::vec(pair, 3..9)
    }

    fn form(pairs: &[(Point, Point, f64, f64)]) -> QuadraticForm {
        let mut form = QuadraticForm::default();
        for &(p, normal, offset, weight) in pairs {
            form.add_line(p, normal, offset, weight);
        }
        form
    }

    fn assert_same(a: f64, b: f64) {
        assert!((a - b).abs() <= 1e-9 * (1.0 + a.abs().max(b.abs())), "{a} is not {b}");
    }

    proptest! {
        #[test]
        fn a_form_has_the_same_value_in_another_frame(pairs in pairs(), frame in poses(), pose in poses()) {
            let form = form(&pairs);
            assert_same(form.in_parent_frame(&frame).value(&(frame * pose)), form.value(&pose));
        }

        #[test]
        fn sums_at_a_pose_give_the_same_form(pairs in pairs(), at in poses(), pose in poses()) {
            let (mut upper, mut gradient, mut value) = ([0.0; 10], [0.0; 4], 0.0);
            for &(p, normal, offset, weight) in &pairs {
                let error = normal.dot(&at.transform().apply(p)) - offset;
                let a = [normal.x, normal.y, normal.dot(&p), normal.y * p.x - normal.x * p.y];
                let products = (0..4).flat_map(|i| (i..4).map(move |j| (i, j)));
                products.enumerate().for_each(|(k, (i, j))| upper[k] += weight * a[i] * a[j]);
                (0..4).for_each(|i| gradient[i] += weight * a[i] * error);
                value += weight * error * error;
            }
            assert_same(QuadraticForm::from_sums(&at, &upper, &gradient, value).value(&pose), form(&pairs).value(&pose));
        }

        #[test]
        fn a_prior_is_minimal_at_its_pose_and_has_its_covariance(pose in poses(), x in 0.01..1.0, y in 0.01..1.0, heading in 0.01..1.0) {
            let covariance = PoseCovariance::from_diagonal(&[x * x, y * y, heading * heading].into());
            let prior = QuadraticForm::from_prior(&pose, &covariance, 1e-4);
            let (gradient, hessian) = prior.linearize(&pose);
            assert!(gradient.norm() < 1e-9 && prior.value(&pose).abs() < 1e-9);
            assert!((hessian - 2e-4 * covariance.try_inverse().unwrap()).norm() < 1e-6 * hessian.norm());
            assert!(prior.value(&Pose2::new(pose.x, pose.y, pose.theta + 3.1)) > 0.0, "the opposite heading must have a cost");
        }
    }
}
