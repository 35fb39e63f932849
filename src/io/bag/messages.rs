//! Iterates over the messages of a bag in the order of their recording times.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BinaryHeap, VecDeque};

use crate::messages::{self, Message};
use crate::time::Stamp;

use super::chunk::Entry;
use super::connection::Connection;
use super::error::BagError;
use super::read_ahead::ReadAhead;
use super::reader::Bag;

/// Maximum size of all decompressed chunks kept in memory at a time, bytes. Chunks usually overlap by only a few messages. If all
/// chunks of a bag overlap, the chunks needed last are dropped and read again later.
const MAX_CACHED_BYTES: usize = 256 << 20;

/// A message as recorded.
pub struct BagMessage<'bag> {
    bag: &'bag Bag,
    chunk: usize,
    /// Topic and type.
    pub connection: &'bag Connection,
    /// Time of recording.
    pub time: Stamp,
    /// The serialized message.
    pub data: Vec<u8>,
}

impl BagMessage<'_> {
    /// Deserializes the message; an error if it is not of type `T`.
    pub fn decode<T: Message>(&self) -> Result<T, BagError> {
        self.bag.check_type::<T>(self.connection)?;
        messages::decode(&self.data).map_err(|source| BagError::Decode {
            path: self.bag.path().to_path_buf(),
            topic: self.connection.topic.clone(),
            time: self.time,
            chunk_offset: self.bag.chunks()[self.chunk].location.offset,
            source,
        })
    }
}

impl Bag {
    /// The messages on `topics` (`None`: on all topics), sorted by recording time; messages of equal times stay in file order.
    ///
    /// Damaged chunks are skipped and listed in [`Bag::problems`]; an `Err` means that the file could not be read.
    pub fn messages(&self, topics: Option<&[&str]>) -> Messages<'_> {
        Messages::new(self, self.connections_of(topics).map(|connection| (connection.id, connection)).collect())
    }
}

/// Iterator returned by [`Bag::messages`]: merges the chunks, which overlap in time.
pub struct Messages<'bag> {
    bag: &'bag Bag,
    wanted: BTreeMap<u32, &'bag Connection>,
    /// Chunks not opened yet: time of the first message and chunk number, sorted by that time.
    waiting: VecDeque<(Stamp, usize)>,
    /// Decompresses the waiting chunks.
    ahead: ReadAhead<'bag>,
    /// Chunks with messages still to return, by chunk number.
    open: BTreeMap<usize, OpenChunk<'bag>>,
    /// Time of the next message of each open chunk, and the chunk number.
    next: BinaryHeap<Reverse<(Stamp, usize)>>,
    /// Decompressed bytes of all open chunks.
    cached_bytes: usize,
}

struct OpenChunk<'bag> {
    /// Decompressed bytes; empty while dropped to save memory.
    bytes: Vec<u8>,
    /// Messages still to return, sorted by time.
    messages: VecDeque<(&'bag Connection, Entry)>,
}

impl<'bag> Messages<'bag> {
    fn new(bag: &'bag Bag, wanted: BTreeMap<u32, &'bag Connection>) -> Self {
        let mut waiting: Vec<(Stamp, usize)> = bag
            .chunks()
            .iter()
            .enumerate()
            .filter(|(_, chunk)| chunk.index.counts.keys().any(|id| wanted.contains_key(id)))
            .filter_map(|(i, chunk)| chunk.index.span.map(|(start, _)| (start, i)))
            .collect();
        waiting.sort_unstable();
        let ahead = ReadAhead::new(bag, waiting.iter().map(|(_, chunk)| *chunk).collect());
        Self { bag, wanted, waiting: waiting.into(), ahead, open: BTreeMap::new(), next: BinaryHeap::new(), cached_bytes: 0 }
    }

    /// Opens every chunk that may contain a message earlier than the next one of the open chunks.
    fn open_chunks(&mut self) -> Result<(), BagError> {
        while let Some(&(start, chunk)) = self.waiting.front() {
            if self.next.peek().is_some_and(|Reverse((time, _))| *time < start) {
                break;
            }
            self.waiting.pop_front();
            let Some(content) = self.ahead.next() else { break };
            let content = content?;
            let wanted = |entry: Entry| self.wanted.get(&entry.connection).map(|&connection| (connection, entry));
            let mut messages: Vec<_> = content.messages.into_iter().filter_map(wanted).collect();
            messages.sort_by_key(|(_, entry)| entry.time);
            if let Some((_, first)) = messages.first() {
                self.make_room(content.bytes.len());
                self.next.push(Reverse((first.time, chunk)));
                self.open.insert(chunk, OpenChunk { bytes: content.bytes, messages: messages.into() });
            }
        }
        Ok(())
    }

    /// Accounts for `bytes` more in memory; above the limit, drops the chunks that are needed last.
    fn make_room(&mut self, bytes: usize) {
        self.cached_bytes += bytes;
        while self.cached_bytes > MAX_CACHED_BYTES {
            let loaded = self.open.values_mut().filter(|open| !open.bytes.is_empty());
            let Some(latest) = loaded.max_by_key(|open| open.messages.front().map(|(_, entry)| entry.time)) else { break };
            self.cached_bytes -= latest.bytes.len();
            latest.bytes = Vec::new();
        }
    }

    fn read_next(&mut self) -> Result<Option<BagMessage<'bag>>, BagError> {
        self.open_chunks()?;
        let Some(Reverse((time, chunk))) = self.next.pop() else { return Ok(None) };
        let Some(mut open) = self.open.remove(&chunk) else { return Ok(None) };
        let Some((connection, entry)) = open.messages.pop_front() else { return Ok(None) };
        if open.bytes.is_empty() {
            open.bytes = self.bag.read_chunk(chunk)?.bytes;
            self.make_room(open.bytes.len());
        }
        let data = open.bytes.get(entry.data).unwrap_or_default().to_vec();
        if let Some((_, following)) = open.messages.front() {
            self.next.push(Reverse((following.time, chunk)));
            self.open.insert(chunk, open);
        } else {
            self.cached_bytes -= open.bytes.len();
        }
        Ok(Some(BagMessage { bag: self.bag, chunk, connection, time, data }))
    }
}

impl<'bag> Iterator for Messages<'bag> {
    type Item = Result<BagMessage<'bag>, BagError>;

    fn next(&mut self) -> Option<Self::Item> {
        let item = self.read_next().transpose();
        if matches!(item, Some(Err(_))) {
            // A file system error would only repeat, so the iteration ends here.
            self.waiting.clear();
            self.next.clear();
        }
        item
    }
}
