//! Chunks: the blocks of messages that a bag consists of, usually compressed.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::ops::Range;

use crate::time::Stamp;

use super::compression::Compression;
use super::connection::Connection;
use super::error::{BagProblem, COPY_AGAIN, REINDEX};
use super::record::{Fields, op, split_block};

/// Maximum size of a chunk that is read, compressed or decompressed, bytes. Recorders begin a new chunk after 768 KiB; only a
/// larger message makes a larger chunk.
const MAX_CHUNK_BYTES: u64 = 512 << 20;

/// A chunk of the file, and a summary of its messages.
pub(super) struct Chunk {
    pub(super) location: ChunkLocation,
    /// Summary of its messages: from the bag's index, or from reading the chunk.
    pub(super) index: ChunkIndex,
    /// One of its index records could not be read, so that the chunk itself must be read to know its messages.
    pub(super) has_bad_index: bool,
}

/// Where a chunk is in the file, and what is needed to decompress it.
#[derive(Clone, Copy)]
pub(super) struct ChunkLocation {
    /// Start of its record, bytes from the start of the file.
    pub(super) offset: u64,
    /// Start of its compressed data, bytes from the start of the file.
    pub(super) data_offset: u64,
    /// Number of compressed bytes that are in the file.
    pub(super) packed: u64,
    /// Number of decompressed bytes; 0 if the recorder died before writing it.
    pub(super) size: u64,
    pub(super) compression: Compression,
    /// The file ends before the chunk does.
    pub(super) is_truncated: bool,
}

/// Summary of the messages of a chunk.
#[derive(Default)]
pub(super) struct ChunkIndex {
    /// Number of messages by connection.
    pub(super) counts: BTreeMap<u32, u64>,
    /// Recording times of the first and the last message; `None` without messages.
    pub(super) span: Option<(Stamp, Stamp)>,
}

impl ChunkIndex {
    pub(super) fn add(&mut self, connection: u32, time: Stamp) {
        *self.counts.entry(connection).or_default() += 1;
        self.span = Some(self.span.map_or((time, time), |(start, end)| (start.min(time), end.max(time))));
    }
}

/// A decompressed chunk.
#[derive(Default)]
pub(super) struct Content {
    pub(super) bytes: Vec<u8>,
    /// Its messages in file order.
    pub(super) messages: Vec<Entry>,
    pub(super) connections: Vec<Connection>,
    /// The part of the chunk that could not be read, if any.
    pub(super) problem: Option<BagProblem>,
}

/// A message within the bytes of a chunk.
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

    /// Parses records up to the first invalid one.
    fn parse(bytes: Vec<u8>) -> (Self, Result<(), ParseError>) {
        let mut content = Self::default();
        let mut at = 0;
        let outcome = loop {
            if at == bytes.len() {
                break Ok(());
            }
            match content.parse_record(&bytes, at) {
                Ok(next) => at = next,
                Err(reason) => break Err(ParseError { at, reason }),
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
            // If a connection record is invalid, only the messages of that connection are lost, which is reported elsewhere.
            op::CONNECTION => self.connections.extend(Connection::parse(fields, data)),
            other => return Err(format!("a record of type {other} does not belong in a chunk")),
        }
        Ok(end)
    }
}

/// Where and why the parsing of a chunk stopped.
struct ParseError {
    /// Offset of the invalid record, bytes from the start of the decompressed chunk.
    at: usize,
    reason: String,
}

impl ChunkLocation {
    /// Reads the compressed bytes of the chunk. Returns `Err` only for errors of the file system.
    pub(super) fn read(self, file: &mut File) -> io::Result<PackedChunk> {
        let mut bytes = Vec::new();
        if !self.is_too_large() {
            file.seek(SeekFrom::Start(self.data_offset))?;
            file.take(self.packed).read_to_end(&mut bytes)?;
        }
        Ok(PackedChunk { bytes, location: self })
    }

    /// Maximum memory that decompressing the chunk takes, bytes.
    pub(super) fn memory_bytes(self) -> u64 {
        match self {
            _ if self.is_too_large() => 0,
            Self { is_truncated: true, .. } => MAX_CHUNK_BYTES,
            Self { packed, size, .. } => packed + size,
        }
    }

    /// Whether the chunk exceeds [`MAX_CHUNK_BYTES`], so that its bytes are not read.
    fn is_too_large(self) -> bool {
        self.packed.max(self.size) > MAX_CHUNK_BYTES
    }

    /// Decompresses and parses these bytes of the chunk.
    fn unpack(self, bytes: Vec<u8>) -> Content {
        if self.is_too_large() {
            let what = format!(
                "a chunk is too large: {} bytes, {} decompressed; the maximum is {MAX_CHUNK_BYTES}",
                self.packed, self.size
            );
            return self.unusable(what, "`rosbag filter IN OUT True` writes chunks of the usual size");
        }
        // The header of a chunk that the recorder did not finish does not state its size.
        let limit = if self.is_truncated { MAX_CHUNK_BYTES } else { self.size };
        let (bytes, unpacked) = self.compression.unpack(bytes, limit);
        match unpacked {
            // Without the checksum at the end, none of the bytes can be trusted.
            Err(error) if !self.is_truncated => {
                self.unusable(format!("a damaged {} chunk ({error})", self.compression.name()), COPY_AGAIN)
            }
            _ => self.parse(bytes),
        }
    }

    fn parse(self, bytes: Vec<u8>) -> Content {
        let len = bytes.len();
        let (mut content, outcome) = Content::parse(bytes);
        content.problem = match outcome {
            _ if self.is_truncated => Some(BagProblem {
                offset: self.offset,
                what: format!("the file ends inside a chunk; {} of its messages could be read", content.messages.len()),
                bytes_lost: self.bytes_lost(len, outcome.err().map_or(len, |error| error.at)),
                remedy: REINDEX,
            }),
            Err(ParseError { at, reason }) => Some(BagProblem {
                offset: self.offset,
                what: format!("a damaged chunk, readable only up to byte {at} of {len}: {reason}"),
                bytes_lost: (len - at) as u64,
                remedy: COPY_AGAIN,
            }),
            Ok(()) if (len as u64) < self.size => Some(BagProblem {
                offset: self.offset,
                what: format!("a chunk should have {} bytes, but has only {len}", self.size),
                bytes_lost: self.size - len as u64,
                remedy: COPY_AGAIN,
            }),
            Ok(()) => None,
        };
        content
    }

    /// Bytes lost of a truncated chunk: all compressed bytes if nothing could be decompressed.
    fn bytes_lost(self, len: usize, used: usize) -> u64 {
        if len == 0 { self.packed } else { (len - used) as u64 }
    }

    fn unusable(self, what: String, remedy: &'static str) -> Content {
        let problem = BagProblem { offset: self.offset, what, bytes_lost: self.packed, remedy };
        Content { problem: Some(problem), ..Content::default() }
    }
}

/// The compressed bytes of a chunk, which can be decompressed on any thread.
pub(super) struct PackedChunk {
    bytes: Vec<u8>,
    location: ChunkLocation,
}

impl PackedChunk {
    /// Decompresses and parses the chunk. Damage is reported in [`Content::problem`].
    pub(super) fn unpack(self) -> Content {
        self.location.unpack(self.bytes)
    }
}
