//! Tracks the progress of the car along a path.
//!
//! Progress never decreases, and the projection is searched only in a short window ahead, on segments with about the heading of
//! the car. Crossings and hairpins therefore cannot cause a jump to another branch. A path that arrives while driving is joined
//! at the car's position. If several branches are close, the one whose remaining distance is most similar to that of the previous
//! path is chosen: paths with the same end share it.

use super::path::{Path, Projection, Waypoint};
use crate::geometry::Pose2;
use crate::time::Stamp;

/// Minimum length of the search window ahead, m: pose corrections up to this size are followed.
const MIN_WINDOW: f64 = 1.0;
/// Branches farther from the car than the nearest one by less than this are candidates, too, m: the size of pose errors.
const AMBIGUITY_MARGIN: f64 = 0.2;
/// Paths whose points differ by at most this are the same, m: rounding errors of single precision.
const SAME_POINT_TOLERANCE: f64 = 1e-3;

/// What happened to a received path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PathUpdate {
    /// It is followed from now on.
    Accepted,
    /// It equals the path that is followed already.
    Unchanged,
    /// It is older than the path that is followed; ignored.
    Outdated,
}

/// A path and the car's position on it.
#[derive(Clone, Debug)]
pub struct Progress {
    path: Path,
    stamp: Stamp,
    location: Location,
}

/// Where the car is on the path.
#[derive(Clone, Copy, Debug)]
enum Location {
    /// Not found yet.
    Unknown {
        /// Remaining distance on the previous path, m, if there was one.
        previous_remaining: Option<f64>,
    },
    Known {
        projection: Projection,
        /// Arc length at which the car joined the path, m.
        start: f64,
    },
}

impl Progress {
    /// A path on which the car has not been found yet.
    pub fn new(path: Path, stamp: Stamp) -> Self {
        Self { path, stamp, location: Location::Unknown { previous_remaining: None } }
    }

    /// The path followed.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Stamp of the path.
    pub fn stamp(&self) -> Stamp {
        self.stamp
    }

    /// Distance along the path since the car joined it, m.
    pub fn distance_driven(&self) -> f64 {
        match self.location {
            Location::Known { projection, start } => projection.along - start,
            Location::Unknown { .. } => 0.0,
        }
    }

    /// Handles a received path. An older path is ignored; the same path again only updates the stamp.
    pub fn update_path(&mut self, path: Path, stamp: Stamp) -> PathUpdate {
        if stamp < self.stamp {
            return PathUpdate::Outdated;
        }
        self.stamp = stamp;
        if is_same(&self.path, &path) {
            return PathUpdate::Unchanged;
        }
        if let Location::Known { projection, .. } = self.location {
            self.location = Location::Unknown { previous_remaining: Some(self.path.remaining(projection.along)) };
        }
        self.path = path;
        PathUpdate::Accepted
    }

    /// After a clock jump: limits the path's stamp to `now`, so that new paths are not taken for outdated.
    pub fn restamp(&mut self, now: Stamp) {
        self.stamp = self.stamp.min(now);
    }

    /// Updates the projection for the car at `pose`, which has moved at most `moved` m since the last update. `None` if no
    /// segment in reach has about the heading of the car.
    pub fn update(&mut self, pose: &Pose2, moved: f64) -> Option<Projection> {
        let (projection, start) = match self.location {
            Location::Known { projection: last, start } => {
                let ahead = last.along + (MIN_WINDOW + 2.0 * moved);
                let end = if self.path.is_closed() { ahead } else { ahead.min(self.path.length()) };
                (self.path.project(pose, last.along, end)?, start)
            }
            Location::Unknown { previous_remaining } => {
                let found = self.find(pose, previous_remaining)?;
                (found, found.along)
            }
        };
        self.location = Location::Known { projection, start };
        Some(projection)
    }

    /// Forgets where the car was, for example after it was picked up and moved.
    pub fn reset(&mut self) {
        self.location = Location::Unknown { previous_remaining: None };
    }

    /// Searches the whole path for the car.
    fn find(&self, pose: &Pose2, previous_remaining: Option<f64>) -> Option<Projection> {
        let end = if self.path.is_closed() { self.path.length().next_down() } else { self.path.length() };
        let nearest = self.path.project(pose, 0.0, end)?;
        let is_candidate = |candidate: &Projection| candidate.distance <= nearest.distance + AMBIGUITY_MARGIN;
        // The nearest point of each branch that the car may be on. On the first path, and on closed ones, the first branch is
        // chosen.
        let mut candidates = branches(self.path.candidates(pose, 0.0, end).filter(is_candidate)).into_iter();
        let chosen = match previous_remaining.filter(|remaining| remaining.is_finite() && !self.path.is_closed()) {
            Some(previous) => {
                let difference = |candidate: &Projection| (self.path.remaining(candidate.along) - previous).abs();
                candidates.min_by(|a, b| difference(a).total_cmp(&difference(b)))
            }
            None => candidates.next(),
        };
        Some(chosen.unwrap_or(nearest))
    }
}

/// Groups projections that follow each other closely into branches, and returns the nearest one of each.
fn branches(projections: impl Iterator<Item = Projection>) -> Vec<Projection> {
    let mut branches: Vec<Projection> = Vec::new();
    let mut end = f64::NEG_INFINITY;
    for projection in projections {
        match branches.last_mut() {
            Some(last) if projection.along - end < MIN_WINDOW => {
                if projection.distance < last.distance {
                    *last = projection;
                }
            }
            _ => branches.push(projection),
        }
        end = projection.along;
    }
    branches
}

fn is_same(a: &Path, b: &Path) -> bool {
    let near = |(a, b): (&Waypoint, &Waypoint)| {
        (a.point - b.point).norm() <= SAME_POINT_TOLERANCE && a.speed.unwrap_or(0.0).to_bits() == b.speed.unwrap_or(0.0).to_bits()
    };
    a.is_closed() == b.is_closed()
        && a.waypoints().len() == b.waypoints().len()
        && a.waypoints().iter().zip(b.waypoints()).all(near)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::path::tests::waypoints;

    fn path(points: &[(f64, f64)]) -> Path {
        Path::new(&waypoints(points), false).unwrap()
    }

    fn stamp(seconds: f64) -> Stamp {
        Stamp::from_seconds(seconds)
    }

    fn line(length: u32, y: f64) -> Path {
        path(&(0..=length).map(|i| (f64::from(i), y)).collect::<Vec<_>>())
    }

    #[test]
    fn the_same_path_again_changes_nothing_and_an_older_one_is_ignored() {
        let mut progress = Progress::new(line(10, 0.0), stamp(1.0));
        let projection = progress.update(&Pose2::new(4.0, 0.1, 0.0), 0.1).unwrap();
        assert_eq!(
            (progress.update_path(line(10, 0.0), stamp(2.0)), progress.update(&Pose2::new(4.0, 0.1, 0.0), 0.1)),
            (PathUpdate::Unchanged, Some(projection))
        );
        assert_eq!(progress.update_path(line(20, 0.0), stamp(1.5)), PathUpdate::Outdated, "the newest of reordered paths counts");
        assert_eq!(progress.update_path(line(20, 0.0), stamp(2.5)), PathUpdate::Accepted);
        assert!((progress.update(&Pose2::new(4.1, 0.1, 0.0), 0.1).unwrap().along - 4.1).abs() < 1e-9);
    }

    #[test]
    fn a_late_path_is_joined_at_the_car() {
        let mut progress = Progress::new(line(30, 0.0), stamp(0.0));
        progress.update(&Pose2::new(12.0, 0.0, 0.0), 0.1);
        let late = path(&(0..40).map(|i| (f64::from(i) * 0.5 + 2.0, 0.02)).collect::<Vec<_>>());
        progress.update_path(late, stamp(1.0));
        let projection = progress.update(&Pose2::new(12.1, 0.0, 0.0), 0.1).unwrap();
        assert!((projection.along - 10.1).abs() < 1e-9 && (projection.lateral_error + 0.02).abs() < 1e-9, "{projection:?}");
        assert!(progress.distance_driven().abs() < 1e-9);
    }

    #[test]
    fn progress_never_decreases() {
        let mut progress = Progress::new(line(10, 0.0), stamp(0.0));
        progress.update(&Pose2::new(5.0, 0.0, 0.0), 0.1);
        assert!((progress.update(&Pose2::new(4.0, 0.0, 0.0), 0.1).unwrap().along - 5.0).abs() < 1e-9);
    }

    #[test]
    fn hairpins_and_crossings_cause_no_jump_to_another_branch() {
        // Out and back, 0.4 m apart: close to the hairpin the returning branch is as near.
        let hairpin = path(&[(0.0, 0.0), (10.0, 0.0), (10.3, 0.2), (10.0, 0.4), (0.0, 0.4)]);
        let mut progress = Progress::new(hairpin, stamp(0.0));
        for i in 0..100 {
            let x = 0.1 * f64::from(i);
            let projection = progress.update(&Pose2::new(x, 0.25, 0.1), 0.1).unwrap();
            assert!((projection.along - x).abs() < 1e-9, "at {x}: {projection:?}");
        }
        // A figure of eight: at its crossing the other branch is as near, and its heading is similar enough to count.
        let eight: Vec<_> = (0..=200)
            .map(|i| f64::from(i) * std::f64::consts::TAU / 200.0)
            .map(|t| (4.0 * t.sin(), 2.0 * (2.0 * t).sin()))
            .collect();
        let mut progress = Progress::new(path(&eight), stamp(0.0));
        let whole = progress.path().clone();
        let mut along = 0.0;
        while along < whole.length() {
            let pose = whole.pose(along) * Pose2::new(0.0, 0.05, 0.05);
            let projection = progress.update(&pose, 0.05).unwrap();
            assert!((projection.along - along).abs() < 0.15, "at {along}: {projection:?}");
            along += 0.05;
        }
    }

    /// A path of two laps around a square, displaced by `shift`.
    fn two_laps(shift: f64) -> Path {
        let lap = [(0.0, 0.0), (5.0, 0.0), (5.0, 5.0), (0.0, 5.0)];
        path(&lap.iter().chain(&lap).map(|(x, y)| (x + shift, y + shift)).collect::<Vec<_>>())
    }

    #[test]
    fn a_car_that_was_moved_is_searched_for_as_on_a_new_path() {
        let mut progress = Progress::new(two_laps(0.0), stamp(0.0));
        let pose = progress.path().pose(7.9);
        let along = progress.update(&pose, 0.1).unwrap().along;
        progress.reset();
        assert_eq!(progress.update(&pose, 0.1).unwrap().along.to_bits(), along.to_bits(), "in the first lap again");
    }

    #[test]
    fn a_replanned_path_of_two_laps_is_joined_in_the_current_lap() {
        let mut progress = Progress::new(two_laps(0.0), stamp(0.0));
        let drive: Vec<_> = (0..280).map(|i| progress.path().pose(0.1 * f64::from(i))).collect();
        let before = drive.iter().fold(0.0, |_, pose| progress.update(pose, 0.1).unwrap().along);
        assert!((before - 27.9).abs() < 0.2, "{before}");
        progress.update_path(two_laps(0.01), stamp(1.0));
        let after = progress.update(&drive[279], 0.1).unwrap().along;
        assert!((after - before).abs() < 0.1, "{before} {after}");
    }
}
