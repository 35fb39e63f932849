//! Sleeps until a word of the segment changes.

use std::sync::atomic::AtomicU32;
use std::time::Duration;

use rustix::thread::futex::{Flags, Timespec, wait, wake};

/// Sleeps while `word` equals `value`, at most for `timeout`. May return early, so the caller must check the word again.
pub(super) fn sleep(word: &AtomicU32, value: u32, timeout: Duration) {
    let seconds = i64::try_from(timeout.as_secs()).unwrap_or(i64::MAX);
    let timeout = Timespec { tv_sec: seconds, tv_nsec: timeout.subsec_nanos().into() };
    // An error means that the word has changed, the wait timed out, or a signal arrived: the caller checks the word in any case.
    // Without the flag PRIVATE, the kernel identifies the word by its page instead of its address: the other side is another
    // process.
    let _ = wait(word, Flags::empty(), value, Some(&timeout));
}

/// Wakes all threads that sleep on `word`.
pub(super) fn wake_all(word: &AtomicU32) {
    // It fails only for words that are not mapped or not aligned.
    let _ = wake(word, Flags::empty(), i32::MAX.unsigned_abs());
}
