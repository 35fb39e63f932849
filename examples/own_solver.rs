//! A custom solver, compared with the closed form: `cargo run --release --example own_solver --no-default-features`.
//!
//! To make it a value of `matching.solver`, move it into the crate: ARCHITECTURE.md, "Where to add what".
#![allow(clippy::print_stdout)] // an example prints its results

use anytime_scan_matcher::geometry::{Point, Pose2};
use anytime_scan_matcher::matching::solver::{QuadraticForm, SolverKind};

/// Gauss-Newton steps, each halved until the error falls.
fn gauss_newton(form: &QuadraticForm, prior: &Pose2) -> Option<Pose2> {
    let mut pose = *prior;
    for _ in 0..20 {
        let (gradient, hessian) = form.linearize(&pose);
        let step = hessian.cholesky()?.solve(&-gradient); // `None`: the pairs leave a direction unconstrained
        let moved = |scale: f64| Pose2::new(pose.x + scale * step.x, pose.y + scale * step.y, pose.theta + scale * step.z);
        let scales = (0..10).map(|halvings| 0.5_f64.powi(halvings));
        match scales.map(moved).find(|next| form.value(next) < form.value(&pose)) {
            Some(next) => pose = next,
            None => break,
        }
    }
    pose.is_finite().then_some(pose)
}

fn main() {
    // Points on the walls x = 3, y = 2 and x + y = -1, seen from a robot that has moved by `truth`.
    let truth = Pose2::new(0.2, -0.1, 0.15);
    let slanted = Point::new(1.0, 1.0).normalize();
    let walls = [(Point::x(), 3.0), (Point::y(), 2.0), (slanted, -slanted.x)];
    let mut form = QuadraticForm::default();
    for (normal, offset) in walls {
        let along = Point::new(-normal.y, normal.x);
        for k in -5..=5 {
            let on_wall = normal * offset + along * (0.3 * f64::from(k));
            form.add_line(truth.inverse().transform().apply(on_wall), normal, offset, 1.0);
        }
    }
    println!("truth        {truth:?}");
    println!("closed form  {:?}", SolverKind::PointToLine.solve(&form, &Pose2::IDENTITY));
    println!("own solver   {:?}", gauss_newton(&form, &Pose2::IDENTITY));
}
