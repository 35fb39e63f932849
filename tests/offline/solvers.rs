//! Compares the solvers with independent solutions: the problems under `shared/vectors`, a dense search over the heading, the expanded
//! quartic, and each other.

use std::f64::consts::{PI, TAU};

use anytime_scan_matcher::geometry::{Point, Pose2, wrap_angle};
use anytime_scan_matcher::matching::solver::{QuadraticForm, SolverKind};
use nalgebra::{Matrix2, Matrix4, Vector4};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

struct Problem {
    id: u32,
    tag: String,
    terms: Vec<(Point, Point, Matrix2<f64>)>,
}

impl Problem {
    fn form(&self) -> QuadraticForm {
        let mut form = QuadraticForm::default();
        for (p, q, c) in &self.terms {
            form.add(*p, *q, c);
        }
        form
    }

    /// The squared error, term by term.
    fn error(&self, pose: &Pose2) -> f64 {
        let transform = pose.transform();
        self.terms.iter().map(|(p, q, c)| (transform.apply(*p) - q).dot(&(c * (transform.apply(*p) - q)))).sum()
    }

    /// The minimum error at a fixed heading, and its position: a linear problem.
    fn at_heading(&self, theta: f64) -> (f64, Pose2) {
        let (mut a, mut b) = (Matrix2::zeros(), Point::zeros());
        let rotation = Pose2::new(0.0, 0.0, theta).transform();
        for (p, q, c) in &self.terms {
            a += c;
            b += c * (q - rotation.apply(*p));
        }
        let t = a.pseudo_inverse(1e-12 * a.norm()).unwrap() * b;
        let pose = Pose2::new(t.x, t.y, theta);
        (self.error(&pose), pose)
    }

    /// Dense scan over the heading, then golden section.
    fn best_by_search(&self) -> Pose2 {
        let steps = 2000;
        let best = (0..steps)
            .map(|i| TAU * f64::from(i) / f64::from(steps))
            .min_by(|&x, &y| self.at_heading(x).0.total_cmp(&self.at_heading(y).0))
            .unwrap();
        let (mut low, mut high) = (best - TAU / f64::from(steps), best + TAU / f64::from(steps));
        for _ in 0..60 {
            let (x, y) = (low + 0.382 * (high - low), low + 0.618 * (high - low));
            if self.at_heading(x).0 < self.at_heading(y).0 { high = y } else { low = x }
        }
        self.at_heading(0.5 * (low + high)).1
    }
}

fn shared_problems() -> Option<Vec<Problem>> {
    let text = std::fs::read_to_string(crate::common::shared("vectors/gpc.txt")?).unwrap();
    let mut problems: Vec<Problem> = Vec::new();
    for line in text.lines() {
        let words: Vec<&str> = line.split_whitespace().collect();
        match words.as_slice() {
            ["gpc", id, tag, ..] => problems.push(Problem { id: id.parse().unwrap(), tag: (*tag).into(), terms: Vec::new() }),
            ["result" | "#", ..] | [] => {}
            numbers => {
                let v: Vec<f64> = numbers.iter().map(|n| n.parse().unwrap()).collect();
                let c = Matrix2::new(v[4], v[5], v[5], v[6]);
                problems.last_mut().unwrap().terms.push((Point::new(v[0], v[1]), Point::new(v[2], v[3]), c));
            }
        }
    }
    Some(problems)
}

#[test]
fn the_closed_form_finds_the_optimum_of_every_shared_problem() {
    let (Some(problems), Some(truth)) = (shared_problems(), crate::common::shared("vectors/gpc_truth.txt")) else { return };
    let solver = SolverKind::PointToLine;
    let mut checked = 0;
    for line in std::fs::read_to_string(truth).unwrap().lines().filter(|line| !line.starts_with('#')) {
        let words: Vec<&str> = line.split_whitespace().collect();
        let number = |i: usize| words[i].parse::<f64>().unwrap();
        let problem = problems.iter().find(|problem| problem.id.to_string() == words[0]).unwrap();
        let pose = solver.solve(&problem.form(), &Pose2::IDENTITY).unwrap();
        let (best_error, best) = (number(4), Pose2::new(number(5), number(6), number(7)));
        let name = format!("problem {} {}: {pose:?}, truth {best:?}", problem.id, problem.tag);
        assert!(wrap_angle(pose.theta - best.theta).abs() < 1e-9, "{name}");
        assert!(problem.error(&pose) <= best_error * (1.0 + 1e-9) + 1e-12, "{name}: {} > {best_error}", problem.error(&pose));
        if problem.tag != "degenerate_corridor" {
            assert!((pose.translation() - best.translation()).norm() < 1e-8, "{name}");
        }
        checked += 1;
    }
    assert_eq!(checked, 269);
}

fn random_problem(rng: &mut Pcg64, id: u32) -> Problem {
    let lines = if rng.random::<f64>() < 0.3 { 3 + (id % 4) as usize } else { 7 + (id % 60) as usize };
    let truth = Pose2::new(
        crate::common::uniform(rng, -2.0, 2.0),
        crate::common::uniform(rng, -2.0, 2.0),
        crate::common::uniform(rng, -PI, PI),
    );
    let spread = if id.is_multiple_of(5) { 0.05 } else { PI };
    let noise = [0.0, 0.01, 0.3][(id % 3) as usize];
    let terms = (0..lines)
        .map(|_| {
            let p = Point::new(crate::common::uniform(rng, -10.0, 10.0), crate::common::uniform(rng, -10.0, 10.0));
            let (sin, cos) = crate::common::uniform(rng, -spread, spread).sin_cos();
            let n = Point::new(cos, sin);
            let q = truth.transform().apply(p)
                + n * (noise * crate::common::normal(rng))
                + Point::new(-sin, cos) * crate::common::uniform(rng, -1.0, 1.0);
            (p, q, n * n.transpose() * crate::common::uniform(rng, 0.2, 2.0))
        })
        .collect();
    Problem { id, tag: "random".into(), terms }
}

#[test]
fn the_closed_form_is_never_beaten_by_a_search_over_the_heading() {
    let mut rng = Pcg64::seed_from_u64(1);
    let solver = SolverKind::PointToLine;
    for id in 0..3000 {
        let problem = random_problem(&mut rng, id);
        let pose = solver.solve(&problem.form(), &Pose2::IDENTITY).unwrap();
        let by_search = problem.best_by_search();
        let (found, best) = (problem.error(&pose), problem.error(&by_search));
        assert!(found <= best * (1.0 + 1e-9) + 1e-10, "problem {id}: {found} > {best} at {pose:?}, {by_search:?}");
    }
}

/// Solves the expanded quartic of the multiplier by the eigenvalues of its companion matrix.
#[test]
fn the_answer_belongs_to_the_largest_root_of_the_quartic() {
    let mut rng = Pcg64::seed_from_u64(2);
    let solver = SolverKind::PointToLine;
    let mut negative = 0;
    // If a pose fits every line exactly, without noise or with few lines, the root is double, which the expanded polynomial cannot resolve.
    for id in (0..1500).filter(|id| id % 3 != 0) {
        let problem = random_problem(&mut rng, id);
        if problem.terms.len() < 7 {
            continue;
        }
        let (mut m, mut g) = (Matrix4::zeros(), Vector4::zeros());
        for (p, q, c) in &problem.terms {
            let mi = nalgebra::Matrix2x4::new(1.0, 0.0, p.x, -p.y, 0.0, 1.0, p.y, p.x);
            m += 2.0 * mi.transpose() * c * mi;
            g -= 2.0 * mi.transpose() * c * q;
        }
        let (a, b, d) = (m.fixed_view::<2, 2>(0, 0), m.fixed_view::<2, 2>(0, 2), m.fixed_view::<2, 2>(2, 2));
        let a_inverse = a.clone_owned().try_inverse().unwrap();
        let s = d - b.transpose() * a_inverse * b;
        let h = g.fixed_rows::<2>(2) - b.transpose() * a_inverse * g.fixed_rows::<2>(0);
        let adjugate = Matrix2::new(s.m22, -s.m12, -s.m21, s.m11);
        let (tau, delta) = (s.trace(), s.determinant());
        let c3 = 2.0 * tau;
        let c2 = tau * tau + 2.0 * delta - h.norm_squared();
        let c1 = 2.0 * (tau * delta - h.dot(&(adjugate * h)));
        let c0 = delta * delta - (adjugate * h).norm_squared();
        #[rustfmt::skip]
        let companion = Matrix4::new(
            0.0, 0.0, 0.0, -c0,
            1.0, 0.0, 0.0, -c1,
            0.0, 1.0, 0.0, -c2,
            0.0, 0.0, 1.0, -c3,
        );
        let pose = solver.solve(&problem.form(), &Pose2::IDENTITY).unwrap();
        let u = Point::new(pose.theta.cos(), pose.theta.sin());
        let multiplier = -u.dot(&(s * u + h));
        let scale = tau.abs() + h.norm();
        let largest = companion
            .complex_eigenvalues()
            .iter()
            .filter(|root| root.im.abs() < 1e-3 * scale)
            .map(|root| root.re)
            .fold(f64::NEG_INFINITY, f64::max);
        assert!((multiplier - largest).abs() < 1e-3 * scale, "problem {id}: {multiplier}, quartic {largest}");
        let quartic = ((((multiplier + c3) * multiplier + c2) * multiplier) + c1) * multiplier + c0;
        assert!(quartic.abs() < 1e-7 * scale.powi(4), "problem {id}: {quartic} is not zero");
        negative += u32::from(multiplier < 0.0);
    }
    assert!(negative > 100, "the roots must not be clamped to the positive ones: only {negative} are negative");
}

#[test]
fn iterative_solvers_converge_to_the_closed_form_from_nearby() {
    let mut rng = Pcg64::seed_from_u64(3);
    for id in 0..500 {
        let problem = random_problem(&mut rng, id * 3 + 1);
        if problem.terms.len() < 7 {
            continue;
        }
        let form = problem.form();
        let exact = SolverKind::PointToLine.solve(&form, &Pose2::IDENTITY).unwrap();
        let near = Pose2::new(exact.x + 0.05, exact.y - 0.05, exact.theta + 0.02);
        let by_levenberg_marquardt = SolverKind::LevenbergMarquardt.solve(&form, &near).unwrap();
        assert!(form.value(&by_levenberg_marquardt) <= form.value(&exact) + 1e-8, "problem {id}");
        let linearized = SolverKind::Linearized;
        let mut pose = near;
        for _ in 0..20 {
            pose = linearized.solve(&form, &pose).unwrap();
        }
        let difference = exact.between(&pose);
        assert!(difference.distance() < 1e-6 && difference.theta.abs() < 1e-6, "problem {id}: {difference:?}");
    }
}

#[test]
fn point_to_point_recovers_a_motion_and_beats_a_search() {
    let mut rng = Pcg64::seed_from_u64(4);
    let solver = SolverKind::PointToPoint;
    for id in 0..300 {
        let mut problem = random_problem(&mut rng, id);
        for term in &mut problem.terms {
            term.2 = Matrix2::identity();
        }
        let pose = solver.solve(&problem.form(), &Pose2::IDENTITY).unwrap();
        let best = problem.best_by_search();
        assert!(problem.error(&pose) <= problem.error(&best) * (1.0 + 1e-9) + 1e-10, "problem {id}");
    }
}

#[test]
fn unconstrained_directions_stay_at_the_prior() {
    let prior = Pose2::new(0.7, 0.2, 0.1);
    let solver = SolverKind::PointToLine;
    // Walls along x only: x stays where it was.
    let mut corridor = QuadraticForm::default();
    for i in 0..20 {
        let side = if i % 2 == 0 { 1.5 } else { -1.5 };
        corridor.add_line(Point::new(f64::from(i) * 0.3 - 3.0, side), Point::new(0.0, 1.0), side, 1.0);
    }
    let pose = solver.solve(&corridor, &prior).unwrap();
    assert!((pose.x - 0.7).abs() < 1e-9 && pose.y.abs() < 1e-9 && pose.theta.abs() < 1e-9, "{pose:?}");
    // All points at the laser itself: no heading.
    let mut point = QuadraticForm::default();
    for i in 0..10 {
        let (sin, cos) = f64::from(i).sin_cos();
        point.add_line(Point::zeros(), Point::new(cos, sin), 0.0, 1.0);
    }
    let pose = solver.solve(&point, &prior).unwrap();
    assert!(pose.translation().norm() < 1e-9 && (pose.theta - 0.1).abs() < 1e-12, "{pose:?}");
    // No pairs at all: no pose, and no crash.
    for kind in SolverKind::ALL {
        let answer = kind.solve(&QuadraticForm::default(), &prior);
        assert!(answer.is_none_or(|pose| pose.is_finite()), "{}", kind.name());
    }
}
