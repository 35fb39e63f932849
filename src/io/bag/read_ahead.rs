//! Decompresses chunks ahead of time on other cores: decompressing bz2 takes longer than matching the scans in it.

use std::collections::VecDeque;
use std::num::NonZero;
use std::sync::mpsc::{Receiver, SyncSender, TryRecvError, sync_channel};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread;

use super::chunk::{Content, PackedChunk};
use super::compression::Compression;
use super::error::BagError;
use super::reader::Bag;

/// Maximum number of chunks read ahead for each core: while one is decompressed, another is ready.
const CHUNKS_PER_CORE: usize = 2;
/// Maximum memory of the chunks read ahead, bytes; a single chunk may exceed it.
const MAX_BYTES: u64 = 64 << 20;
/// Maximum number of cores: with more, decompression is faster than anything that consumes the messages.
const MAX_CORES: usize = 4;

/// Returns the chunks of a bag in a given order. The calling thread reads the file in that order; worker threads decompress, and
/// the calling thread helps when it would otherwise wait. The problem of a chunk is recorded when the chunk is returned, as if it
/// had been read only then.
pub(super) struct ReadAhead<'bag> {
    bag: &'bag Bag,
    /// Chunks not read yet.
    unread: VecDeque<usize>,
    /// Chunks read but not returned yet, in order.
    pending: VecDeque<PendingChunk>,
    /// Memory of the pending chunks, bytes.
    pending_bytes: u64,
    workers: Option<Workers>,
}

/// A chunk read ahead.
struct PendingChunk {
    chunk: usize,
    bytes: u64,
    content: Result<Receiver<Content>, BagError>,
}

impl<'bag> ReadAhead<'bag> {
    /// `order`: the chunks to return.
    pub(super) fn new(bag: &'bag Bag, order: VecDeque<usize>) -> Self {
        let is_packed = |&chunk: &usize| bag.chunks()[chunk].location.compression != Compression::None;
        let worthwhile = order.iter().filter(|chunk| is_packed(chunk)).count() > 1;
        let cores = if worthwhile { thread::available_parallelism().map_or(1, NonZero::get).min(MAX_CORES) } else { 1 };
        Self::with_cores(bag, order, cores)
    }

    fn with_cores(bag: &'bag Bag, order: VecDeque<usize>, cores: usize) -> Self {
        let workers = (cores > 1).then(|| Workers::new(cores));
        Self { bag, unread: order, pending: VecDeque::new(), pending_bytes: 0, workers }
    }

    /// The content of the next chunk; `None` after the last.
    pub(super) fn next(&mut self) -> Option<Result<Content, BagError>> {
        let Some(workers) = &self.workers else {
            return Some(self.bag.read_chunk(self.unread.pop_front()?));
        };
        while let Some(&chunk) = self.unread.front() {
            let bytes = self.bag.chunks()[chunk].location.memory_bytes();
            let has_room = self.pending.len() < workers.limit && self.pending_bytes + bytes <= MAX_BYTES;
            if !has_room && !self.pending.is_empty() {
                break;
            }
            self.unread.pop_front();
            self.pending_bytes += bytes;
            let content = self.bag.read_packed(chunk).map(|packed| workers.unpack(packed));
            self.pending.push_back(PendingChunk { chunk, bytes, content });
        }
        let PendingChunk { chunk, bytes, content } = self.pending.pop_front()?;
        self.pending_bytes -= bytes;
        Some(content.and_then(|receiver| match workers.wait_for_content(&receiver) {
            Some(content) => Ok(self.bag.record_problem(content)),
            None => self.bag.read_chunk(chunk),
        }))
    }
}

/// Threads that decompress chunks.
struct Workers {
    queue: Arc<Queue>,
    /// Maximum number of chunks read ahead.
    limit: usize,
}

impl Workers {
    /// Starts one thread for each core except the caller's. If no thread can be started, the caller does all the work.
    fn new(cores: usize) -> Self {
        let queue = Arc::<Queue>::default();
        for _ in 1..cores {
            let queue = Arc::clone(&queue);
            let work = move || while queue.wait_for_job().is_some_and(Job::finish) {};
            let _ = thread::Builder::new().name("unpack".into()).spawn(work);
        }
        Self { queue, limit: cores * CHUNKS_PER_CORE }
    }

    fn unpack(&self, packed: PackedChunk) -> Receiver<Content> {
        let (sender, receiver) = sync_channel(1);
        self.queue.put(Job { packed, sender });
        receiver
    }

    /// Waits for the content of a chunk and decompresses others meanwhile. `None` if the thread that decompressed it has died.
    fn wait_for_content(&self, receiver: &Receiver<Content>) -> Option<Content> {
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

/// A chunk to decompress, and the channel for its content.
struct Job {
    packed: PackedChunk,
    sender: SyncSender<Content>,
}

impl Job {
    /// Decompresses the chunk. Returns whether the receiver still wanted its content.
    fn finish(self) -> bool {
        self.sender.send(self.packed.unpack()).is_ok()
    }
}

/// Chunks that no thread has begun to decompress.
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

    /// Waits for the next job; `None` once the queue is closed.
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

#[cfg(test)]
mod tests {
    use std::fs;
    use std::path::Path;

    use super::*;
    use crate::io::bag::BagWriter;
    use crate::messages::sensor_msgs::LaserScan;
    use crate::time::Stamp;

    /// A bag of about 20 chunks.
    fn write(path: &Path, compression: Compression) {
        let mut writer = BagWriter::create(path, compression).unwrap();
        for i in 0..2000_u32 {
            let ranges = (0..2000_u32).map(|k| ((i * 31 + k * k) % 97) as f32).collect();
            writer.write("/scan", Stamp::from_ros(1000 + i, 0), &LaserScan { ranges, ..LaserScan::default() }).unwrap();
        }
        writer.finish().unwrap();
    }

    /// The bytes of each chunk in the order given, the number of problems after each, and the maximum number of chunks read
    /// ahead.
    fn contents(bag: &Bag, order: &[usize], cores: usize) -> (Vec<Vec<u8>>, Vec<String>, usize) {
        let mut ahead = ReadAhead::with_cores(bag, order.iter().copied().collect(), cores);
        let (mut bytes, mut problems, mut max_pending) = (Vec::new(), Vec::new(), 0);
        while let Some(content) = ahead.next() {
            bytes.push(content.unwrap().bytes);
            problems.push(bag.problems().len().to_string());
            max_pending = max_pending.max(ahead.pending.len());
        }
        (bytes, problems, max_pending)
    }

    #[test]
    fn chunks_are_returned_in_order_with_their_problems_on_any_number_of_cores() {
        let folder = tempfile::tempdir().unwrap();
        for compression in [Compression::Lz4, Compression::Bz2] {
            let path = folder.path().join("a.bag");
            write(&path, compression);
            let offsets: Vec<u64> =
                Bag::open(&path).unwrap().chunks().iter().map(|chunk| chunk.location.data_offset + 1000).collect();
            assert!(offsets.len() > 15);
            let mut damaged = fs::read(&path).unwrap();
            for chunk in [4, 9] {
                let at = usize::try_from(offsets[chunk]).unwrap();
                damaged[at..at + 10].fill(0x55);
            }
            fs::write(&path, damaged).unwrap();
            let order: Vec<usize> = (0..offsets.len()).rev().collect();
            let expected = contents(&Bag::open(&path).unwrap(), &order, 1);
            assert!(expected.0.iter().filter(|bytes| bytes.is_empty()).count() == 2, "two chunks are damaged");
            for cores in [2, 4] {
                let found = contents(&Bag::open(&path).unwrap(), &order, cores);
                assert!(found.0 == expected.0 && found.1 == expected.1, "{cores} cores");
                assert!(found.2 > 0 && found.2 <= cores * CHUNKS_PER_CORE, "{} chunks ahead", found.2);
            }
        }
    }

    #[test]
    fn a_damaged_chunk_is_reported_only_when_it_is_returned() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.bag");
        write(&path, Compression::Lz4);
        let bag = Bag::open(&path).unwrap();
        let at = usize::try_from(bag.chunks()[1].location.data_offset + 1000).unwrap();
        let mut bytes = fs::read(&path).unwrap();
        bytes[at..at + 10].fill(0x55);
        fs::write(&path, bytes).unwrap();
        let bag = Bag::open(&path).unwrap();
        let mut ahead = ReadAhead::with_cores(&bag, (0..3).collect(), 2);
        assert!(ahead.next().unwrap().is_ok() && bag.problems().is_empty());
        assert!(ahead.next().unwrap().is_ok() && bag.problems().len() == 1);
    }
}
