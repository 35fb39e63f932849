//! Starts threads.

use std::io;
use std::thread::{Builder, JoinHandle, Scope, ScopedJoinHandle};

use super::NodeError;

/// Starts a named thread.
pub(super) fn spawn(name: &str, work: impl FnOnce() + Send + 'static) -> Result<JoinHandle<()>, NodeError> {
    Builder::new().name(name.into()).spawn(work).map_err(no_thread)
}

/// Starts a named thread that ends within the scope.
pub(super) fn spawn_scoped<'scope>(
    scope: &'scope Scope<'scope, '_>,
    name: &str,
    work: impl FnOnce() + Send + 'scope,
) -> Result<ScopedJoinHandle<'scope, ()>, NodeError> {
    Builder::new().name(name.into()).spawn_scoped(scope, work).map_err(no_thread)
}

fn no_thread(problem: io::Error) -> NodeError {
    NodeError::System { action: "start a thread", problem }
}
