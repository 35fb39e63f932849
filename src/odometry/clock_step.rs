//! Stamps that go back: a scan that was late, a clock that somebody has set while the robot drives on, or a run that starts again.

use crate::time::Stamp;

/// What the last messages say of it.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct ClockStep {
    /// The stamp of the scan before, where that was before the one of the last answer.
    pub(super) late: Option<Stamp>,
    /// When time went back in the odometry, its pose stayed where it was.
    pub(super) drives_on: bool,
}

impl ClockStep {
    /// The scan before, where that and this one, in order, are both from before the last answer: they are not late, it is their time.
    pub(super) fn begun_by(&self, stamp: Stamp) -> Option<Stamp> {
        self.late.filter(|late| stamp > *late)
    }
}
