//! How the stamps of scans go on: forward; back where a scan was late, where a clock has been set while the robot drives on, or where a
//! run starts again.

use super::Stamp;

/// A message so much older than the last one is not late, s.
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
    /// The second in order of an earlier time: somebody has set the clock, and the robot drives on.
    SetBack {
        /// When the last scan was taken, by the new time: about as long before the first scan of it as the second is after that one.
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
    /// The stamp of the scan before, where that was late.
    late: Option<Stamp>,
    /// When time went back in the odometry, whether its pose stayed where it was.
    drives_on: Option<bool>,
}

impl Continuity {
    /// Takes note that time has gone back in the odometry. `drives_on`: the robot is where it was.
    pub fn odometry_went_back(&mut self, drives_on: bool) {
        self.drives_on = Some(drives_on);
    }

    /// What `stamp` is to `last`, which is that of the scan used last. `odometry`: the stamp of the newest odometry.
    pub fn step(&mut self, stamp: Stamp, last: Stamp, odometry: Option<Stamp>) -> Step {
        let first = *self.first.get_or_insert(last);
        let seconds = stamp.seconds_since(last);
        if seconds > 0.0 {
            self.late = None;
            return Step::Forward;
        }
        if seconds < -LATEST && self.starts_again(stamp, first, odometry) {
            *self = Self::default();
            return Step::NewRun;
        }
        if let Some(late) = self.late.take_if(|late| stamp > *late) {
            let new_last = late.offset_by(late.seconds_since(stamp));
            *self = Self { first: Some(first.offset_by(new_last.seconds_since(last))), ..Self::default() };
            return Step::SetBack { last: new_last };
        }
        if seconds == 0.0 {
            return Step::Same;
        }
        self.late = Some(stamp);
        Step::Late
    }

    /// Odometry says it, or will do so soon. Without odometry the time does, which is that of the beginning.
    fn starts_again(&self, stamp: Stamp, first: Stamp, odometry: Option<Stamp>) -> bool {
        let may_yet_say = self.late.is_none() && odometry.is_some_and(|newest| stamp.seconds_since(newest) < -LATEST);
        !may_yet_say && self.drives_on.map_or(stamp.seconds_since(first) < BEGINNING, |drives_on| !drives_on)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(seconds: f64) -> Stamp {
        Stamp::from_seconds(seconds)
    }

    /// What becomes of scans of these stamps, s, after ten seconds at 10 Hz.
    fn steps(continuity: &mut Continuity, odometry: Option<f64>, stamps: &[f64]) -> Vec<Step> {
        let mut last = at(0.0);
        let mut take = |stamp: f64| {
            let step = continuity.step(at(stamp), last, odometry.map(at));
            match step {
                Step::Forward | Step::NewRun | Step::SetBack { .. } => last = at(stamp),
                Step::Same | Step::Late => {}
            }
            step
        };
        assert!((1..=100).all(|i| take(f64::from(i) * 0.1) == Step::Forward));
        stamps.iter().map(|&stamp| take(stamp)).collect()
    }

    #[test]
    fn one_scan_is_late_and_two_in_order_are_a_clock_that_was_set() {
        let alone = |stamps: &[f64]| steps(&mut Continuity::default(), None, stamps);
        assert_eq!(alone(&[9.9, 10.1, 10.1]), [Step::Late, Step::Forward, Step::Same]);
        for back in [0.3, 0.9, 1.5, 6.0] {
            let set_back = Step::SetBack { last: at(10.0 - back) };
            assert_eq!(alone(&[10.1 - back, 10.2 - back, 10.3 - back]), [Step::Late, set_back, Step::Forward], "{back} s");
        }
        assert_eq!(alone(&[5.0, 10.1]), [Step::Late, Step::Forward], "late by much");
    }

    #[test]
    fn a_run_that_starts_again_does_so_at_its_beginning() {
        assert_eq!(steps(&mut Continuity::default(), None, &[0.2, 0.3]), [Step::NewRun, Step::Forward]);
        let mut set_twice = Continuity::default();
        steps(&mut set_twice, None, &[7.1, 7.2]);
        assert_eq!(set_twice.step(at(-2.8), at(7.2), None), Step::NewRun, "by the new time it began at -3 s");
    }

    #[test]
    fn odometry_knows_better() {
        let mut drives_on = Continuity::default();
        drives_on.odometry_went_back(true);
        assert_eq!(steps(&mut drives_on, Some(0.1), &[0.2])[0], Step::Late);
        let mut is_put_back = Continuity::default();
        is_put_back.odometry_went_back(false);
        assert_eq!(steps(&mut is_put_back, Some(5.0), &[5.0])[0], Step::NewRun);
        // The odometry is still of the time before.
        let waits = steps(&mut Continuity::default(), Some(10.0), &[0.2, 0.3, 0.4]);
        assert_eq!(waits, [Step::Late, Step::NewRun, Step::Forward]);
    }
}
