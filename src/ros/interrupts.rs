//! Requests to publish the answer early: by any node on the topic `icp_interrupt`, or by a controller on the same machine through
//! shared memory.

use std::time::Duration;

use super::NodeError;
use crate::anytime::interrupt::{Interrupt, InterruptRequest};
use crate::app::Estimate;
use crate::matching::StopReason;
use crate::shared_memory::{Responder, SharedEstimate};

/// Time between two checks for requests during other waits: a request in shared memory does not wake such a thread.
pub(super) const POLL_PERIOD: Duration = Duration::from_millis(1);

/// Interrupt requests for the current scan. A request between two scans has no effect, since the latest answer is already
/// published.
pub(super) struct Interrupts {
    topic: InterruptRequest,
    segment: Option<Responder>,
}

impl Interrupts {
    /// `segment`: name of a shared memory segment to create, if any.
    pub(super) fn new(segment: Option<&str>) -> Result<Self, NodeError> {
        Ok(Self { topic: InterruptRequest::default(), segment: segment.map(Responder::create).transpose()? })
    }

    /// Handles a request on the topic.
    pub(super) fn request(&self) {
        self.topic.make();
    }

    /// Starts a new scan: later requests are for it.
    pub(super) fn begin(&self) {
        self.topic.clear();
        if let Some(segment) = &self.segment {
            segment.begin();
        }
    }

    /// Writes the published answer to shared memory.
    pub(super) fn publish(&self, estimate: &Estimate) {
        if let Some(segment) = &self.segment {
            segment.publish(&shared(estimate));
        }
    }

    /// Ends the current scan without an answer, since it was malformed.
    pub(super) fn abandon(&self) {
        if let Some(segment) = &self.segment {
            segment.abandon();
        }
    }
}

impl Interrupt for Interrupts {
    fn is_requested(&self) -> bool {
        self.topic.is_requested() || self.segment.as_ref().is_some_and(Responder::is_requested)
    }
}

fn shared(estimate: &Estimate) -> SharedEstimate {
    let answer = &estimate.registration;
    SharedEstimate {
        stamp: estimate.stamp,
        odom_from_base: answer.odom_from_base,
        position_deviation: answer.estimated_error.translation,
        heading_deviation: answer.estimated_error.rotation,
        elapsed: estimate.elapsed,
        ok: answer.outcome.is_ok(),
        deadline_met: estimate.deadline_met(),
        interrupted: answer.refinement.is_some_and(|report| report.stop_reason == StopReason::Interrupted),
    }
}
