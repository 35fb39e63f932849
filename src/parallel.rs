//! Work that several threads share: by rayon, with the feature `cli`; else the thread that asks does it all.

use std::io;

#[cfg(feature = "cli")]
use rayon::prelude::*;

/// What `work` makes of each item, in their order, by as many threads as there are cores.
pub(crate) fn map<T: Send, R: Send>(items: impl Iterator<Item = T>, work: impl Fn(T) -> R + Send + Sync) -> Vec<R> {
    let items: Vec<T> = items.collect();
    #[cfg(feature = "cli")]
    let items = items.into_par_iter();
    #[cfg(not(feature = "cli"))]
    let items = items.into_iter();
    items.map(work).collect()
}

/// Threads that wait for tasks.
pub(crate) struct Workers {
    /// `None`: the thread that asks does it all. Waking another takes longer than the least tasks.
    #[cfg(feature = "cli")]
    pool: Option<rayon::ThreadPool>,
}

impl Workers {
    /// `threads`; 0: one for each core. Fails when the system gives none.
    #[cfg(feature = "cli")]
    pub(crate) fn new(threads: usize) -> io::Result<Self> {
        let build = || rayon::ThreadPoolBuilder::new().num_threads(threads).build().map_err(io::Error::other);
        let pool = if threads == 1 { None } else { Some(build()?) };
        Ok(Self { pool })
    }

    /// No threads, however many are asked for.
    #[cfg(not(feature = "cli"))]
    #[allow(clippy::unnecessary_wraps)] // as the other one
    pub(crate) fn new(_threads: usize) -> io::Result<Self> {
        Ok(Self {})
    }

    /// Does every task; `work` is told its number.
    #[cfg_attr(not(feature = "cli"), allow(clippy::unused_self))]
    pub(crate) fn share<T: Send>(&self, tasks: impl Iterator<Item = T>, work: impl Fn(usize, T) + Send + Sync) {
        #[cfg(feature = "cli")]
        if let Some(pool) = &self.pool {
            let tasks: Vec<T> = tasks.collect();
            pool.install(|| tasks.into_par_iter().enumerate().for_each(|(number, task)| work(number, task)));
            return;
        }
        tasks.enumerate().for_each(|(number, task)| work(number, task));
    }
}
