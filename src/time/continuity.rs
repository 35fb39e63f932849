//! How the stamps of scans go on: forward; back where a scan was late, where a clock has been set while the robot drives on, or where a
//! run starts again.

use super::Stamp;

/// Scans that are late go on being so for less than this, s.
const LATEST: f64 = 1.0;
/// A run that starts again begins where it began, give or take the messages that were lost there, s.
const BEGINNING: f64 = 0.5;

/// What a stamp is to the one before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    /// Later.
    Forward,
    /// The same.
    Same,
    /// Earlier: a scan out of order, unless the next one goes on from there.
    Late,
    /// One of several in order, all of an earlier time: somebody has set the clock, and the robot drives on.
    SetBack {
        /// When the last scan was taken, by the new time: as long before the first scan of it as they are apart.
        last: Stamp,
    },
    /// The first of a run that starts again, as a bag played in a loop does.
    NewRun,
}

/// The stamps of a run.
#[derive(Clone, Copy, Debug, Default)]
pub struct Continuity {
    /// When the run began.
    first: Option<Stamp>,
    late: Option<LateScans>,
    /// When time went back in the odometry, whether its pose stayed where it was.
    drives_on: Option<bool>,
}

/// Scans in order, each from before the scan used last.
#[derive(Clone, Copy, Debug)]
struct LateScans {
    first: Stamp,
    newest: Stamp,
    /// How many came after the first.
    more: u32,
}

impl LateScans {
    /// With one more; alone, where that is from before the others.
    fn and(self, stamp: Stamp) -> Self {
        if stamp > self.newest { Self { newest: stamp, more: self.more + 1, ..self } } else { Self::of(stamp) }
    }

    fn of(stamp: Stamp) -> Self {
        Self { first: stamp, newest: stamp, more: 0 }
    }

    fn seconds(self) -> f64 {
        self.newest.seconds_since(self.first)
    }
}

impl Continuity {
    /// Takes note that time has gone back in the odometry. `drives_on`: the robot is where it was.
    pub fn odometry_went_back(&mut self, drives_on: bool) {
        self.drives_on = Some(drives_on);
    }

    /// What `stamp` is to `last`, which is that of the scan used last. `odometry`: the stamp of the newest odometry.
    pub fn step(&mut self, stamp: Stamp, last: Stamp, odometry: Option<Stamp>) -> Step {
        let first = *self.first.get_or_insert(last);
        let back = last.seconds_since(stamp);
        if back < 0.0 {
            (self.late, self.drives_on) = (None, None);
            return Step::Forward;
        }
        if back == 0.0 {
            return Step::Same;
        }
        let late = self.late.map_or_else(|| LateScans::of(stamp), |late| late.and(stamp));
        self.late = Some(late);
        // Odometry that is still of the time before knows of no other; in the end the scans must go on all the same.
        let odometry_goes_on =
            self.drives_on.is_none() && odometry.is_some_and(|newest| newest.seconds_since(stamp) > 0.5 * back);
        if odometry_goes_on && late.seconds() < LATEST {
            return Step::Late;
        }
        if back > LATEST && self.starts_again(late, first) {
            *self = Self::default();
            return Step::NewRun;
        }
        if late.more == 0 {
            return Step::Late;
        }
        let new_last = late.first.offset_by(-late.seconds() / f64::from(late.more));
        *self = Self { first: Some(first.offset_by(new_last.seconds_since(last))), ..Self::default() };
        Step::SetBack { last: new_last }
    }

    /// Odometry says it. Without, the time does: it is that of the beginning, or that of simulations which begin at zero.
    fn starts_again(&self, late: LateScans, first: Stamp) -> bool {
        let since_beginning = late.newest.seconds_since(first);
        let by_time = since_beginning.abs() < BEGINNING || (since_beginning < 0.0 && late.more > 0);
        self.drives_on.map_or(by_time, |drives_on| !drives_on)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(seconds: f64) -> Stamp {
        Stamp::from_seconds(seconds)
    }

    /// What becomes of scans of these stamps, s, after ten seconds at 10 Hz. `went_back`: what odometry says when time goes back in it.
    fn steps(continuity: &mut Continuity, went_back: Option<bool>, odometry: Option<f64>, stamps: &[f64]) -> Vec<Step> {
        let mut last = at(0.0);
        let mut take = |continuity: &mut Continuity, stamp: f64| {
            let step = continuity.step(at(stamp), last, odometry.map(at));
            match step {
                Step::Forward | Step::NewRun | Step::SetBack { .. } => last = at(stamp),
                Step::Same | Step::Late => {}
            }
            step
        };
        assert!((1..=100).all(|i| take(continuity, f64::from(i) * 0.1) == Step::Forward));
        if let Some(drives_on) = went_back {
            continuity.odometry_went_back(drives_on);
        }
        stamps.iter().map(|&stamp| take(continuity, stamp)).collect()
    }

    fn alone(stamps: &[f64]) -> Vec<Step> {
        steps(&mut Continuity::default(), None, None, stamps)
    }

    #[test]
    fn one_scan_is_late_and_two_in_order_are_a_clock_that_was_set() {
        assert_eq!(alone(&[9.9, 10.1, 10.1]), [Step::Late, Step::Forward, Step::Same]);
        for back in [0.3, 0.9, 1.5, 6.0] {
            let set_back = Step::SetBack { last: at(10.0 - back) };
            assert_eq!(alone(&[10.1 - back, 10.2 - back, 10.3 - back]), [Step::Late, set_back, Step::Forward], "{back} s");
        }
        assert_eq!(alone(&[5.0, 10.1]), [Step::Late, Step::Forward], "late by much");
    }

    #[test]
    fn a_run_that_starts_again_does_so_at_its_beginning() {
        assert_eq!(alone(&[0.2, 0.3]), [Step::NewRun, Step::Forward]);
        assert_eq!(alone(&[-50.0, -49.9]), [Step::Late, Step::NewRun], "a simulation anew");
        assert_eq!(alone(&[-50.0, 10.1]), [Step::Late, Step::Forward], "a stamp of nothing");
        let mut set_twice = Continuity::default();
        steps(&mut set_twice, None, None, &[7.1, 7.2]);
        assert_eq!(set_twice.step(at(-2.9), at(7.2), None), Step::NewRun, "by the new time it began at -3 s");
    }

    #[test]
    fn odometry_knows_better() {
        let told = |drives_on, stamps| steps(&mut Continuity::default(), Some(drives_on), Some(0.1), stamps);
        assert_eq!(told(true, &[0.2, 0.3]), [Step::Late, Step::SetBack { last: at(0.1) }]);
        assert_eq!(told(false, &[5.0]), [Step::NewRun]);
        // The odometry is of the time before: scans are late, in whatever order and number, but not for ever.
        let untold = |stamps: &[f64]| steps(&mut Continuity::default(), None, Some(10.0), stamps);
        let late = untold(&[9.4, 9.5, 0.0, 0.1, 10.1]);
        assert_eq!(late, [Step::Late, Step::Late, Step::Late, Step::Late, Step::Forward]);
        let waited = untold(&(0..14).map(|i| 5.0 + f64::from(i) * 0.1).collect::<Vec<_>>());
        assert!(waited.iter().filter(|step| matches!(step, Step::SetBack { .. })).count() == 1, "{waited:?}");
    }
}
