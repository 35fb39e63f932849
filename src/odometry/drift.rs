//! Puts right a path that has drifted, once a place of earlier on it is recognised.
//!
//! Step k of the path errs by `e_k` (x, y, turn) with covariance `C_k`. About its own end a step's error turns all that follows, so
//! that the end of the path is off by `d = sum A_k e_k`, with `A_k` the lever from there to the end. Of all errors that explain `d`,
//! the likeliest are `e_k = C_k A_k' (sum A_j C_j A_j')^-1 d`: least squares over the steps with the recognised place as constraint, by
//! Lagrange multipliers. A path that has drifted in one bad corner is turned there, and not bent all along. It is what a pose
//! graph comes to for one path and one loop that is sure, in closed form.

use nalgebra::Matrix3;

use super::placement::Placement;
use super::uncertainty::way_by_heading;
use crate::geometry::{Pose2, PoseCovariance};

/// Levers turn with the path: so many times the errors are found anew. Of a drift of a metre and 0.1 rad less than a millimetre is left.
const ROUNDS: usize = 3;

/// Moves the places of a path, so that it ends at `end`. The first step leads to the first place, from one that stays.
pub(super) fn put_right<'a>(path: impl Iterator<Item = &'a mut Placement>, end: &Pose2) {
    let mut path: Vec<_> = path.collect();
    for _ in 0..ROUNDS {
        move_end(&mut path, end);
    }
    // To the last bit, as what follows is moved as the last place is.
    if let Some(last) = path.last_mut() {
        last.map_from_laser = *end;
    }
}

/// Covariance of the end of a path, as its steps add up to it.
pub(super) fn covariance<'a>(path: impl Iterator<Item = &'a Placement> + Clone) -> PoseCovariance {
    let Some(end) = path.clone().last().map(|place| place.map_from_laser) else { return PoseCovariance::zeros() };
    let of_step = |place: &Placement| {
        let lever = lever(&place.map_from_laser, &end);
        lever * place.step_covariance * lever.transpose()
    };
    path.map(of_step).sum()
}

/// What an error at a place makes of the end.
fn lever(from: &Pose2, end: &Pose2) -> Matrix3<f64> {
    way_by_heading(end.translation() - from.translation())
}

/// Gives each step its share of what is between the path's last place and `end`, as if levers stayed as they are.
fn move_end(path: &mut [&mut Placement], end: &Pose2) {
    let Some(last) = path.last().map(|place| place.map_from_laser) else { return };
    let Some(information) = covariance(path.iter().map(|place| &**place)).try_inverse() else { return };
    let multipliers = information * last.difference(end);
    let mut moved = Pose2::IDENTITY;
    for Placement { map_from_laser, step_covariance, .. } in path.iter_mut().map(|place| &mut **place) {
        let error = *step_covariance * lever(map_from_laser, &last).transpose() * multipliers;
        let carried = moved * *map_from_laser;
        let new = Pose2::new(carried.x + error.x, carried.y + error.y, carried.theta + error.z);
        moved = new * map_from_laser.inverse();
        *map_from_laser = new;
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::time::Stamp;

    fn place(pose: Pose2, position: f64, heading: f64) -> Placement {
        let step_covariance =
            PoseCovariance::from_diagonal(&[position * position, position * position, heading * heading].into());
        Placement {
            stamp: Stamp::default(),
            map_from_laser: pose,
            base_from_laser: Pose2::IDENTITY,
            covariance: PoseCovariance::zeros(),
            step_covariance,
        }
    }

    /// 20 m along x, round a corner, and 20 m along y; headings are as sure as the steps, but for the one at the corner.
    fn round_a_corner(heading_there: f64) -> Vec<Placement> {
        let there = (1..=20).map(|i| Pose2::new(f64::from(i), 0.0, 0.0));
        let on = (1..=20).map(|i| Pose2::new(20.0, f64::from(i), 1.57));
        let places = there.chain(on).enumerate();
        places.map(|(i, pose)| place(pose, 0.01, if i == 20 { heading_there } else { 1e-4 })).collect()
    }

    #[test]
    fn a_bad_corner_is_turned_and_the_rest_left_alone() {
        let mut path = round_a_corner(0.1);
        let turn = 0.05;
        // As if the second leg began at (20, 1) and led 19 m in another direction.
        let end = Pose2::new(20.0 - 19.0 * f64::sin(turn), 1.0 + 19.0 * f64::cos(turn), 1.57 + turn);
        put_right(path.iter_mut(), &end);
        assert!(path[..20].iter().all(|place| place.map_from_laser.y.abs() < 0.01), "the first leg stays");
        assert!(
            (path[20].map_from_laser.theta - 1.57 - turn).abs() < 1e-3
                && (path[30].map_from_laser.theta - 1.57 - turn).abs() < 1e-3
        );
        assert!((path[30].map_from_laser.x - (20.0 - 10.0 * f64::sin(turn))).abs() < 0.01);
    }

    #[test]
    fn the_covariance_of_the_end_is_that_of_the_steps_turned_about_it() {
        let path: Vec<_> = (1..=2).map(|i| place(Pose2::new(f64::from(i), 0.0, 0.0), 0.1, 0.2)).collect();
        let end = covariance(path.iter());
        // The first step's turn moves the end by a metre a radian, the second one's does not.
        let expected = Matrix3::new(0.02, 0.0, 0.0, 0.0, 0.02 + 0.04, 0.04, 0.0, 0.04, 0.08);
        assert!((end - expected).norm() < 1e-12, "{end}");
        assert_eq!(covariance(std::iter::empty()), PoseCovariance::zeros());
    }

    #[test]
    fn equal_steps_share_a_shift() {
        let mut path: Vec<_> = (1..=10).map(|i| place(Pose2::new(f64::from(i), 0.0, 0.0), 0.01, 1e-9)).collect();
        put_right(path.iter_mut(), &Pose2::new(10.5, 0.2, 0.0));
        for (i, place) in path.iter().enumerate() {
            let part = (i + 1) as f64 / 10.0;
            let Pose2 { x, y, .. } = place.map_from_laser;
            assert!((x - 10.5 * part).abs() < 1e-6 && (y - 0.2 * part).abs() < 1e-6, "{i}: {x} {y}");
        }
    }

    #[test]
    fn where_every_step_is_sure_only_the_end_moves() {
        let mut path: Vec<_> = (1..=3).map(|i| place(Pose2::new(f64::from(i), 0.0, 0.0), 0.0, 0.0)).collect();
        let end = Pose2::new(3.0, 0.1, 0.0);
        put_right(path.iter_mut(), &end);
        assert_eq!((path[1].map_from_laser, path[2].map_from_laser), (Pose2::new(2.0, 0.0, 0.0), end));
        put_right(std::iter::empty(), &end);
    }

    proptest! {
        #[test]
        fn before_the_last_bit_the_path_has_come_to_its_end(x in -1.0..1.0, y in -1.0..1.0, turn in -0.1..0.1, at_corner in 1e-4..0.1) {
            let mut path = round_a_corner(at_corner);
            let end = Pose2::new(20.0 + x, 20.0 + y, 1.57 + turn);
            let mut path: Vec<_> = path.iter_mut().collect();
            for _ in 0..ROUNDS {
                move_end(&mut path, &end);
            }
            let left = path[39].map_from_laser.between(&end);
            prop_assert!(left.distance() < 1e-3 && left.theta.abs() < 1e-6, "{left:?}");
        }
    }
}
