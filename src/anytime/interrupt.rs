//! Interrupts: requests for an answer before its deadline.

use std::sync::atomic::{AtomicBool, Ordering};

/// Whether an answer is requested now. Checked between iterations, so it must be fast.
pub trait Interrupt: Send + Sync {
    /// Whether the refinement should stop and return what it has.
    fn is_requested(&self) -> bool;
}

/// No interrupts.
#[derive(Clone, Copy, Debug, Default)]
pub struct NeverInterrupt;

impl Interrupt for NeverInterrupt {
    fn is_requested(&self) -> bool {
        false
    }
}

/// A request that stands until it is cleared.
#[derive(Debug, Default)]
pub struct InterruptRequest {
    made: AtomicBool,
}

impl InterruptRequest {
    /// Requests the answer.
    pub fn make(&self) {
        self.made.store(true, Ordering::Release);
    }

    /// Clears the request.
    pub fn clear(&self) {
        self.made.store(false, Ordering::Release);
    }
}

impl Interrupt for InterruptRequest {
    fn is_requested(&self) -> bool {
        self.made.load(Ordering::Acquire)
    }
}
