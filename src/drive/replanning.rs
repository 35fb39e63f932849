//! A planner whose paths come late: again and again the way ahead, from where the car was when it began to think.

use crate::control::path::{Path, Waypoint};
use crate::control::progress::{Arrival, Progress};
use crate::geometry::Pose2;
use crate::simulation::drive::START;

/// Distance between the points of its paths, m.
const SPACING: f64 = 0.1;

/// How it plans.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Replanning {
    /// Paths per second.
    pub rate: f64,
    /// From the pose that a path begins at to the path, s.
    pub delay: f64,
    /// Length of a path, m.
    pub horizon: f64,
}

/// The paths that are on their way.
pub(super) struct Planner<'a> {
    how: Replanning,
    whole: &'a Path,
    progress: Progress,
    waiting: Vec<(u64, u64, Path)>,
}

impl<'a> Planner<'a> {
    pub(super) fn new(how: Replanning, whole: &'a Path) -> Self {
        Self { how, whole, progress: Progress::new(whole.clone(), START), waiting: Vec::new() }
    }

    /// The way ahead of `pose`.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a length in steps
    pub(super) fn plan(&mut self, pose: &Pose2) -> Option<Path> {
        let begin = self.progress.look(pose, 1.0)?.along;
        let points = (0..=(self.how.horizon / SPACING) as usize)
            .map(|step| Waypoint { point: self.whole.point(begin + step as f64 * SPACING), speed: None });
        Path::new(&points.collect::<Vec<_>>(), false).ok()
    }

    /// The car is at `pose`, `now` ms after the start. The path that comes now, and when it was planned.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // milliseconds
    pub(super) fn tick(&mut self, now: u64, pose: &Pose2) -> Option<(Path, u64)> {
        let period = (1000.0 / self.how.rate).round().max(1.0) as u64;
        if now.is_multiple_of(period)
            && let Some(path) = self.plan(pose)
        {
            self.waiting.push((now + (1000.0 * self.how.delay) as u64, now, path));
        }
        let due = self.waiting.iter().position(|(due, ..)| *due <= now)?;
        let (_, planned, path) = self.waiting.remove(due);
        Some((path, planned))
    }
}

/// How far the followed line moves aside where the car is, when another path comes, m.
pub(super) fn step_aside(before: Option<f64>, arrival: Arrival, after: Option<f64>) -> f64 {
    match (before, arrival, after) {
        (Some(before), Arrival::Taken, Some(after)) => (after - before).abs(),
        _ => 0.0,
    }
}
