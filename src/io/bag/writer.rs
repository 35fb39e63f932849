//! Writes bags: chunks with their indices, then connections and chunk infos, and finally the bag header again with the offset of
//! these.

use std::collections::BTreeMap;
use std::io::{Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use crate::messages::{self, Message};
use crate::output::OutputFile;
use crate::time::Stamp;

use super::compression::Compression;
use super::error::BagError;
use super::record::{MAGIC, op, push_header, push_record, stamp_to_bytes};

/// A chunk is closed once it is larger than this, bytes: the default of `rosbag record`.
const CHUNK_BYTES: usize = 768 << 10;
/// Maximum size of a message, bytes, so that every chunk stays readable.
const MAX_MESSAGE_BYTES: usize = 256 << 20;
/// Total size of the fields and the padding of the bag header, bytes: fixed, so that the header can be rewritten in place.
const BAG_HEADER_BYTES: usize = 4096;

/// A bag being written. The same messages always give the same bytes.
///
/// Without [`BagWriter::finish`], a bag created by [`BagWriter::create`] contains all messages but no index: readers report that,
/// and `rosbag reindex` repairs it. A bag created by [`BagWriter::create_whole`] does not exist until it is finished.
pub struct BagWriter {
    path: PathBuf,
    file: OutputFile,
    compression: Compression,
    /// Number of bytes written to the file.
    position: u64,
    connections: Vec<Connection>,
    chunk: OpenChunk,
    chunks: Vec<ChunkInfo>,
    /// [`BagWriter::finish`] was called.
    finished: bool,
}

struct Connection {
    topic: String,
    message_type: &'static str,
    latching: bool,
    /// The complete connection record.
    record: Vec<u8>,
}

/// The chunk being filled.
#[derive(Default)]
struct OpenChunk {
    bytes: Vec<u8>,
    /// Time and offset in the chunk of each message, by connection.
    index: BTreeMap<u32, Vec<(Stamp, u32)>>,
}

/// Entry of the index at the end of the bag: one for each chunk.
struct ChunkInfo {
    offset: u64,
    span: (Stamp, Stamp),
    /// Number of messages by connection.
    counts: Vec<(u32, u32)>,
}

impl BagWriter {
    /// Creates or truncates the file. Like a recorder, it leaves a usable bag even if it is never finished.
    pub fn create(path: impl AsRef<Path>, compression: Compression) -> Result<Self, BagError> {
        let path = path.as_ref();
        Self::begin(path, OutputFile::create_in_place(path).map_err(BagError::io(path, "create"))?, compression)
    }

    /// Begins a bag that appears at `path` only when it is finished; an existing file is kept until then.
    pub fn create_whole(path: impl AsRef<Path>, compression: Compression) -> Result<Self, BagError> {
        let path = path.as_ref();
        Self::begin(path, OutputFile::create(path).map_err(BagError::io(path, "create"))?, compression)
    }

    fn begin(path: &Path, file: OutputFile, compression: Compression) -> Result<Self, BagError> {
        let mut writer = Self {
            path: path.to_path_buf(),
            file,
            compression,
            position: 0,
            connections: Vec::new(),
            chunk: OpenChunk::default(),
            chunks: Vec::new(),
            finished: false,
        };
        let mut start = MAGIC.to_vec();
        start.extend(writer.bag_header(0));
        writer.append(&start)?;
        Ok(writer)
    }

    /// Writes a message as received at `time`.
    pub fn write<T: Message>(&mut self, topic: &str, time: Stamp, message: &T) -> Result<(), BagError> {
        self.push(topic, false, time, message)
    }

    /// Writes a message on a latched topic (`/tf_static`, `/map`): on playback, late subscribers get it, too.
    pub fn write_latched<T: Message>(&mut self, topic: &str, time: Stamp, message: &T) -> Result<(), BagError> {
        self.push(topic, true, time, message)
    }

    /// Writes the last chunk and the index, and moves the file to its path.
    pub fn finish(mut self) -> Result<(), BagError> {
        self.finished = true;
        self.close_chunk()?;
        let index_at = self.position;
        let mut index: Vec<u8> = self.connections.iter().flat_map(|connection| connection.record.iter().copied()).collect();
        for chunk in &self.chunks {
            chunk.push_record(&mut index);
        }
        self.append(&index)?;
        let header = self.bag_header(index_at);
        self.file.seek(SeekFrom::Start(MAGIC.len() as u64)).map_err(BagError::io(&self.path, "write"))?;
        self.append(&header)?;
        self.file.commit().map_err(BagError::io(&self.path, "write"))
    }

    fn push<T: Message>(&mut self, topic: &str, latching: bool, time: Stamp, message: &T) -> Result<(), BagError> {
        let data = messages::encode(message).map_err(|e| self.unwritable(topic, e.to_string()))?;
        if data.len() > MAX_MESSAGE_BYTES {
            return Err(self.unwritable(topic, format!("a message of {} bytes is too large", data.len())));
        }
        // The ROS readers treat time 0 as "no time" and skip such messages.
        if time <= Stamp::default() || Stamp::from(messages::Time::from(time)) != time {
            return Err(
                self.unwritable(topic, format!("the time {time} is outside the range that a bag supports (1970 to 2106)"))
            );
        }
        let id = self.connection::<T>(topic, latching)?;
        let at = u32::try_from(self.chunk.bytes.len()).unwrap_or(u32::MAX);
        self.chunk.index.entry(id).or_default().push((time, at));
        let fields: &[(&str, &[u8])] = &[("op", &[op::MESSAGE]), ("conn", &id.to_le_bytes()), ("time", &stamp_to_bytes(time))];
        push_record(&mut self.chunk.bytes, fields, &data);
        if self.chunk.bytes.len() > CHUNK_BYTES {
            self.close_chunk()?;
        }
        Ok(())
    }

    /// The number of the connection; the record of a new connection is added to the chunk.
    fn connection<T: Message>(&mut self, topic: &str, latching: bool) -> Result<u32, BagError> {
        if let Some(other) = self.connections.iter().find(|c| c.topic == topic && c.message_type != T::TYPE) {
            return Err(self.unwritable(topic, format!("the topic already carries {}, not {}", other.message_type, T::TYPE)));
        }
        let known = self.connections.iter().position(|c| c.topic == topic && c.latching == latching);
        let id = u32::try_from(known.unwrap_or(self.connections.len())).unwrap_or(u32::MAX);
        if known.is_none() {
            let connection = Connection::new::<T>(id, topic, latching);
            self.chunk.bytes.extend_from_slice(&connection.record);
            self.connections.push(connection);
        }
        Ok(id)
    }

    fn close_chunk(&mut self) -> Result<(), BagError> {
        let chunk = std::mem::take(&mut self.chunk);
        let Some(info) = ChunkInfo::new(self.position, &chunk.index) else { return Ok(()) };
        let packed = self.compression.pack(&chunk.bytes).map_err(BagError::io(&self.path, "compress a chunk of"))?;
        let size = u32::try_from(chunk.bytes.len()).unwrap_or(u32::MAX).to_le_bytes();
        let mut records = Vec::new();
        let fields: &[(&str, &[u8])] =
            &[("op", &[op::CHUNK]), ("compression", self.compression.name().as_bytes()), ("size", &size)];
        push_record(&mut records, fields, &packed);
        for ((id, count), entries) in info.counts.iter().zip(chunk.index.values()) {
            let fields: &[(&str, &[u8])] = &[
                ("op", &[op::INDEX]),
                ("ver", &1_u32.to_le_bytes()),
                ("conn", &id.to_le_bytes()),
                ("count", &count.to_le_bytes()),
            ];
            let data: Vec<u8> =
                entries.iter().flat_map(|(time, at)| stamp_to_bytes(*time).into_iter().chain(at.to_le_bytes())).collect();
            push_record(&mut records, fields, &data);
        }
        self.chunks.push(info);
        self.append(&records)
    }

    fn bag_header(&self, index_at: u64) -> Vec<u8> {
        let count = |len: usize| u32::try_from(len).unwrap_or(u32::MAX).to_le_bytes();
        let fields: &[(&str, &[u8])] = &[
            ("op", &[op::BAG_HEADER]),
            ("index_pos", &index_at.to_le_bytes()),
            ("conn_count", &count(self.connections.len())),
            ("chunk_count", &count(self.chunks.len())),
        ];
        let mut record = Vec::new();
        push_header(&mut record, fields);
        let padding = (BAG_HEADER_BYTES + size_of::<u32>()).saturating_sub(record.len());
        record.extend_from_slice(&u32::try_from(padding).unwrap_or(0).to_le_bytes());
        record.resize(record.len() + padding, b' ');
        record
    }

    fn append(&mut self, bytes: &[u8]) -> Result<(), BagError> {
        self.file.write_all(bytes).map_err(BagError::io(&self.path, "write"))?;
        self.position += bytes.len() as u64;
        Ok(())
    }

    fn unwritable(&self, topic: &str, reason: String) -> BagError {
        BagError::Unwritable { path: self.path.clone(), topic: topic.into(), reason }
    }
}

impl Drop for BagWriter {
    fn drop(&mut self) {
        if !self.finished {
            // An error cannot be reported from here.
            let _ = self.close_chunk();
        }
    }
}

impl Connection {
    fn new<T: Message>(id: u32, topic: &str, latching: bool) -> Self {
        let definition = T::definition();
        let mut fields: Vec<(&str, &[u8])> = vec![
            ("topic", topic.as_bytes()),
            ("type", T::TYPE.as_bytes()),
            ("md5sum", definition.md5.as_bytes()),
            ("message_definition", definition.text.as_bytes()),
        ];
        if latching {
            fields.push(("latching", b"1"));
        }
        let mut record = Vec::new();
        push_header(&mut record, &[("op", &[op::CONNECTION]), ("conn", &id.to_le_bytes()), ("topic", topic.as_bytes())]);
        // The data of this record is itself a header; the length of the header serves as the length of the data.
        push_header(&mut record, &fields);
        Self { topic: topic.into(), message_type: T::TYPE, latching, record }
    }
}

impl ChunkInfo {
    /// `None` for a chunk without messages.
    fn new(offset: u64, index: &BTreeMap<u32, Vec<(Stamp, u32)>>) -> Option<Self> {
        let times = || index.values().flatten().map(|(time, _)| *time);
        let counts = index.iter().map(|(id, entries)| (*id, u32::try_from(entries.len()).unwrap_or(u32::MAX))).collect();
        Some(Self { offset, span: (times().min()?, times().max()?), counts })
    }

    fn push_record(&self, out: &mut Vec<u8>) {
        let count = u32::try_from(self.counts.len()).unwrap_or(u32::MAX);
        let fields: &[(&str, &[u8])] = &[
            ("op", &[op::CHUNK_INFO]),
            ("ver", &1_u32.to_le_bytes()),
            ("chunk_pos", &self.offset.to_le_bytes()),
            ("start_time", &stamp_to_bytes(self.span.0)),
            ("end_time", &stamp_to_bytes(self.span.1)),
            ("count", &count.to_le_bytes()),
        ];
        let data: Vec<u8> =
            self.counts.iter().flat_map(|(id, count)| id.to_le_bytes().into_iter().chain(count.to_le_bytes())).collect();
        push_record(out, fields, &data);
    }
}
