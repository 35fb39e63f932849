//! SIGINT and SIGTERM.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::thread;
use std::time::Duration;

use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::iterator::Signals;

use super::NodeError;

/// Time to take leave of the master. It may hang; whoever pressed Ctrl-C is not to wait for it.
const GRACE: Duration = Duration::from_millis(600);
/// From one look whether that is over to the next.
const LOOK: Duration = Duration::from_millis(50);

/// The wish that the node should stop.
pub(super) struct StopSignal {
    received: Receiver<()>,
    /// There is something to be saved first.
    is_held: Arc<AtomicBool>,
}

impl StopSignal {
    /// From now on signals no longer end the process at once, but at the latest [`GRACE`] later, with exit code 0; while it is held, not
    /// before a second signal.
    pub(super) fn install() -> Result<Self, NodeError> {
        let system = |problem| NodeError::System { action: "handle signals", problem };
        let mut signals = Signals::new([SIGINT, SIGTERM]).map_err(system)?;
        let (sender, received) = channel();
        let is_held = Arc::new(AtomicBool::new(false));
        let held = Arc::clone(&is_held);
        let wait = move || {
            if signals.forever().next().is_some() {
                let _ = sender.send(()); // fails when the node is ending anyway
                thread::sleep(GRACE);
                while held.load(Ordering::Acquire) && signals.pending().next().is_none() {
                    thread::sleep(LOOK);
                }
                std::process::exit(0);
            }
        };
        thread::Builder::new().name("signals".into()).spawn(wait).map_err(system)?;
        Ok(Self { received, is_held })
    }

    /// Whether the process waits for something to be saved.
    pub(super) fn hold(&self, is_held: bool) {
        self.is_held.store(is_held, Ordering::Release);
    }

    /// Waits for a signal; whether there was one.
    pub(super) fn wait(&self, timeout: Duration) -> bool {
        self.received.recv_timeout(timeout) != Err(RecvTimeoutError::Timeout)
    }
}
