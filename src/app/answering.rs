//! The interface that the scan matcher and the particle filter share: scans in, answers out, and all other messages.

use std::time::Duration;

use super::InputError;
use super::sensed::SensorMessage;
use crate::anytime::interrupt::Interrupt;
use crate::messages::nav_msgs::Odometry;
use crate::messages::sensor_msgs::Imu;
use crate::messages::std_msgs::Header;
use crate::messages::tf2_msgs::TFMessage;

/// An application that processes scans, each under a contract.
pub trait ScanProcessor: Sized {
    /// The result for one scan.
    type Answer;

    /// Processes a scan or a cloud that arrived when the clock read `arrival`. The caller must then call [`Self::conclude`] and
    /// [`Self::maintain`]; [`Self::answer`] calls all three.
    fn on_sensed(&mut self, scan: &SensorMessage, arrival: Duration) -> Self::Answer;

    /// Measures the elapsed time. Call it once the pose of an answer has been published.
    fn conclude(&mut self, answer: &mut Self::Answer);

    /// Does the work that can wait until an answer has been published and that improves later answers. It ends early when `next`
    /// reports the next scan.
    fn maintain(&mut self, next: &dyn Interrupt);

    /// How long to delay the scan with this header until the odometry and the pose of its laser have arrived; `None`: process it
    /// now. If the wait times out, the scan is processed with what there is.
    fn wait_for_inputs(&self, header: &Header) -> Option<Duration>;

    /// Handles a wheel odometry message.
    fn on_odometry(&mut self, message: &Odometry) -> Result<(), InputError>;

    /// Handles transforms, static or not.
    fn on_transforms(&mut self, message: &TFMessage) -> Result<(), InputError>;

    /// Handles an IMU message, if the application uses an IMU. Messages without information are ignored (some simulators publish
    /// zeros).
    fn on_imu(&mut self, _message: &Imu) -> Result<(), InputError> {
        Ok(())
    }

    /// Takes the warnings about unusual messages; each kind is reported once.
    fn take_warnings(&mut self) -> Vec<String>;

    /// Processes a scan that arrived when the clock read `arrival`. `publish` publishes what the controller waits for; the
    /// elapsed time is measured after it. Everything else can be published before [`PublishedAnswer::maintain`].
    fn answer(
        &mut self,
        scan: &SensorMessage,
        arrival: Duration,
        publish: impl FnOnce(&mut Self, &mut Self::Answer),
    ) -> PublishedAnswer<'_, Self> {
        let mut answer = self.on_sensed(scan, arrival);
        publish(self, &mut answer);
        self.conclude(&mut answer);
        PublishedAnswer { app: self, answer }
    }
}

/// An answer that has been published; its deferred work is still pending.
#[must_use = "deferred work delays the next scan: call maintain"]
pub struct PublishedAnswer<'a, A: ScanProcessor> {
    app: &'a mut A,
    answer: A::Answer,
}

impl<A: ScanProcessor> PublishedAnswer<'_, A> {
    /// The application and the answer.
    pub fn parts(&mut self) -> (&mut A, &A::Answer) {
        (self.app, &self.answer)
    }

    /// Does the deferred work until the `next` scan arrives.
    pub fn maintain(self, next: &dyn Interrupt) -> A::Answer {
        self.app.maintain(next);
        self.answer
    }
}
