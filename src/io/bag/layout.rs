//! The first pass over a bag: reads the record headers and seeks past the chunks.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufReader, Read, Seek, SeekFrom};

use super::chunk::{Chunk, ChunkIndex, ChunkLocation};
use super::compression::Compression;
use super::connection::Connection;
use super::error::{BagProblem, COPY_AGAIN, REINDEX};
use super::record::{Fields, op, stamp_from_bytes};

/// Maximum size of a record header, bytes. Real ones are far below 1 KiB: the longest text in them is a topic.
const MAX_HEADER_BYTES: u64 = 1 << 20;
/// Maximum size of the data of a connection record, bytes. Its longest text is a message definition.
const MAX_CONNECTION_BYTES: u64 = 1 << 24;
/// Size of an entry of an index record, bytes: time of a message and its offset in the chunk.
const INDEX_ENTRY_BYTES: u64 = 12;
/// Maximum number of problems reported: a file of garbage has one every few bytes.
pub(super) const MAX_PROBLEMS: usize = 100;

/// The content of the records outside the chunks.
#[derive(Default)]
pub(super) struct Layout {
    /// In file order.
    pub(super) chunks: Vec<Chunk>,
    pub(super) connections: BTreeMap<u32, Connection>,
    pub(super) problems: Vec<BagProblem>,
    /// The bag has an index, and all of it could be read.
    pub(super) complete: bool,
    /// Name of the plugin that encrypted the chunks; empty if they are not encrypted.
    pub(super) encryptor: String,
}

impl Layout {
    /// Reads the layout, beginning with the first record at `start`; `len` is the length of the file.
    pub(super) fn read(file: &File, start: u64, len: u64) -> io::Result<Self> {
        let mut pass = Pass {
            input: BufReader::new(file),
            position: start,
            len,
            bag_header: BagHeader::default(),
            chunk_infos: 0,
            resume_points: None,
            layout: Self::default(),
        };
        loop {
            let offset = pass.position;
            if offset == len {
                break;
            }
            match pass.record() {
                Ok(()) => {}
                Err(Stop::Io(error)) => return Err(error),
                Err(Stop::Damage(what)) => pass.resume_after_damage(offset, what)?,
            }
        }
        Ok(pass.finish())
    }
}

/// The bag header record.
#[derive(Default)]
struct BagHeader {
    /// Offset of the index; 0 if it was never written.
    index_at: u64,
    /// Number of chunks.
    chunks: u32,
    /// Number of connection records.
    connections: u32,
}

/// Why a record could not be read.
enum Stop {
    Io(io::Error),
    Damage(String),
}

impl From<io::Error> for Stop {
    fn from(error: io::Error) -> Self {
        Self::Io(error)
    }
}

impl From<String> for Stop {
    fn from(what: String) -> Self {
        Self::Damage(what)
    }
}

struct Pass<'f> {
    input: BufReader<&'f File>,
    position: u64,
    len: u64,
    bag_header: BagHeader,
    chunk_infos: usize,
    /// Offsets where reading can resume after damage; `None` as long as no damage was found.
    resume_points: Option<Vec<u64>>,
    layout: Layout,
}

impl Pass<'_> {
    fn record(&mut self) -> Result<(), Stop> {
        let offset = self.position;
        let header_len = self.u32()?;
        let header = self.bytes(header_len, MAX_HEADER_BYTES)?;
        let data_len = self.u32()?;
        let fields = Fields(&header);
        match fields.op()? {
            op::BAG_HEADER => {
                self.bag_header = BagHeader {
                    index_at: fields.u64("index_pos")?,
                    chunks: fields.u32("chunk_count")?,
                    connections: fields.u32("conn_count")?,
                };
                self.layout.encryptor = fields.text("encryptor").unwrap_or_default().into_owned();
                self.skip(data_len)
            }
            op::CHUNK => self.chunk(offset, fields, data_len),
            op::INDEX => self.index(fields, data_len),
            op::CONNECTION => {
                let data = self.bytes(data_len, MAX_CONNECTION_BYTES)?;
                match Connection::parse(fields, &data) {
                    Ok(connection) => drop(self.layout.connections.entry(connection.id).or_insert(connection)),
                    Err(what) => {
                        let bytes_lost = self.position - offset;
                        self.problem(BagProblem { offset, what, bytes_lost, remedy: COPY_AGAIN });
                    }
                }
                Ok(())
            }
            op::CHUNK_INFO => {
                self.chunk_infos += 1;
                self.skip(data_len)
            }
            other => {
                self.skip(data_len)?;
                self.problem(BagProblem {
                    offset,
                    what: format!("a record of unexpected type {other} outside any chunk"),
                    bytes_lost: self.position - offset,
                    remedy: COPY_AGAIN,
                });
                Ok(())
            }
        }
    }

    /// Records the problem of an invalid record, and resumes at the next offset that the index at the end of the file gives.
    fn resume_after_damage(&mut self, offset: u64, what: String) -> io::Result<()> {
        if self.resume_points.is_none() {
            self.resume_points = Some(self.find_resume_points()?);
        }
        let ahead = self.resume_points.iter().flatten().copied().filter(|point| *point > offset);
        let next = ahead.min().unwrap_or(self.len);
        let remedy = if self.bag_header.index_at == 0 { REINDEX } else { COPY_AGAIN };
        self.problem(BagProblem { offset, what, bytes_lost: next - offset, remedy });
        self.mark_index_bad();
        self.seek_to(next)
    }

    /// Offsets of the index and of the chunks, as far as the file has them.
    fn find_resume_points(&mut self) -> io::Result<Vec<u64>> {
        let index_at = self.bag_header.index_at;
        if index_at == 0 || index_at >= self.len {
            return Ok(Vec::new());
        }
        let mut offsets = vec![index_at];
        self.seek_to(index_at)?;
        loop {
            match self.read_chunk_offset() {
                Ok(offset) => offsets.extend(offset.filter(|offset| *offset < self.len)),
                Err(Stop::Damage(_)) => return Ok(offsets),
                Err(Stop::Io(error)) => return Err(error),
            }
        }
    }

    /// Reads past a record. Returns the offset of the chunk if the record is a chunk info.
    fn read_chunk_offset(&mut self) -> Result<Option<u64>, Stop> {
        let header_len = self.u32()?;
        let header = self.bytes(header_len, MAX_HEADER_BYTES)?;
        let data_len = self.u32()?;
        self.skip(data_len)?;
        let fields = Fields(&header);
        Ok(if fields.op()? == op::CHUNK_INFO { Some(fields.u64("chunk_pos")?) } else { None })
    }

    fn chunk(&mut self, offset: u64, fields: Fields<'_>, data_len: u64) -> Result<(), Stop> {
        let size = u64::from(fields.u32("size")?);
        let remaining = self.len - self.position;
        // A recorder fills in the lengths of a chunk once it is full. If the recorder died before, they are still zero.
        let unfinished = data_len == 0 && size == 0 && self.bag_header.index_at == 0;
        let packed = if unfinished { remaining } else { data_len.min(remaining) };
        let name = fields.bytes("compression")?;
        if let Some(compression) = Compression::from_name(name) {
            let is_truncated = unfinished || data_len > remaining;
            let location = ChunkLocation { offset, data_offset: self.position, packed, size, compression, is_truncated };
            self.layout.chunks.push(Chunk { location, index: ChunkIndex::default(), has_bad_index: false });
        } else {
            self.problem(BagProblem {
                offset,
                what: format!("a chunk of unknown compression `{}`", String::from_utf8_lossy(name)),
                bytes_lost: packed,
                remedy: "decompress the bag with `rosbag decompress` on a machine that supports this compression",
            });
        }
        self.skip(packed)
    }

    /// Reads an index record: the times of one connection's messages in the preceding chunk. If it is invalid, nothing is lost:
    /// the chunk is read instead.
    fn index(&mut self, fields: Fields<'_>, data_len: u64) -> Result<(), Stop> {
        let start = self.position;
        if let (Ok(1), Ok(connection), Ok(count)) = (fields.u32("ver"), fields.u32("conn"), fields.u32("count")) {
            let entries = u64::from(count) * INDEX_ENTRY_BYTES;
            // An old recorder wrote a wrong data length. The entry count is right if another record follows after that many
            // entries.
            if entries == data_len || self.is_record_at(start + entries)? {
                return self.index_entries(connection, count);
            }
        }
        self.mark_index_bad();
        self.skip(data_len)
    }

    fn index_entries(&mut self, connection: u32, count: u32) -> Result<(), Stop> {
        self.check_remaining(u64::from(count) * INDEX_ENTRY_BYTES)?;
        for _ in 0..count {
            let time = stamp_from_bytes(self.array()?);
            let _offset_in_chunk: [u8; 4] = self.array()?;
            if let Some(chunk) = self.layout.chunks.last_mut() {
                chunk.index.add(connection, time);
            }
        }
        Ok(())
    }

    /// Makes the reader read the last chunk itself instead of relying on its index.
    fn mark_index_bad(&mut self) {
        if let Some(chunk) = self.layout.chunks.last_mut() {
            chunk.has_bad_index = true;
        }
    }

    /// Whether a record begins at `offset`, or the file ends there.
    fn is_record_at(&mut self, offset: u64) -> io::Result<bool> {
        let position = self.position;
        if offset >= self.len {
            return Ok(offset == self.len);
        }
        self.seek_to(offset)?;
        let header = self.u32().and_then(|len| self.bytes(len, MAX_HEADER_BYTES));
        let is_record = match header {
            Ok(header) => Fields(&header).op().is_ok(),
            Err(Stop::Damage(_)) => false,
            Err(Stop::Io(error)) => return Err(error),
        };
        self.seek_to(position)?;
        Ok(is_record)
    }

    fn seek_to(&mut self, offset: u64) -> io::Result<()> {
        self.input.seek(SeekFrom::Start(offset))?;
        self.position = offset;
        Ok(())
    }

    fn problem(&mut self, problem: BagProblem) {
        if self.layout.problems.len() < MAX_PROBLEMS {
            self.layout.problems.push(problem);
        }
    }

    fn finish(mut self) -> Layout {
        let BagHeader { index_at, chunks, connections } = self.bag_header;
        let found = (self.layout.chunks.len(), self.layout.connections.len(), self.chunk_infos);
        let complete = found.0 >= chunks as usize && found.1 >= connections as usize && found.2 >= chunks as usize;
        self.layout.complete = index_at != 0 && self.layout.problems.is_empty() && complete;
        if index_at == 0 {
            self.layout.problems.push(BagProblem {
                offset: 0,
                what: "the bag was not closed and has no index; its messages can still be read".into(),
                bytes_lost: 0,
                remedy: REINDEX,
            });
        } else if !complete {
            self.layout.problems.push(BagProblem {
                offset: self.len,
                what: format!(
                    "the file ends before its index does: it has {} of {chunks} chunks and {} of {connections} connection \
                     records",
                    found.0, found.1
                ),
                bytes_lost: index_at.saturating_sub(self.len),
                remedy: "copy the whole bag again, or run `rosbag reindex` on a copy of this file",
            });
        }
        self.layout
    }

    fn check_remaining(&self, len: u64) -> Result<(), Stop> {
        if len > self.len - self.position {
            return Err(Stop::Damage("the file ends inside a record".into()));
        }
        Ok(())
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], Stop> {
        let mut bytes = [0; N];
        self.check_remaining(N as u64)?;
        self.input.read_exact(&mut bytes)?;
        self.position += N as u64;
        Ok(bytes)
    }

    fn u32(&mut self) -> Result<u64, Stop> {
        self.array().map(|bytes| u64::from(u32::from_le_bytes(bytes)))
    }

    fn bytes(&mut self, len: u64, limit: u64) -> Result<Vec<u8>, Stop> {
        if len > limit {
            return Err(Stop::Damage(format!("a length field gives {len} bytes, but at most {limit} are allowed")));
        }
        self.check_remaining(len)?;
        let mut bytes = Vec::new();
        self.input.by_ref().take(len).read_to_end(&mut bytes)?;
        self.position += len;
        Ok(bytes)
    }

    fn skip(&mut self, len: u64) -> Result<(), Stop> {
        self.check_remaining(len)?;
        self.input.seek_relative(len.cast_signed())?;
        self.position += len;
        Ok(())
    }
}
