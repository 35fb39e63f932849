//! Decompresses chunks ahead on other cores: decompressing bz2 takes longer than matching the scans in it.

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
/// Cores used at most: with more, decompression is faster than anything that consumes the messages.
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
        Self::with_cores(bag, order, cores)
    }

    fn with_cores(bag: &'bag Bag, order: VecDeque<usize>, cores: usize) -> Self {
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
    /// One for each core but the caller's. If no thread can be started, the caller does all the work.
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

    /// Waits for the content of a chunk and decompresses others meanwhile. `None`: the thread that had it has died.
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

/// A chunk to decompress, and where its content goes.
struct Job {
    packed: PackedChunk,
    sender: SyncSender<Content>,
}

impl Job {
    /// Whether its content is still wanted.
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

    /// The bytes and the problem of each chunk in the order given, and the most that were read ahead.
    fn contents(bag: &Bag, order: &[usize], cores: usize) -> (Vec<Vec<u8>>, Vec<String>, usize) {
        let mut ahead = ReadAhead::with_cores(bag, order.iter().copied().collect(), cores);
        let (mut bytes, mut problems, mut most) = (Vec::new(), Vec::new(), 0);
        while let Some(content) = ahead.next() {
            bytes.push(content.unwrap().bytes);
            problems.push(bag.problems().len().to_string());
            most = most.max(ahead.ahead.len());
        }
        (bytes, problems, most)
    }

    #[test]
    fn chunks_come_in_their_order_with_their_problems_on_any_number_of_cores() {
        let folder = tempfile::tempdir().unwrap();
        for compression in [Compression::Lz4, Compression::Bz2] {
            let path = folder.path().join("a.bag");
            write(&path, compression);
            let places: Vec<u64> = Bag::open(&path).unwrap().chunks().iter().map(|chunk| chunk.data_offset + 1000).collect();
            assert!(places.len() > 15);
            let mut damaged = fs::read(&path).unwrap();
            for chunk in [4, 9] {
                let at = usize::try_from(places[chunk]).unwrap();
                damaged[at..at + 10].fill(0x55);
            }
            fs::write(&path, damaged).unwrap();
            let order: Vec<usize> = (0..places.len()).rev().collect();
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
    fn what_is_ahead_and_not_wanted_is_not_said_to_be_lost() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.bag");
        write(&path, Compression::Lz4);
        let bag = Bag::open(&path).unwrap();
        let at = usize::try_from(bag.chunks()[1].data_offset + 1000).unwrap();
        let mut bytes = fs::read(&path).unwrap();
        bytes[at..at + 10].fill(0x55);
        fs::write(&path, bytes).unwrap();
        let bag = Bag::open(&path).unwrap();
        let mut ahead = ReadAhead::with_cores(&bag, (0..3).collect(), 2);
        assert!(ahead.next().unwrap().is_ok() && bag.problems().is_empty());
        assert!(ahead.next().unwrap().is_ok() && bag.problems().len() == 1);
    }
}
