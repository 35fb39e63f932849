//! The first pass over a bag: from record header to record header, seeking past the chunks.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufReader, Read, Seek, SeekFrom};

use super::chunk::{Chunk, ChunkIndex};
use super::compression::Compression;
use super::connection::Connection;
use super::error::{BagProblem, COPY_AGAIN, REINDEX};
use super::record::{Fields, op, stamp_from_bytes};

/// Largest record header accepted. Real ones are far below 1 KiB: the longest text in them is a topic.
const MAX_HEADER_BYTES: u64 = 1 << 20;
/// Largest connection record accepted. Its longest text is a message definition.
const MAX_CONNECTION_BYTES: u64 = 1 << 24;
/// Time and place of a message in an index record.
const INDEX_ENTRY_BYTES: u64 = 12;
/// Problems reported at most: a file of garbage has one every few bytes.
pub(super) const MAX_PROBLEMS: usize = 100;

/// What the records outside of the chunks tell.
#[derive(Default)]
pub(super) struct Layout {
    /// In file order.
    pub(super) chunks: Vec<Chunk>,
    pub(super) connections: BTreeMap<u32, Connection>,
    pub(super) problems: Vec<BagProblem>,
    /// The index is there and was read to its end.
    pub(super) complete: bool,
    /// Name of the plugin that encrypted the chunks; empty when they are not.
    pub(super) encryptor: String,
}

impl Layout {
    /// Reads the layout from the first record on.
    pub(super) fn read(file: &File, start: u64, len: u64) -> io::Result<Self> {
        let mut pass = Pass {
            input: BufReader::new(file),
            position: start,
            len,
            promised: Promised::default(),
            chunk_infos: 0,
            landmarks: None,
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
                Err(Stop::Damage(what)) => pass.go_on_after(offset, what)?,
            }
        }
        Ok(pass.finish())
    }
}

/// What the bag header says there is.
#[derive(Default)]
struct Promised {
    /// Where the index begins; 0 when it was never written.
    index_at: u64,
    chunks: u32,
    connections: u32,
}

/// Why the pass ended early.
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
    promised: Promised,
    chunk_infos: usize,
    /// Where reading can resume after damage; `None` while there was none.
    landmarks: Option<Vec<u64>>,
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
                self.promised = Promised {
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
                    what: format!("a record of kind {other} outside of any chunk"),
                    bytes_lost: self.position - offset,
                    remedy: COPY_AGAIN,
                });
                Ok(())
            }
        }
    }

    /// Notes a record that makes no sense, and goes on at the next place that the index at the end knows.
    fn go_on_after(&mut self, offset: u64, what: String) -> io::Result<()> {
        if self.landmarks.is_none() {
            self.landmarks = Some(self.find_landmarks()?);
        }
        let ahead = self.landmarks.iter().flatten().copied().filter(|place| *place > offset);
        let next = ahead.min().unwrap_or(self.len);
        let remedy = if self.promised.index_at == 0 { REINDEX } else { COPY_AGAIN };
        self.problem(BagProblem { offset, what, bytes_lost: next - offset, remedy });
        self.doubt_index();
        self.go_to(next)
    }

    /// Where chunks begin, and the index, as far as the file has them.
    fn find_landmarks(&mut self) -> io::Result<Vec<u64>> {
        let index_at = self.promised.index_at;
        if index_at == 0 || index_at >= self.len {
            return Ok(Vec::new());
        }
        let mut places = vec![index_at];
        self.go_to(index_at)?;
        loop {
            match self.chunk_place() {
                Ok(place) => places.extend(place.filter(|place| *place < self.len)),
                Err(Stop::Damage(_)) => return Ok(places),
                Err(Stop::Io(error)) => return Err(error),
            }
        }
    }

    /// Reads past a record; tells where its chunk begins if it is a chunk info.
    fn chunk_place(&mut self) -> Result<Option<u64>, Stop> {
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
        // A recorder fills in the lengths of a chunk when it is full: those of the one it died in are still zero.
        let unfinished = data_len == 0 && size == 0 && self.promised.index_at == 0;
        let packed = if unfinished { remaining } else { data_len.min(remaining) };
        let name = fields.bytes("compression")?;
        if let Some(compression) = Compression::from_name(name) {
            self.layout.chunks.push(Chunk {
                offset,
                data_offset: self.position,
                packed,
                size,
                compression,
                cut_off: unfinished || data_len > remaining,
                index: ChunkIndex::default(),
                badly_indexed: false,
            });
        } else {
            self.problem(BagProblem {
                offset,
                what: format!("a chunk packed by an unknown method `{}`", String::from_utf8_lossy(name)),
                bytes_lost: packed,
                remedy: "repack it with `rosbag decompress` where the method is known",
            });
        }
        self.skip(packed)
    }

    /// The times of one connection's messages in the chunk before. An index that cannot be read costs nothing: its chunk is read instead.
    fn index(&mut self, fields: Fields<'_>, data_len: u64) -> Result<(), Stop> {
        let start = self.position;
        if let (Ok(1), Ok(connection), Ok(count)) = (fields.u32("ver"), fields.u32("conn"), fields.u32("count")) {
            let entries = u64::from(count) * INDEX_ENTRY_BYTES;
            // An old recorder wrote another length than that of the entries: the count holds where a record comes after so many.
            if entries == data_len || self.is_record(start + entries)? {
                return self.index_entries(connection, count);
            }
        }
        self.doubt_index();
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

    /// The last chunk is to be read, whatever its index says.
    fn doubt_index(&mut self) {
        if let Some(chunk) = self.layout.chunks.last_mut() {
            chunk.badly_indexed = true;
        }
    }

    /// Whether a record begins at `place`, or the file ends there.
    fn is_record(&mut self, place: u64) -> io::Result<bool> {
        let back = self.position;
        if place >= self.len {
            return Ok(place == self.len);
        }
        self.go_to(place)?;
        let header = self.u32().and_then(|len| self.bytes(len, MAX_HEADER_BYTES));
        let is_record = match header {
            Ok(header) => Fields(&header).op().is_ok(),
            Err(Stop::Damage(_)) => false,
            Err(Stop::Io(error)) => return Err(error),
        };
        self.go_to(back)?;
        Ok(is_record)
    }

    fn go_to(&mut self, place: u64) -> io::Result<()> {
        self.input.seek(SeekFrom::Start(place))?;
        self.position = place;
        Ok(())
    }

    fn problem(&mut self, problem: BagProblem) {
        if self.layout.problems.len() < MAX_PROBLEMS {
            self.layout.problems.push(problem);
        }
    }

    fn finish(mut self) -> Layout {
        let Promised { index_at, chunks, connections } = self.promised;
        let found = (self.layout.chunks.len(), self.layout.connections.len(), self.chunk_infos);
        let complete = found.0 >= chunks as usize && found.1 >= connections as usize && found.2 >= chunks as usize;
        self.layout.complete = index_at != 0 && self.layout.problems.is_empty() && complete;
        if index_at == 0 {
            self.layout.problems.push(BagProblem {
                offset: 0,
                what: "the bag was not closed and has no index; its messages can be read without".into(),
                bytes_lost: 0,
                remedy: REINDEX,
            });
        } else if !complete {
            self.layout.problems.push(BagProblem {
                offset: self.len,
                what: format!(
                    "the file ends before its index does: {} of {chunks} chunks and {} of {connections} connection records are there",
                    found.0, found.1
                ),
                bytes_lost: index_at.saturating_sub(self.len),
                remedy: "copy the whole bag again, or `rosbag reindex` a copy of this part",
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
            return Err(Stop::Damage(format!("a length of {len} bytes where at most {limit} make sense")));
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
