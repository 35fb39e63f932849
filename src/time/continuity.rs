//! Continuity of scan stamps. Normally stamps increase. They go back if a scan arrives out of order, if the clock was set back
//! while the robot drives on, or if a new run starts, such as a bag played in a loop.

use super::Stamp;

/// Out-of-order scans keep arriving for less than this, and a new run starts more than this before the last scan, s.
const MAX_LATENESS: f64 = 1.0;
/// A new run starts within this time of the start of the previous run, s; messages may have been lost there.
const MAX_START_OFFSET: f64 = 0.5;

/// How a stamp follows the previous one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    /// Later than the previous stamp.
    Forward,
    /// Equal to the previous stamp.
    Same,
    /// Earlier: a scan out of order, unless the next scan continues from there.
    Late,
    /// One of several scans in order with earlier stamps: the clock has been set back, and the robot drives on.
    SetBack {
        /// Stamp of the last scan by the new clock, extrapolated back from the first scans by that clock.
        last: Stamp,
    },
    /// First scan of a new run, for example of a bag played in a loop.
    NewRun,
}

/// Checks the continuity of the stamps of a run.
#[derive(Clone, Copy, Debug, Default)]
pub struct Continuity {
    /// Stamp of the start of the run.
    first: Option<Stamp>,
    /// Scans since the stamps went back.
    late: Option<LateScans>,
    /// Set when the stamps of the odometry went back: whether its pose remained continuous.
    drives_on: Option<bool>,
}

/// Scans in order, each with a stamp before that of the last scan used.
#[derive(Clone, Copy, Debug)]
struct LateScans {
    first: Stamp,
    newest: Stamp,
    /// Number of scans after the first.
    count_after_first: u32,
}

impl LateScans {
    /// Adds a scan, or restarts with it if its stamp is before that of the newest.
    fn with(self, stamp: Stamp) -> Self {
        if stamp > self.newest {
            Self { newest: stamp, count_after_first: self.count_after_first + 1, ..self }
        } else {
            Self::starting_at(stamp)
        }
    }

    fn starting_at(stamp: Stamp) -> Self {
        Self { first: stamp, newest: stamp, count_after_first: 0 }
    }

    fn seconds(self) -> f64 {
        self.newest.seconds_since(self.first)
    }
}

impl Continuity {
    /// Records that the stamps of the odometry have gone back. `drives_on`: the pose of the odometry remained continuous.
    pub fn odometry_went_back(&mut self, drives_on: bool) {
        self.drives_on = Some(drives_on);
    }

    /// Classifies `stamp`. `last`: stamp of the last scan used; `odometry`: stamp of the newest odometry.
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
        let late = self.late.map_or_else(|| LateScans::starting_at(stamp), |late| late.with(stamp));
        self.late = Some(late);
        // Odometry that still has the old time knows nothing of a new clock. After some time, the scans must be used all the
        // same.
        let odometry_has_old_time =
            self.drives_on.is_none() && odometry.is_some_and(|newest| newest.seconds_since(stamp) > 0.5 * back);
        if odometry_has_old_time && late.seconds() < MAX_LATENESS {
            return Step::Late;
        }
        if back > MAX_LATENESS && self.is_new_run(late, first) {
            *self = Self::default();
            return Step::NewRun;
        }
        if late.count_after_first == 0 {
            return Step::Late;
        }
        let new_last = late.first.offset_by(-late.seconds() / f64::from(late.count_after_first));
        *self = Self { first: Some(first.offset_by(new_last.seconds_since(last))), ..Self::default() };
        Step::SetBack { last: new_last }
    }

    /// Whether a new run has started. If the stamps of the odometry have gone back, its pose decides. Otherwise the stamps
    /// decide: they are near the start of the run, or before it, as in simulations whose clocks start at zero.
    fn is_new_run(&self, late: LateScans, first: Stamp) -> bool {
        let since_start = late.newest.seconds_since(first);
        let by_time = since_start.abs() < MAX_START_OFFSET || (since_start < 0.0 && late.count_after_first > 0);
        self.drives_on.map_or(by_time, |drives_on| !drives_on)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(seconds: f64) -> Stamp {
        Stamp::from_seconds(seconds)
    }

    /// Classifies scans with these stamps, s, that follow ten seconds of scans at 10 Hz. `went_back`: whether the odometry
    /// remained continuous, if its stamps went back.
    fn steps(continuity: &mut Continuity, went_back: Option<bool>, odometry: Option<f64>, stamps: &[f64]) -> Vec<Step> {
        let mut last = at(0.0);
        let mut classify = |continuity: &mut Continuity, stamp: f64| {
            let step = continuity.step(at(stamp), last, odometry.map(at));
            match step {
                Step::Forward | Step::NewRun | Step::SetBack { .. } => last = at(stamp),
                Step::Same | Step::Late => {}
            }
            step
        };
        assert!((1..=100).all(|i| classify(continuity, f64::from(i) * 0.1) == Step::Forward));
        if let Some(drives_on) = went_back {
            continuity.odometry_went_back(drives_on);
        }
        stamps.iter().map(|&stamp| classify(continuity, stamp)).collect()
    }

    fn alone(stamps: &[f64]) -> Vec<Step> {
        steps(&mut Continuity::default(), None, None, stamps)
    }

    #[test]
    fn one_earlier_scan_is_late_and_two_in_order_mean_that_the_clock_was_set() {
        assert_eq!(alone(&[9.9, 10.1, 10.1]), [Step::Late, Step::Forward, Step::Same]);
        for back in [0.3, 0.9, 1.5, 6.0] {
            let set_back = Step::SetBack { last: at(10.0 - back) };
            assert_eq!(alone(&[10.1 - back, 10.2 - back, 10.3 - back]), [Step::Late, set_back, Step::Forward], "{back} s");
        }
        assert_eq!(alone(&[5.0, 10.1]), [Step::Late, Step::Forward], "late by much");
    }

    #[test]
    fn a_new_run_starts_near_the_start_of_the_previous_one() {
        assert_eq!(alone(&[0.2, 0.3]), [Step::NewRun, Step::Forward]);
        assert_eq!(alone(&[-50.0, -49.9]), [Step::Late, Step::NewRun], "a restarted simulation");
        assert_eq!(alone(&[-50.0, 10.1]), [Step::Late, Step::Forward], "a single wrong stamp");
        let mut set_twice = Continuity::default();
        steps(&mut set_twice, None, None, &[7.1, 7.2]);
        assert_eq!(set_twice.step(at(-2.9), at(7.2), None), Step::NewRun, "by the new clock, the run started at -3 s");
    }

    #[test]
    fn odometry_takes_precedence_over_the_stamps() {
        let with_jump = |drives_on, stamps| steps(&mut Continuity::default(), Some(drives_on), Some(0.1), stamps);
        assert_eq!(with_jump(true, &[0.2, 0.3]), [Step::Late, Step::SetBack { last: at(0.1) }]);
        assert_eq!(with_jump(false, &[5.0]), [Step::NewRun]);
        // The odometry has the old time: scans are late, in whatever order and number, but not forever.
        let without_jump = |stamps: &[f64]| steps(&mut Continuity::default(), None, Some(10.0), stamps);
        let late = without_jump(&[9.4, 9.5, 0.0, 0.1, 10.1]);
        assert_eq!(late, [Step::Late, Step::Late, Step::Late, Step::Late, Step::Forward]);
        let late_for_long = without_jump(&(0..14).map(|i| 5.0 + f64::from(i) * 0.1).collect::<Vec<_>>());
        assert!(late_for_long.iter().filter(|step| matches!(step, Step::SetBack { .. })).count() == 1, "{late_for_long:?}");
    }
}
