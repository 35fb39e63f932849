//! Who does the work on the particles: this thread, or several.

use rayon::prelude::*;
use rayon::{ThreadPool, ThreadPoolBuildError, ThreadPoolBuilder};

/// Threads that share tasks.
pub(super) struct Workers {
    /// `None`: the thread that asks does it all. Waking another takes longer than the least tasks.
    pool: Option<ThreadPool>,
}

impl Workers {
    /// `threads`; 0: one for each core. Fails when the system gives none.
    pub(super) fn new(threads: usize) -> Result<Self, ThreadPoolBuildError> {
        let pool = if threads == 1 { None } else { Some(ThreadPoolBuilder::new().num_threads(threads).build()?) };
        Ok(Self { pool })
    }

    /// Does every task; `work` is told its number.
    pub(super) fn share<T: Send>(&self, tasks: impl Iterator<Item = T>, work: impl Fn(usize, T) + Send + Sync) {
        match &self.pool {
            None => tasks.enumerate().for_each(|(number, task)| work(number, task)),
            Some(pool) => {
                let tasks: Vec<T> = tasks.collect();
                pool.install(|| tasks.into_par_iter().enumerate().for_each(|(number, task)| work(number, task)));
            }
        }
    }
}
