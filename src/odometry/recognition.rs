//! Loop closure: matches the latest keyframe to previously visited places and corrects the map.

use super::local_map::Keyframe;
use super::loop_closure::{self, LoopMeasurement};
use super::{LaserOdometry, uncertainty};
use crate::anytime::ContractRunner;
use crate::geometry::PoseCovariance;
use crate::matching::{FirstGuess, StopReason};

impl LaserOdometry {
    /// Matches the latest keyframe to earlier keyframes nearby, unless that has been done, and corrects the map by an accepted
    /// loop closure. Later scans benefit from it, but need not wait for it.
    pub fn close_loop(&mut self, runner: &mut ContractRunner) {
        if !std::mem::take(&mut self.loop_check_pending) {
            return;
        }
        let Some(candidate) = self.loop_candidate() else { return self.loop_verifier.reset() };
        let drift = self.map.drift_covariance(&candidate);
        match self.measure_loop(&candidate, &drift, runner) {
            // Try again when there is more time.
            None => self.loop_check_pending = true,
            Some(measurement) if self.loop_verifier.accepts(&measurement) => {
                self.apply_loop_closure(&candidate, &measurement, &drift);
            }
            Some(_) => {}
        }
        self.select_views();
    }

    /// The earlier keyframes to match the latest one to, as `views`; `None` while scans are matched to earlier keyframes anyway.
    fn loop_candidate(&mut self) -> Option<Keyframe> {
        let latest = self.map.last().filter(|_| self.map.is_exploring())?;
        self.map.loop_candidate(&latest.pose.map_from_laser, self.knobs.views as usize, &mut self.views)
    }

    /// Matches the latest keyframe to `views`, the first of which is `candidate`; `None` if there was no time for it. `drift`:
    /// covariance of the path's pose relative to the candidate.
    fn measure_loop(
        &mut self,
        candidate: &Keyframe,
        drift: &PoseCovariance,
        runner: &mut ContractRunner,
    ) -> Option<LoopMeasurement> {
        let latest = self.map.last()?;
        let (scan, path_pose) = (latest.view.scan(), latest.pose.map_from_laser);
        let map_from_candidate = candidate.pose.map_from_laser;
        self.matcher.set_views(&self.views);
        let pose = map_from_candidate.between(&path_pose);
        let guess = FirstGuess { pose, prior: None, window: loop_closure::window(drift) };
        let mut refinement = self.matcher.begin(scan, guess);
        if runner.run(&mut refinement) == StopReason::Interrupted {
            return None;
        }
        let measured_pose = map_from_candidate * refinement.pose();
        let agreement = refinement.agreement().unwrap_or_default();
        let rays = refinement.trace().last().map_or(0, |last| last.rays);
        let correlated = uncertainty::correlated_rays(scan, rays);
        let information = refinement.uncertainty().and_then(|known| known.information).unwrap_or_default() / correlated;
        let information = uncertainty::rotated(&information, map_from_candidate.theta);
        Some(LoopMeasurement { path_pose, measured_pose, agreement, information })
    }

    /// Applies an accepted loop closure: links the keyframes, and corrects the path, the pose and their covariances.
    fn apply_loop_closure(&mut self, candidate: &Keyframe, measurement: &LoopMeasurement, drift: &PoseCovariance) {
        self.counters.closed_loops += 1;
        let (map_from_laser, remaining) = measurement.fused(drift);
        self.map.link(candidate);
        self.map.correct(candidate, &map_from_laser);
        let correction = map_from_laser * measurement.path_pose.inverse();
        if let Some(previous) = &mut self.previous {
            // On the map the uncertainty is now that of the earlier keyframe plus the remaining one relative to it; in odom it
            // does not change.
            let odom_from_map = self.map_from_odom.inverse();
            let before = previous.total_covariance();
            let in_odom = uncertainty::compound(&odom_from_map, &self.drift_covariance, &previous.map_from_base, &before);
            previous.covariance = candidate.pose.covariance + remaining;
            let map_from_base = correction * previous.map_from_base;
            previous.by_scale =
                candidate.pose.by_scale.at(map_from_base.translation() - candidate.pose.map_from_laser.translation());
            let offset = odom_from_map.transform().rotate(previous.map_from_base.translation());
            let drift = in_odom - uncertainty::rotated(&previous.total_covariance(), odom_from_map.theta);
            self.drift_covariance = uncertainty::propagated(&uncertainty::positive_part(&drift), -offset);
            previous.map_from_base = map_from_base;
            previous.map_from_laser = correction * previous.map_from_laser;
        }
        self.recent_path.correct(&correction);
        self.map_from_odom = correction * self.map_from_odom;
    }
}
