//! Chunks: the compressed blocks of messages that a bag consists of.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::ops::Range;

use crate::time::Stamp;

use super::compression::Compression;
use super::connection::Connection;
use super::error::{BagProblem, COPY_AGAIN, REINDEX};
use super::record::{Fields, op, split_block};

/// Largest chunk read, packed or unpacked. Recorders begin a new chunk after 768 KiB; only a larger message makes a larger chunk.
const MAX_CHUNK_BYTES: u64 = 512 << 20;

/// Where a chunk is and what it holds.
pub(super) struct Chunk {
    /// Start of its record.
    pub(super) offset: u64,
    /// Start of its packed bytes.
    pub(super) data_offset: u64,
    /// Number of packed bytes that are in the file.
    pub(super) packed: u64,
    /// Number of bytes after unpacking; 0 when the recorder had no time to write it.
    pub(super) size: u64,
    pub(super) compression: Compression,
    /// The file ends before the chunk does.
    pub(super) cut_off: bool,
    /// What it holds: from the bag's index, or from reading the chunk.
    pub(super) index: ChunkIndex,
    /// An index record of it could not be read: only the chunk itself tells what it holds.
    pub(super) badly_indexed: bool,
}

/// What a chunk holds, in short.
#[derive(Default)]
pub(super) struct ChunkIndex {
    /// Number of messages by connection.
    pub(super) counts: BTreeMap<u32, u64>,
    /// Times of the first and the last message; `None` without messages.
    pub(super) span: Option<(Stamp, Stamp)>,
}

impl ChunkIndex {
    pub(super) fn add(&mut self, connection: u32, time: Stamp) {
        *self.counts.entry(connection).or_default() += 1;
        self.span = Some(self.span.map_or((time, time), |(start, end)| (start.min(time), end.max(time))));
    }
}

/// A chunk unpacked.
pub(super) struct Content {
    pub(super) bytes: Vec<u8>,
    /// Its messages in file order.
    pub(super) messages: Vec<Entry>,
    pub(super) connections: Vec<Connection>,
    /// What could not be read of it.
    pub(super) problem: Option<BagProblem>,
}

/// A message in a chunk's bytes.
pub(super) struct Entry {
    pub(super) time: Stamp,
    pub(super) connection: u32,
    pub(super) data: Range<usize>,
}

impl Content {
    pub(super) fn index(&self) -> ChunkIndex {
        let mut index = ChunkIndex::default();
        for message in &self.messages {
            index.add(message.connection, message.time);
        }
        index
    }

    /// Reads records up to the first that makes no sense.
    fn parse(bytes: Vec<u8>) -> (Self, Result<(), Stop>) {
        let mut content = Self { bytes: Vec::new(), messages: Vec::new(), connections: Vec::new(), problem: None };
        let mut at = 0;
        let outcome = loop {
            if at == bytes.len() {
                break Ok(());
            }
            match content.parse_record(&bytes, at) {
                Ok(next) => at = next,
                Err(reason) => break Err(Stop { at, reason }),
            }
        };
        content.bytes = bytes;
        (content, outcome)
    }

    fn parse_record(&mut self, bytes: &[u8], at: usize) -> Result<usize, String> {
        let (header, rest) = split_block(&bytes[at..]).ok_or("a record is longer than its chunk")?;
        let (data, rest) = split_block(rest).ok_or("a record is longer than its chunk")?;
        let end = bytes.len() - rest.len();
        let fields = Fields(header);
        match fields.op()? {
            op::MESSAGE => self.messages.push(Entry {
                time: fields.stamp("time")?,
                connection: fields.u32("conn")?,
                data: end - data.len()..end,
            }),
            // Messages of one that cannot be read are said to be lost; the others are not.
            op::CONNECTION => self.connections.extend(Connection::parse(fields, data)),
            other => return Err(format!("a record of kind {other} does not belong in a chunk")),
        }
        Ok(end)
    }
}

/// Where and why the parsing of a chunk stopped.
struct Stop {
    at: usize,
    reason: String,
}

impl Chunk {
    /// Reads the chunk. `Err` only when the file system refuses.
    pub(super) fn read(&self, file: &mut File) -> io::Result<PackedChunk> {
        let &Self { offset, packed, size, compression, cut_off, .. } = self;
        let mut bytes = Vec::new();
        if !self.is_too_large() {
            file.seek(SeekFrom::Start(self.data_offset))?;
            file.take(packed).read_to_end(&mut bytes)?;
        }
        Ok(PackedChunk { bytes, offset, packed, size, compression, cut_off, is_too_large: self.is_too_large() })
    }

    /// Bytes that it takes in memory while it is unpacked, at most.
    pub(super) fn memory(&self) -> u64 {
        match self {
            _ if self.is_too_large() => 0,
            Self { cut_off: true, .. } => MAX_CHUNK_BYTES,
            Self { packed, size, .. } => packed + size,
        }
    }

    fn is_too_large(&self) -> bool {
        self.packed.max(self.size) > MAX_CHUNK_BYTES
    }
}

/// A chunk as it is in the file, with what there is to know to unpack it anywhere.
pub(super) struct PackedChunk {
    bytes: Vec<u8>,
    offset: u64,
    packed: u64,
    size: u64,
    compression: Compression,
    cut_off: bool,
    /// Its bytes were not read.
    is_too_large: bool,
}

impl PackedChunk {
    /// Unpacks and parses the chunk; what is wrong with it, the content says.
    pub(super) fn unpack(mut self) -> Content {
        if self.is_too_large {
            let what = format!("a chunk of {} bytes, unpacked {}: more than is read at once", self.packed, self.size);
            return self.unusable(what, "`rosbag filter IN OUT True` writes usual chunks");
        }
        // A chunk that the recorder did not finish says nothing of its size.
        let limit = if self.cut_off { MAX_CHUNK_BYTES } else { self.size };
        let (bytes, unpacked) = self.compression.unpack(std::mem::take(&mut self.bytes), limit);
        match unpacked {
            // Without the checksum at the end none of the bytes before can be trusted.
            Err(error) if !self.cut_off => {
                self.unusable(format!("a damaged {} chunk ({error})", self.compression.name()), COPY_AGAIN)
            }
            _ => self.parse(bytes),
        }
    }

    fn parse(&self, bytes: Vec<u8>) -> Content {
        let len = bytes.len();
        let (mut content, outcome) = Content::parse(bytes);
        content.problem = match outcome {
            _ if self.cut_off => Some(BagProblem {
                offset: self.offset,
                what: format!("the file ends inside a chunk, of which {} messages could be read", content.messages.len()),
                bytes_lost: self.lost(len, outcome.err().map_or(len, |stop| stop.at)),
                remedy: REINDEX,
            }),
            Err(Stop { at, reason }) => Some(BagProblem {
                offset: self.offset,
                what: format!("a damaged chunk, read up to its byte {at} of {len}: {reason}"),
                bytes_lost: (len - at) as u64,
                remedy: COPY_AGAIN,
            }),
            Ok(()) if (len as u64) < self.size => Some(BagProblem {
                offset: self.offset,
                what: format!("a chunk said to be {} bytes holds {len} only", self.size),
                bytes_lost: self.size - len as u64,
                remedy: COPY_AGAIN,
            }),
            Ok(()) => None,
        };
        content
    }

    /// Bytes lost of a chunk that was cut off: of a packed one that gave nothing, all.
    fn lost(&self, len: usize, used: usize) -> u64 {
        if len == 0 { self.packed } else { (len - used) as u64 }
    }

    fn unusable(&self, what: String, remedy: &'static str) -> Content {
        let problem = BagProblem { offset: self.offset, what, bytes_lost: self.packed, remedy };
        Content { bytes: Vec::new(), messages: Vec::new(), connections: Vec::new(), problem: Some(problem) }
    }
}
