//! Who may call for the answer before its time: anybody by the topic `icp_interrupt`, and a controller on the same machine by shared
//! memory.

use std::time::Duration;

use super::NodeError;
use crate::anytime::interrupt::{Interrupt, Request};
use crate::app::Estimate;
use crate::matching::StopReason;
use crate::shared_memory::{Responder, SharedEstimate};

/// A request in shared memory does not wake a thread that waits for something else: how often such a wait polls for requests.
pub(super) const LOOK: Duration = Duration::from_millis(1);

/// The requests for the scan that is being worked on. One that comes while there is none asks for nothing: the newest answer is out.
pub(super) struct Interrupts {
    topic: Request,
    segment: Option<Responder>,
}

impl Interrupts {
    /// With `segment`, the shared memory of that name is offered as well.
    pub(super) fn new(segment: Option<&str>) -> Result<Self, NodeError> {
        Ok(Self { topic: Request::default(), segment: segment.map(Responder::create).transpose()? })
    }

    /// Somebody calls by the topic.
    pub(super) fn request(&self) {
        self.topic.make();
    }

    /// A scan is taken up: requests from now on are for it.
    pub(super) fn begin(&self) {
        self.topic.clear();
        if let Some(segment) = &self.segment {
            segment.begin();
        }
    }

    /// The answer is out.
    pub(super) fn publish(&self, estimate: &Estimate) {
        if let Some(segment) = &self.segment {
            segment.publish(&shared(estimate));
        }
    }

    /// The scan taken up was none.
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
