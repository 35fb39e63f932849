//! Parallel work on several threads: with rayon if the feature `cli` is enabled, otherwise on the calling thread.

use std::io;
#[cfg(feature = "cli")]
use std::sync::{Mutex, MutexGuard, PoisonError};

#[cfg(feature = "cli")]
use rayon::prelude::*;

/// Applies `work` to each item on all cores, and returns the results in the order of the items.
pub(crate) fn map<T: Send, R: Send>(items: impl Iterator<Item = T>, work: impl Fn(T) -> R + Send + Sync) -> Vec<R> {
    let items: Vec<T> = items.collect();
    #[cfg(feature = "cli")]
    let items = items.into_par_iter();
    #[cfg(not(feature = "cli"))]
    let items = items.into_iter();
    items.map(work).collect()
}

/// A pool of threads.
pub(crate) struct Workers {
    /// `None`: the calling thread does all the work, because waking another thread takes longer than the smallest tasks.
    #[cfg(feature = "cli")]
    pool: Option<rayon::ThreadPool>,
}

impl Workers {
    /// Creates a pool of `threads` threads; 0: one per core. Fails if the system provides none.
    #[cfg(feature = "cli")]
    pub(crate) fn new(threads: usize) -> io::Result<Self> {
        let build = || rayon::ThreadPoolBuilder::new().num_threads(threads).build().map_err(io::Error::other);
        let pool = if threads == 1 { None } else { Some(build()?) };
        Ok(Self { pool })
    }

    /// Creates no threads, whatever the argument.
    #[cfg(not(feature = "cli"))]
    #[allow(clippy::unnecessary_wraps)] // same signature as with rayon
    pub(crate) fn new(_threads: usize) -> io::Result<Self> {
        Ok(Self {})
    }

    /// Applies `work` to every task and its index.
    #[cfg_attr(not(feature = "cli"), allow(clippy::unused_self))]
    pub(crate) fn for_each<T: Send>(&self, tasks: impl Iterator<Item = T>, work: impl Fn(usize, T) + Send + Sync) {
        #[cfg(feature = "cli")]
        if let Some(pool) = &self.pool {
            let tasks: Vec<T> = tasks.collect();
            pool.install(|| tasks.into_par_iter().enumerate().for_each(|(index, task)| work(index, task)));
            return;
        }
        tasks.enumerate().for_each(|(index, task)| work(index, task));
    }
}

/// Locks, ignoring poisoning. Use it only for data that is consistent at all times, even if a thread panics while holding the lock.
#[cfg(feature = "cli")]
pub(crate) fn lock<T: ?Sized>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
