//! A planner with delay: it periodically publishes the path ahead, starting where the car was when planning began.

use crate::control::path::{Path, Waypoint};
use crate::control::progress::{PathUpdate, Progress};
use crate::geometry::Pose2;
use crate::simulation::drive::START;

/// Distance between the points of the published paths, m.
const SPACING: f64 = 0.1;

/// Settings of the planner.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Replanning {
    /// Rate of new paths, Hz.
    pub rate: f64,
    /// Time from the pose that a path starts at to its publication, s.
    pub delay: f64,
    /// Length of a path, m.
    pub horizon: f64,
}

/// A planner whose paths arrive with a delay.
pub(super) struct Planner<'a> {
    settings: Replanning,
    full_path: &'a Path,
    progress: Progress,
    /// Paths not published yet: time of publication, time of planning, both in ms, and the path.
    pending: Vec<(u64, u64, Path)>,
}

impl<'a> Planner<'a> {
    pub(super) fn new(settings: Replanning, full_path: &'a Path) -> Self {
        Self { settings, full_path, progress: Progress::new(full_path.clone(), START), pending: Vec::new() }
    }

    /// Plans the path ahead of `pose`.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a length in steps
    pub(super) fn plan(&mut self, pose: &Pose2) -> Option<Path> {
        let begin = self.progress.update(pose, 1.0)?.along;
        let points = (0..=(self.settings.horizon / SPACING) as usize)
            .map(|step| Waypoint { point: self.full_path.point(begin + step as f64 * SPACING), speed: None });
        Path::new(&points.collect::<Vec<_>>(), false).ok()
    }

    /// Advances to `now`, ms after the start, with the car at `pose`. Returns a path that is published now, and when it was
    /// planned.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // milliseconds
    pub(super) fn tick(&mut self, now: u64, pose: &Pose2) -> Option<(Path, u64)> {
        let period = (1000.0 / self.settings.rate).round().max(1.0) as u64;
        if now.is_multiple_of(period)
            && let Some(path) = self.plan(pose)
        {
            self.pending.push((now + (1000.0 * self.settings.delay) as u64, now, path));
        }
        let due = self.pending.iter().position(|(due, ..)| *due <= now)?;
        let (_, planned, path) = self.pending.remove(due);
        Some((path, planned))
    }
}

/// Lateral jump of the followed line at the car when a new path is accepted, m, from the lateral errors before and after.
pub(super) fn line_jump(before: Option<f64>, update: PathUpdate, after: Option<f64>) -> f64 {
    match (before, update, after) {
        (Some(before), PathUpdate::Accepted, Some(after)) => (after - before).abs(),
        _ => 0.0,
    }
}
