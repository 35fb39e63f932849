//! The search for a robot that may be anywhere: how much of what it sees is news, and when it has been found.

use super::filter::Belief;
use super::recovery::Fit;
use crate::geometry::Pose2;

/// Scans from nearer than this, m and rad, show the same once more: together they are no more evidence than one.
const VIEW: (f64, f64) = (0.5, 0.5);
/// Part of the weight with which a place has no rival.
const NO_RIVAL: f64 = 0.99;
/// The robot is found when a place has had no rival for this way, m: corridors look alike for a while.
const WAY_WITHOUT_RIVAL: f64 = 2.0;

/// How far it has come.
#[derive(Clone, Debug)]
pub(super) struct Search {
    /// Evidence that the robot's motion has made new and that has not been used, in scans.
    news: f64,
    /// Way without a rival, m.
    way: f64,
    fit: Fit,
}

impl Search {
    /// Nothing has been seen. Where the robot is, the likelihood of scans per beam is expected to be `fit`.
    pub(super) fn expecting(fit: f64) -> Self {
        Self { news: 1.0, way: 0.0, fit: Fit::expecting(fit) }
    }

    /// The robot has moved.
    pub(super) fn moved(&mut self, motion: &Pose2) {
        self.news = (self.news + motion.distance() / VIEW.0 + motion.theta.abs() / VIEW.1).min(1.0);
        self.way += motion.distance();
    }

    /// The power to which the likelihood of the next scan may be taken.
    pub(super) fn news(&self) -> f64 {
        self.news
    }

    /// The likelihood of a scan has been taken to `power`.
    pub(super) fn used(&mut self, power: f64, belief: &Belief) {
        self.news -= power;
        if belief.beams > 0 {
            self.fit.add(belief.fit);
        }
        if belief.share < NO_RIVAL || !belief.is_compact() {
            self.way = 0.0;
        }
    }

    /// Whether it is on the wrong track everywhere: scans fit worse than `part` of what is expected.
    pub(super) fn is_lost(&self, part: f64) -> bool {
        self.fit.is_lost(part)
    }

    /// Whether it is over.
    pub(super) fn is_over(&self) -> bool {
        self.way >= WAY_WITHOUT_RIVAL
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::PoseCovariance;

    fn belief(share: f64) -> Belief {
        Belief {
            map_from_base: Pose2::IDENTITY,
            covariance: PoseCovariance::identity() * 1e-4,
            share,
            particles: 4000,
            effective: 400.0,
            beams: 60,
            fit: 0.1,
            is_sought: true,
        }
    }

    #[test]
    fn a_robot_at_rest_sees_nothing_new_and_is_not_found() {
        let mut search = Search::expecting(0.1);
        search.used(0.75, &belief(1.0));
        for _ in 0..100 {
            search.moved(&Pose2::IDENTITY);
            search.used(search.news().min(0.75), &belief(1.0));
        }
        assert!(search.news() < 1e-9 && !search.is_over());
        search.moved(&Pose2::new(0.25, 0.0, 0.0));
        assert!((search.news() - 0.5).abs() < 1e-9);
    }

    #[test]
    fn it_is_found_where_no_other_place_has_been_likely_for_a_while() {
        let drive = |shares: &[f64]| {
            let mut search = Search::expecting(0.1);
            for &share in shares {
                search.moved(&Pose2::new(0.5, 0.0, 0.0));
                search.used(0.1, &belief(share));
            }
            search.is_over()
        };
        assert!(!drive(&[0.8, 1.0, 1.0, 1.0]) && drive(&[0.8, 1.0, 1.0, 1.0, 1.0]));
        assert!(!drive(&[0.8, 1.0, 1.0, 0.9, 1.0]));
    }
}
