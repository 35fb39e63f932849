//! Places of earlier on the path, recognised by the last keyframe: the map is put right.

use super::local_map::Unrecognised;
use super::loop_closure::{self, Sighting};
use super::{LaserOdometry, uncertainty};
use crate::anytime::Driver;
use crate::matching::{FirstGuess, StopReason};

impl LaserOdometry {
    /// Compares the last keyframe with those of long ago that seem to be around, if it has not been done; puts the map right by what
    /// comes of it. The next scans are answered the better for it, but none needs to wait for it.
    pub fn close_loop(&mut self, driver: &mut Driver) {
        if !std::mem::take(&mut self.to_be_recognised) {
            return;
        }
        if let Some(recognised) = self.unrecognised() {
            match self.sight(&recognised, driver) {
                // Again when there is more time.
                None => self.to_be_recognised = true,
                Some(sighting) if self.loop_closer.believes(&sighting) => self.recognise(&recognised, &sighting),
                Some(_) => {}
            }
            self.choose_views();
        } else {
            self.loop_closer.forget();
        }
    }

    /// The keyframes to compare the last one with, as `views`; none while scans are matched to such keyframes anyway.
    pub(super) fn unrecognised(&mut self) -> Option<Unrecognised> {
        let (place, _) = self.map.last().filter(|_| self.map.is_exploring())?;
        self.map.unrecognised_around(&place, self.knobs.views as usize, &mut self.views)
    }

    /// Matches the last keyframe to `views`, the first of which was taken at `earlier`; `None`: there was no time for it.
    pub(super) fn sight(&mut self, earlier: &Unrecognised, driver: &mut Driver) -> Option<Sighting> {
        let (by_path, view) = self.map.last()?;
        self.matcher.set_views(&self.views);
        let pose = earlier.map_from_laser.between(&by_path);
        let guess = FirstGuess { pose, prior: None, window: loop_closure::window(self.map.free_way(earlier)) };
        let mut refinement = self.matcher.begin(view.scan(), guess);
        if driver.drive(&mut refinement) == StopReason::Interrupted {
            return None;
        }
        let by_earlier = earlier.map_from_laser * refinement.pose();
        let agreement = refinement.agreement().unwrap_or_default();
        let rays = refinement.trace().last().map_or(0, |last| last.rays);
        let alike = uncertainty::rays_alike(view.scan(), rays);
        let information = refinement.uncertainty().and_then(|known| known.information).unwrap_or_default() / alike;
        let information = uncertainty::turned(&information, earlier.map_from_laser.theta);
        Some(Sighting { by_path, by_earlier, agreement, information })
    }

    pub(super) fn recognise(&mut self, earlier: &Unrecognised, sighting: &Sighting) {
        self.counters.closed_loops += 1;
        let (map_from_laser, left) = sighting.weighed(&self.map.drift_covariance(earlier));
        self.map.link(earlier);
        self.map.correct(earlier, &map_from_laser);
        let correction = map_from_laser * sighting.by_path.inverse();
        if let Some(last) = &mut self.last {
            // On the map the pose is known from there on as the earlier keyframe's is, and as well as from there; in odom as it was.
            let odom_from_map = self.map_from_odom.inverse();
            let in_odom = uncertainty::compound(&odom_from_map, &self.drift_covariance, &last.map_from_base, &last.covariance);
            last.covariance = earlier.covariance + left;
            let way = odom_from_map.transform().rotate(last.map_from_base.translation());
            let drift = in_odom - uncertainty::turned(&last.covariance, odom_from_map.theta);
            self.drift_covariance = uncertainty::carried(&uncertainty::positive(&drift), -way);
            last.map_from_base = correction * last.map_from_base;
            last.map_from_laser = correction * last.map_from_laser;
        }
        self.map_from_odom = correction * self.map_from_odom;
    }
}
