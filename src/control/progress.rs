//! How far along a path the car is.
//!
//! Progress never goes back, and looks for the car only a little ahead, where the path goes the car's way: so crossings and hairpins do
//! not swap branches. A path that comes while driving is taken up where the car is; which branch it is on, if it may be on several, the
//! way left to go tells, which a path with the same end shares with the one before.

use super::path::{Path, Projection};
use crate::geometry::Pose2;
use crate::time::Stamp;

/// The car is looked for so far ahead at least, m: a pose that was corrected by as much still finds its place.
const LEAST_WINDOW: f64 = 1.0;
/// Places that are farther from the car than the nearest by less than this are as good, m: as far as poses err.
const AS_NEAR: f64 = 0.2;
/// A path whose points are no farther than this from those of the one before is the same, m: as far as single precision rounds.
const SAME: f64 = 1e-3;

/// What became of a path that came.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Arrival {
    /// It is followed from now on.
    Taken,
    /// It is the one that is followed already.
    Same,
    /// It is older than the one that is followed.
    Older,
}

/// A path and the car's place on it.
#[derive(Clone, Debug)]
pub struct Progress {
    path: Path,
    stamp: Stamp,
    place: Option<Projection>,
    /// Arc length at which the path was taken up, m.
    begun: f64,
}

impl Progress {
    /// On a path on which the car has no place yet.
    pub fn new(path: Path, stamp: Stamp) -> Self {
        Self { path, stamp, place: None, begun: f64::NAN }
    }

    /// The path followed.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Its stamp.
    pub fn stamp(&self) -> Stamp {
        self.stamp
    }

    /// The car's place on it, as of the last look.
    pub fn place(&self) -> Option<Projection> {
        self.place
    }

    /// Way along the path since it was taken up, m.
    pub fn driven(&self) -> f64 {
        self.place.map_or(0.0, |place| place.along - self.begun)
    }

    /// A path comes. The same path again, however new its stamp, changes nothing; nor does one that is older.
    pub fn offer(&mut self, path: Path, stamp: Stamp) -> Arrival {
        if stamp < self.stamp {
            return Arrival::Older;
        }
        self.stamp = stamp;
        if is_same(&self.path, &path) {
            return Arrival::Same;
        }
        let before = self.place.map(|place| self.path.remaining(place.along));
        self.path = path;
        self.place = self.place.map(|place| Projection { along: f64::NAN, ..place });
        self.begun = before.unwrap_or(f64::NAN);
        Arrival::Taken
    }

    /// The clock has jumped: stamps of before say nothing.
    pub fn restamp(&mut self, now: Stamp) {
        self.stamp = self.stamp.min(now);
    }

    /// The car is at `pose`, and has come `moved` m at most since the last look. `None`: nowhere does the path go the way that the car looks.
    pub fn look(&mut self, pose: &Pose2, moved: f64) -> Option<Projection> {
        let found = match self.place.filter(|place| place.along.is_finite()) {
            Some(place) => {
                let ahead = LEAST_WINDOW + 2.0 * moved;
                self.path.project(pose, place.along, (place.along + ahead).min(self.end(place.along + ahead)))
            }
            None => self.find(pose),
        }?;
        self.place = Some(found);
        Some(found)
    }

    /// Forgets where the car was: it has been put somewhere else.
    pub fn forget(&mut self) {
        self.place = None;
    }

    fn end(&self, of_closed: f64) -> f64 {
        if self.path.is_closed() { of_closed } else { self.path.length() }
    }

    /// Looks for the car on the whole path.
    fn find(&mut self, pose: &Pose2) -> Option<Projection> {
        let end = if self.path.is_closed() { self.path.length().next_down() } else { self.path.length() };
        let nearest = self.path.project(pose, 0.0, end)?;
        let wanted = self.begun;
        let apart = |place: &Projection| (self.path.remaining(place.along) - wanted).abs();
        let is_rival = |place: &Projection| place.distance <= nearest.distance + AS_NEAR;
        // Of each branch that the car may be on, the nearest place. Of the first path of all, or a closed one, the first of them.
        let mut rivals = branches(self.path.candidates(pose, 0.0, end).filter(is_rival)).into_iter();
        let found = if wanted.is_finite() && !self.path.is_closed() {
            rivals.min_by(|a, b| apart(a).total_cmp(&apart(b)))
        } else {
            rivals.next()
        };
        let found = found.unwrap_or(nearest);
        self.begun = found.along;
        Some(found)
    }
}

/// The nearest place of each run of places that follow each other closely.
fn branches(places: impl Iterator<Item = Projection>) -> Vec<Projection> {
    let mut branches: Vec<Projection> = Vec::new();
    let mut end = f64::NEG_INFINITY;
    for place in places {
        match branches.last_mut() {
            Some(last) if place.along - end < LEAST_WINDOW => {
                if place.distance < last.distance {
                    *last = place;
                }
            }
            _ => branches.push(place),
        }
        end = place.along;
    }
    branches
}

fn is_same(a: &Path, b: &Path) -> bool {
    let near = |(a, b): (&super::path::Waypoint, &super::path::Waypoint)| {
        (a.point - b.point).norm() <= SAME && a.speed.unwrap_or(0.0).to_bits() == b.speed.unwrap_or(0.0).to_bits()
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
        let place = progress.look(&Pose2::new(4.0, 0.1, 0.0), 0.1).unwrap();
        assert_eq!((progress.offer(line(10, 0.0), stamp(2.0)), progress.place()), (Arrival::Same, Some(place)));
        assert_eq!(progress.offer(line(20, 0.0), stamp(1.5)), Arrival::Older, "of shuffled ones the newest counts");
        assert_eq!(progress.offer(line(20, 0.0), stamp(2.5)), Arrival::Taken);
        assert!((progress.look(&Pose2::new(4.1, 0.1, 0.0), 0.1).unwrap().along - 4.1).abs() < 1e-9);
    }

    #[test]
    fn waypoints_behind_a_late_path_are_dropped() {
        let mut progress = Progress::new(line(30, 0.0), stamp(0.0));
        progress.look(&Pose2::new(12.0, 0.0, 0.0), 0.1);
        let late = path(&(0..40).map(|i| (f64::from(i) * 0.5 + 2.0, 0.02)).collect::<Vec<_>>());
        progress.offer(late, stamp(1.0));
        let place = progress.look(&Pose2::new(12.1, 0.0, 0.0), 0.1).unwrap();
        assert!((place.along - 10.1).abs() < 1e-9 && (place.lateral_error + 0.02).abs() < 1e-9, "{place:?}");
        assert!(progress.driven().abs() < 1e-9);
    }

    #[test]
    fn progress_never_goes_back() {
        let mut progress = Progress::new(line(10, 0.0), stamp(0.0));
        progress.look(&Pose2::new(5.0, 0.0, 0.0), 0.1);
        assert!((progress.look(&Pose2::new(4.0, 0.0, 0.0), 0.1).unwrap().along - 5.0).abs() < 1e-9);
    }

    #[test]
    fn hairpins_and_crossings_do_not_swap_branches() {
        // There and back, 0.4 m apart: right before the turn the way back is as near.
        let hairpin = path(&[(0.0, 0.0), (10.0, 0.0), (10.3, 0.2), (10.0, 0.4), (0.0, 0.4)]);
        let mut progress = Progress::new(hairpin, stamp(0.0));
        for i in 0..100 {
            let x = 0.1 * f64::from(i);
            let place = progress.look(&Pose2::new(x, 0.25, 0.1), 0.1).unwrap();
            assert!((place.along - x).abs() < 1e-9, "at {x}: {place:?}");
        }
        // A figure of eight: at its crossing the other branch is as near, and goes the car's way by half.
        let eight: Vec<_> = (0..=200)
            .map(|i| f64::from(i) * std::f64::consts::TAU / 200.0)
            .map(|t| (4.0 * t.sin(), 2.0 * (2.0 * t).sin()))
            .collect();
        let mut progress = Progress::new(path(&eight), stamp(0.0));
        let whole = progress.path().clone();
        let mut along = 0.0;
        while along < whole.length() {
            let pose = whole.pose(along) * Pose2::new(0.0, 0.05, 0.05);
            let place = progress.look(&pose, 0.05).unwrap();
            assert!((place.along - along).abs() < 0.15, "at {along}: {place:?}");
            along += 0.05;
        }
    }

    #[test]
    fn a_replanned_path_with_two_laps_goes_on_with_the_lap_it_is_in() {
        let lap = [(0.0, 0.0), (5.0, 0.0), (5.0, 5.0), (0.0, 5.0)];
        let twice = |shift: f64| path(&lap.iter().chain(&lap).map(|(x, y)| (x + shift, y + shift)).collect::<Vec<_>>());
        let mut progress = Progress::new(twice(0.0), stamp(0.0));
        let drive: Vec<_> = (0..280).map(|i| progress.path().pose(0.1 * f64::from(i))).collect();
        for pose in &drive {
            progress.look(pose, 0.1);
        }
        let before = progress.place().unwrap().along;
        assert!((before - 27.9).abs() < 0.2, "{before}");
        progress.offer(twice(0.01), stamp(1.0));
        let after = progress.look(&drive[279], 0.1).unwrap().along;
        assert!((after - before).abs() < 0.1, "{before} {after}");
    }
}
