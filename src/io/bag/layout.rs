//! The first pass over a bag: from record header to record header, seeking past the chunks.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufReader, Read};

use super::chunk::{Chunk, ChunkIndex};
use super::compression::Compression;
use super::connection::Connection;
use super::error::{BagProblem, COPY_AGAIN, REINDEX};
use super::record::{Fields, op, stamp_from_bytes};

/// Largest record header believed. Real ones are far below 1 KiB: the longest text in them is a topic.
const MAX_HEADER_BYTES: u64 = 1 << 20;
/// Largest connection record believed. Its longest text is a message definition.
const MAX_CONNECTION_BYTES: u64 = 1 << 24;
/// A file of garbage would give a problem every few bytes.
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
                Err(Stop::Damage(what)) => {
                    let remedy = if pass.promised.index_at == 0 { REINDEX } else { COPY_AGAIN };
                    pass.layout.problems.push(BagProblem { offset, what, bytes_lost: len - offset, remedy });
                    break;
                }
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

/// Why the pass ends early.
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
                let connection = Connection::parse(fields, &data)?;
                self.layout.connections.entry(connection.id).or_insert(connection);
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

    /// The times of one connection's messages in the chunk before.
    fn index(&mut self, fields: Fields<'_>, data_len: u64) -> Result<(), Stop> {
        const ENTRY_BYTES: u64 = 12;
        let connection = fields.u32("conn")?;
        if fields.u32("ver")? != 1 {
            return Err(Stop::Damage("an index of an unknown version".into()));
        }
        if data_len != u64::from(fields.u32("count")?) * ENTRY_BYTES {
            return Err(Stop::Damage("an index whose length is not what its count says".into()));
        }
        self.check_remaining(data_len)?;
        for _ in 0..data_len / ENTRY_BYTES {
            let time = stamp_from_bytes(self.array()?);
            let _offset_in_chunk: [u8; 4] = self.array()?;
            if let Some(chunk) = self.layout.chunks.last_mut() {
                chunk.index.add(connection, time);
            }
        }
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
