//! SIGINT and SIGTERM.

use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::thread;
use std::time::Duration;

use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::iterator::Signals;

use super::NodeError;

/// Time to take leave of the master. It may hang; whoever pressed Ctrl-C is not to wait for it.
const GRACE: Duration = Duration::from_millis(600);

/// The wish that the node should stop.
pub(super) struct StopSignal {
    received: Receiver<()>,
}

impl StopSignal {
    /// From now on signals no longer end the process at once, but at the latest [`GRACE`] later, with exit code 0.
    pub(super) fn install() -> Result<Self, NodeError> {
        let system = |problem| NodeError::System { action: "handle signals", problem };
        let mut signals = Signals::new([SIGINT, SIGTERM]).map_err(system)?;
        let (sender, received) = channel();
        let wait = move || {
            if signals.forever().next().is_some() {
                let _ = sender.send(()); // fails when the node is ending anyway
                thread::sleep(GRACE);
                std::process::exit(0);
            }
        };
        thread::Builder::new().name("signals".into()).spawn(wait).map_err(system)?;
        Ok(Self { received })
    }

    /// Waits for a signal; whether there was one.
    pub(super) fn wait(&self, timeout: Duration) -> bool {
        self.received.recv_timeout(timeout) != Err(RecvTimeoutError::Timeout)
    }
}
