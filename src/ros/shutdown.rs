//! Handling of SIGINT and SIGTERM.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::thread;
use std::time::Duration;

use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::iterator::Signals;

use super::NodeError;
use super::threads::spawn;

/// Time for unregistering from the master. The master may hang, and the user who pressed Ctrl-C should not wait for it.
const GRACE_PERIOD: Duration = Duration::from_millis(600);
/// Time between two checks whether the process may exit.
const POLL_PERIOD: Duration = Duration::from_millis(50);

/// The request to stop the node, made by a signal.
pub(super) struct StopSignal {
    received: Receiver<()>,
    /// The process must not exit before something has been saved.
    is_held: Arc<AtomicBool>,
}

impl StopSignal {
    /// Installs the handler. From now on a signal ends the process, with exit code 0, at the latest after [`GRACE_PERIOD`]. While
    /// the exit is held, only a second signal ends it.
    pub(super) fn install() -> Result<Self, NodeError> {
        let mut signals =
            Signals::new([SIGINT, SIGTERM]).map_err(|problem| NodeError::System { action: "handle signals", problem })?;
        let (sender, received) = channel();
        let is_held = Arc::new(AtomicBool::new(false));
        let held = Arc::clone(&is_held);
        let wait = move || {
            if signals.forever().next().is_some() {
                let _ = sender.send(()); // fails when the node is ending anyway
                thread::sleep(GRACE_PERIOD);
                while held.load(Ordering::Acquire) && signals.pending().next().is_none() {
                    thread::sleep(POLL_PERIOD);
                }
                std::process::exit(0);
            }
        };
        spawn("signals", wait)?;
        Ok(Self { received, is_held })
    }

    /// Holds the exit until something has been saved, or releases it.
    pub(super) fn hold(&self, is_held: bool) {
        self.is_held.store(is_held, Ordering::Release);
    }

    /// Waits for a signal. Returns whether there was one.
    pub(super) fn wait(&self, timeout: Duration) -> bool {
        self.received.recv_timeout(timeout) != Err(RecvTimeoutError::Timeout)
    }
}
