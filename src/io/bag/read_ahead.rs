//! Chunks unpacked ahead on other cores: unpacking bz2 takes longer than matching what comes out of it.

use std::collections::VecDeque;
use std::num::NonZero;
use std::sync::mpsc::{Receiver, SyncSender, TryRecvError, sync_channel};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread;

use super::chunk::{Content, PackedChunk};
use super::compression::Compression;
use super::error::BagError;
use super::reader::Bag;

/// Chunks read ahead at most, for each core: while one is unpacked another is ready.
const CHUNKS_PER_CORE: usize = 2;
/// Bytes that they take at most; one chunk may take more.
const MAX_BYTES: u64 = 64 << 20;
/// Cores used at most: more are faster than anything that takes the messages.
const MAX_CORES: usize = 4;

/// Gives the chunks of a bag in a given order. The file is read here and now, in that order; other threads unpack what was read, and so does
/// this one where it would have to wait. Losses are noted when a chunk is given out, as if it had been read then.
pub(super) struct ReadAhead<'bag> {
    bag: &'bag Bag,
    /// Chunks not read yet.
    to_come: VecDeque<usize>,
    /// Chunks read, in their order.
    ahead: VecDeque<Ahead>,
    /// Bytes that these take.
    bytes: u64,
    workers: Option<Workers>,
}

/// A chunk read ahead.
struct Ahead {
    chunk: usize,
    bytes: u64,
    content: Result<Receiver<Content>, BagError>,
}

impl<'bag> ReadAhead<'bag> {
    /// `order`: the chunks to give.
    pub(super) fn new(bag: &'bag Bag, order: VecDeque<usize>) -> Self {
        let is_packed = |&chunk: &usize| bag.chunks()[chunk].compression != Compression::None;
        let worthwhile = order.iter().filter(|chunk| is_packed(chunk)).count() > 1;
        let cores = if worthwhile { thread::available_parallelism().map_or(1, NonZero::get).min(MAX_CORES) } else { 1 };
        Self { bag, to_come: order, ahead: VecDeque::new(), bytes: 0, workers: (cores > 1).then(|| Workers::new(cores)) }
    }

    /// The content of the next chunk; `None` after the last.
    pub(super) fn next(&mut self) -> Option<Result<Content, BagError>> {
        let Some(workers) = &self.workers else {
            return Some(self.bag.read_chunk(self.to_come.pop_front()?));
        };
        while let Some(&chunk) = self.to_come.front() {
            let bytes = self.bag.chunks()[chunk].memory();
            let has_room = self.ahead.len() < workers.limit && self.bytes + bytes <= MAX_BYTES;
            if !has_room && !self.ahead.is_empty() {
                break;
            }
            self.to_come.pop_front();
            self.bytes += bytes;
            let content = self.bag.read_packed(chunk).map(|packed| workers.unpack(packed));
            self.ahead.push_back(Ahead { chunk, bytes, content });
        }
        let Ahead { chunk, bytes, content } = self.ahead.pop_front()?;
        self.bytes -= bytes;
        Some(content.and_then(|receiver| match workers.await_content(&receiver) {
            Some(content) => Ok(self.bag.note_problem(content)),
            None => self.bag.read_chunk(chunk),
        }))
    }
}

/// Threads that unpack.
struct Workers {
    queue: Arc<Queue>,
    /// Chunks read ahead at most.
    limit: usize,
}

impl Workers {
    /// One for each core but that of who asks. Where the system gives no thread, who asks does it all.
    fn new(cores: usize) -> Self {
        let queue = Arc::<Queue>::default();
        for _ in 1..cores {
            let queue = Arc::clone(&queue);
            let work = move || while queue.wait_for_job().is_some_and(|job| job.finish()) {};
            let _ = thread::Builder::new().name("unpack".into()).spawn(work);
        }
        Self { queue, limit: cores * CHUNKS_PER_CORE }
    }

    fn unpack(&self, packed: PackedChunk) -> Receiver<Content> {
        let (sender, receiver) = sync_channel(1);
        self.queue.put(Job { packed, sender });
        receiver
    }

    /// Waits for a content, working on what nobody has begun. `None`: the thread that had it has died.
    fn await_content(&self, receiver: &Receiver<Content>) -> Option<Content> {
        loop {
            match receiver.try_recv() {
                Ok(content) => return Some(content),
                Err(TryRecvError::Disconnected) => return None,
                Err(TryRecvError::Empty) => match self.queue.take() {
                    Some(job) => drop(job.finish()),
                    None => return receiver.recv().ok(),
                },
            }
        }
    }
}

impl Drop for Workers {
    fn drop(&mut self) {
        self.queue.close();
    }
}

/// A chunk to unpack, and who wants it.
struct Job {
    packed: PackedChunk,
    sender: SyncSender<Content>,
}

impl Job {
    /// Whether anybody still wants it.
    fn finish(self) -> bool {
        self.sender.send(self.packed.unpack()).is_ok()
    }
}

/// Chunks that nobody has begun to unpack.
#[derive(Default)]
struct Queue {
    state: Mutex<QueueState>,
    changed: Condvar,
}

#[derive(Default)]
struct QueueState {
    jobs: VecDeque<Job>,
    closed: bool,
}

impl Queue {
    fn lock(&self) -> MutexGuard<'_, QueueState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn put(&self, job: Job) {
        self.lock().jobs.push_back(job);
        self.changed.notify_one();
    }

    fn take(&self) -> Option<Job> {
        self.lock().jobs.pop_front()
    }

    /// `None` once it is closed.
    fn wait_for_job(&self) -> Option<Job> {
        let mut state = self.lock();
        while state.jobs.is_empty() && !state.closed {
            state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
        if state.closed { None } else { state.jobs.pop_front() }
    }

    fn close(&self) {
        let mut state = self.lock();
        state.closed = true;
        state.jobs.clear();
        self.changed.notify_all();
    }
}
