//! Events that are counted.

/// Events that are counted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct OdometryCounters {
    /// Keyframes so far.
    pub keyframes: u64,
    /// Places recognised.
    pub closed_loops: u64,
    /// Answers that were predictions.
    pub predicted: u64,
    /// Matches that were finished after their answer was out.
    pub finished_later: u64,
    /// Scans with the stamp of the one before.
    pub duplicate_scans: u64,
    /// Scans a little older than the one before.
    pub out_of_order_scans: u64,
    /// Runs that ended because time went back.
    pub time_jumps: u64,
    /// Steps of the clock after which the robot drove on.
    pub clock_steps: u64,
    /// Wheel odometry messages with the stamp of the one before.
    pub duplicate_odometry: u64,
    /// Jumps of the wheel odometry.
    pub odometry_resets: u64,
    /// Scans whose motion the wheel odometry did not cover.
    pub without_odometry: u64,
    /// Scans whose prediction made next to nothing of the odometry there was, as the matches before had contradicted it.
    pub odometry_disbelieved: u64,
    /// The same of the IMU.
    pub imu_disbelieved: u64,
    /// Matches that contradict the odometry, which has not been disbelieved: it says another way from the last keyframe.
    pub odometry_contradicted: u64,
}

impl OdometryCounters {
    /// What the user should know of the events, one sentence for each kind that there was.
    pub fn in_words(&self) -> impl Iterator<Item = String> {
        let counted = [
            (self.without_odometry, "scans predicted at constant velocity: no odometry covers them"),
            (self.duplicate_scans, "scans with the stamp of the one before"),
            (self.out_of_order_scans, "scans out of order"),
            (self.time_jumps, "jumps back in time (each started a new run)"),
            (self.clock_steps, "steps of the clock (each went on from the last pose)"),
            (self.duplicate_odometry, "odometry messages with the stamp of the one before"),
            (self.odometry_resets, "jumps of the odometry"),
            (self.imu_disbelieved, "scans predicted without the IMU, which the scans before had contradicted"),
            (self.odometry_disbelieved, "scans predicted almost without the odometry, which the scans before had contradicted"),
            (
                self.odometry_contradicted,
                "matches that contradict the odometry: one of the two is wrong (do wheels slip? does the laser see the robot itself, or a \
                 cover, or people all around?)",
            ),
        ];
        counted_in_words(counted)
    }
}

/// A sentence for each of these kinds of events that there was.
pub fn counted_in_words<const N: usize>(counted: [(u64, &'static str); N]) -> impl Iterator<Item = String> {
    counted.into_iter().filter(|(count, _)| *count > 0).map(|(count, what)| format!("{count} {what}"))
}
