//! Event counters.

/// Event counters of laser odometry.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct OdometryCounters {
    /// Keyframes created.
    pub keyframes: u64,
    /// Loops closed.
    pub closed_loops: u64,
    /// Scans whose pose is the prediction.
    pub predicted: u64,
    /// Matches finished after their pose had been returned.
    pub finished_later: u64,
    /// Scans with the stamp of the previous one.
    pub duplicate_scans: u64,
    /// Scans slightly older than the previous one.
    pub out_of_order_scans: u64,
    /// Runs that ended because time went back.
    pub time_jumps: u64,
    /// Clock steps after which the robot drove on.
    pub clock_steps: u64,
    /// Wheel odometry messages with the stamp of the previous one.
    pub duplicate_odometry: u64,
    /// Jumps of the wheel odometry.
    pub odometry_resets: u64,
    /// Scans whose motion was not covered by wheel odometry.
    pub without_odometry: u64,
    /// Scans predicted almost without the available odometry, because earlier matches had contradicted it.
    pub odometry_rejected: u64,
    /// Scans predicted without the IMU, because earlier matches had contradicted it.
    pub imu_rejected: u64,
    /// Matches that contradict the accepted odometry over the last seconds.
    pub odometry_contradicted: u64,
}

impl OdometryCounters {
    /// Events that the user should know of, one sentence per kind that occurred.
    pub fn in_words(&self) -> impl Iterator<Item = String> {
        let counted = [
            (self.without_odometry, "scans predicted at constant velocity: no odometry covers them"),
            (self.duplicate_scans, "scans with the stamp of the previous one"),
            (self.out_of_order_scans, "scans out of order"),
            (self.time_jumps, "jumps back in time (each started a new run)"),
            (self.clock_steps, "clock steps (each continued from the last pose)"),
            (self.duplicate_odometry, "odometry messages with the stamp of the previous one"),
            (self.odometry_resets, "jumps of the odometry"),
            (self.imu_rejected, "scans predicted without the IMU, which earlier matches had contradicted"),
            (self.odometry_rejected, "scans predicted almost without the odometry, which earlier matches had contradicted"),
            (
                self.odometry_contradicted,
                "matches that contradict the odometry: one of the two is wrong (do the wheels slip? does the laser see the robot itself, a \
                 cover, or moving people all around?)",
            ),
        ];
        counted_in_words(counted)
    }
}

/// One sentence for each kind of event that occurred.
pub fn counted_in_words<const N: usize>(counted: [(u64, &'static str); N]) -> impl Iterator<Item = String> {
    counted.into_iter().filter(|(count, _)| *count > 0).map(|(count, what)| format!("{count} {what}"))
}
