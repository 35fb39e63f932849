//! How scans are answered and other messages are taken: the same for scan matcher and particle filter.

use std::time::Duration;

use super::InputError;
use super::sensed::Sensed;
use crate::anytime::interrupt::Interrupt;
use crate::messages::nav_msgs::Odometry;
use crate::messages::sensor_msgs::Imu;
use crate::messages::tf2_msgs::TFMessage;
use crate::time::Stamp;

/// An application that answers scans, each within a contract.
pub trait Answering: Sized {
    /// The answer.
    type Answer;

    /// Answers a scan, or a cloud, that arrived when the clock read `arrival`. [`Self::conclude`] and [`Self::maintain`] are to follow;
    /// [`Self::answer`] does all of it.
    fn on_sensed(&mut self, scan: &Sensed, arrival: Duration) -> Self::Answer;

    /// Measures the elapsed time; to be called once the pose of an answer has been published.
    fn conclude(&mut self, answer: &mut Self::Answer);

    /// Work that can wait until an answer has been published; it improves the next ones. It ends early when `next` reports the next scan.
    fn maintain(&mut self, next: &dyn Interrupt);

    /// How long to hold back a scan of this stamp for odometry that it needs and that has not come yet; `None`: answer it now. A scan
    /// that is answered all the same is predicted with what odometry there is.
    fn wait_for_odometry(&self, stamp: Stamp) -> Option<Duration>;

    /// Takes wheel odometry.
    fn on_odometry(&mut self, message: &Odometry) -> Result<(), InputError>;

    /// Takes transforms, static or not.
    fn on_transforms(&mut self, message: &TFMessage) -> Result<(), InputError>;

    /// Takes a reading of the IMU, if it uses one; a reading without information (some simulators publish zeros) is ignored.
    fn on_imu(&mut self, _message: &Imu) -> Result<(), InputError> {
        Ok(())
    }

    /// Remarks on oddities of the messages; each kind is reported once.
    fn take_remarks(&mut self) -> Vec<String>;

    /// Answers a scan that arrived when the clock read `arrival`. `hand_over` publishes what the controller waits for; the elapsed time is
    /// measured then. Everything else can be published before [`Answered::maintain`].
    fn answer(
        &mut self,
        scan: &Sensed,
        arrival: Duration,
        hand_over: impl FnOnce(&mut Self, &mut Self::Answer),
    ) -> Answered<'_, Self> {
        let mut answer = self.on_sensed(scan, arrival);
        hand_over(self, &mut answer);
        self.conclude(&mut answer);
        Answered { by: self, answer }
    }
}

/// An answer that has been published; deferred work is still to be done.
#[must_use = "deferred work delays the next scan: call maintain"]
pub struct Answered<'a, A: Answering> {
    by: &'a mut A,
    answer: A::Answer,
}

impl<A: Answering> Answered<'_, A> {
    /// The application, and the answer.
    pub fn parts(&mut self) -> (&mut A, &A::Answer) {
        (self.by, &self.answer)
    }

    /// Does the deferred work, until the `next` scan is here.
    pub fn maintain(self, next: &dyn Interrupt) -> A::Answer {
        self.by.maintain(next);
        self.answer
    }
}
