//! Sleeping until a word of the segment changes.

use std::sync::atomic::AtomicU32;
use std::time::Duration;

use rustix::thread::futex::{Flags, Timespec, wait, wake};

/// Sleeps while `word` holds `value`, at most `longest`. May return early: look again.
pub(super) fn sleep(word: &AtomicU32, value: u32, longest: Duration) {
    let seconds = i64::try_from(longest.as_secs()).unwrap_or(i64::MAX);
    let timeout = Timespec { tv_sec: seconds, tv_nsec: longest.subsec_nanos().into() };
    // An error says that the word has changed, the time is up, or a signal came: the caller looks again in any case.
    // Without the flag PRIVATE the kernel knows the word by its page, not its address: the other side is another process.
    let _ = wait(word, Flags::empty(), value, Some(&timeout));
}

/// Wakes all who sleep on `word`.
pub(super) fn wake_all(word: &AtomicU32) {
    // It fails for words that are not mapped or aligned only.
    let _ = wake(word, Flags::empty(), i32::MAX.unsigned_abs());
}
