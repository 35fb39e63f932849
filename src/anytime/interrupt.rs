//! Calling for the answer before its time.

use std::sync::atomic::{AtomicBool, Ordering};

/// Whether somebody wants the answer now. Asked between iterations: it must be quick.
pub trait Interrupt: Send + Sync {
    /// Whether the refinement is to end with what it has.
    fn is_requested(&self) -> bool;
}

/// Nobody interrupts.
#[derive(Clone, Copy, Debug, Default)]
pub struct Never;

impl Interrupt for Never {
    fn is_requested(&self) -> bool {
        false
    }
}

/// A request that stands until it is cleared.
#[derive(Debug, Default)]
pub struct Request {
    made: AtomicBool,
}

impl Request {
    /// Calls for the answer.
    pub fn make(&self) {
        self.made.store(true, Ordering::Release);
    }

    /// Forgets the request.
    pub fn clear(&self) {
        self.made.store(false, Ordering::Release);
    }
}

impl Interrupt for Request {
    fn is_requested(&self) -> bool {
        self.made.load(Ordering::Acquire)
    }
}
