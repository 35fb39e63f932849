//! An open bag: its chunks, connections and problems.

use std::cell::{Ref, RefCell};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};

use crate::knobs::nearest_name;
use crate::messages::Message;
use crate::time::Stamp;

use super::chunk::{Chunk, Content, PackedChunk};
use super::compression::Compression;
use super::connection::Connection;
use super::error::{BagError, BagProblem, COPY_AGAIN};
use super::layout::{Layout, MAX_PROBLEMS};
use super::record::MAGIC;

/// Number of bytes read to identify the format of a file.
const MAX_MAGIC_BYTES: u64 = 32;

/// A bag opened for reading.
///
/// ```no_run
/// use anytime_scan_matcher::io::bag::Bag;
/// use anytime_scan_matcher::messages::sensor_msgs::LaserScan;
///
/// let bag = Bag::open("drive.bag")?;
/// bag.expect_topic::<LaserScan>("/scan")?;
/// for message in bag.messages(Some(&["/scan"])) {
///     let scan: LaserScan = message?.decode()?;
/// }
/// for problem in bag.problems().iter() {
///     eprintln!("{problem}");
/// }
/// # Ok::<(), anytime_scan_matcher::io::bag::BagError>(())
/// ```
pub struct Bag {
    path: PathBuf,
    len: u64,
    file: RefCell<File>,
    chunks: Vec<Chunk>,
    connections: Vec<Connection>,
    problems: RefCell<Vec<BagProblem>>,
}

impl Bag {
    /// Opens a bag and reads its index. Decompresses only the chunks that the index does not describe.
    pub fn open(path: impl AsRef<Path>) -> Result<Self, BagError> {
        let path = path.as_ref();
        let mut file = File::open(path).map_err(BagError::io(path, "open"))?;
        let metadata = file.metadata().map_err(BagError::io(path, "read"))?;
        if metadata.is_dir() {
            return Err(directory_error(path));
        }
        check_magic(path, &mut file)?;
        let layout = Layout::read(&file, MAGIC.len() as u64, metadata.len()).map_err(BagError::io(path, "read"))?;
        if !layout.encryptor.is_empty() {
            return Err(BagError::Unsupported {
                path: path.into(),
                what: format!("an encrypted bag ({})", layout.encryptor),
                remedy: "make a decrypted copy with `rosbag decrypt` on a machine that has the key",
            });
        }
        let complete = layout.complete;
        let mut bag = Self {
            path: path.into(),
            len: metadata.len(),
            file: RefCell::new(file),
            chunks: layout.chunks,
            connections: Vec::new(),
            problems: RefCell::new(layout.problems),
        };
        bag.connections = bag.index(layout.connections, complete)?.into_values().collect();
        Ok(bag)
    }

    /// Completes the index: reads each chunk that has no index, or whose connections are not described by a record outside the
    /// chunks.
    fn index(&mut self, mut known: BTreeMap<u32, Connection>, complete: bool) -> Result<BTreeMap<u32, Connection>, BagError> {
        let last = self.chunks.len().saturating_sub(1);
        for i in 0..self.chunks.len() {
            let Chunk { index, has_bad_index, .. } = &self.chunks[i];
            let described = !has_bad_index && index.span.is_some() && index.counts.keys().all(|id| known.contains_key(id));
            // The file may end within the index records of its last chunk.
            if described && (complete || i < last) {
                continue;
            }
            let content = self.read_chunk(i)?;
            self.chunks[i].index = content.index();
            for connection in content.connections {
                known.entry(connection.id).or_insert(connection);
            }
        }
        for (id, count) in self.chunks.iter().flat_map(|chunk| &chunk.index.counts) {
            match known.get_mut(id) {
                Some(connection) => connection.messages += count,
                None => self.add_problem(BagProblem {
                    offset: 0,
                    what: format!("messages of connection {id} are lost: the record that gives their topic and type is missing"),
                    bytes_lost: 0,
                    remedy: COPY_AGAIN,
                }),
            }
        }
        Ok(known)
    }

    pub(super) fn read_chunk(&self, i: usize) -> Result<Content, BagError> {
        Ok(self.record_problem(self.read_packed(i)?.unpack()))
    }

    pub(super) fn read_packed(&self, i: usize) -> Result<PackedChunk, BagError> {
        self.chunks[i].location.read(&mut self.file.borrow_mut()).map_err(BagError::io(&self.path, "read"))
    }

    /// Moves the problem of a chunk, if it has one, to the problems of the bag.
    pub(super) fn record_problem(&self, mut content: Content) -> Content {
        if let Some(problem) = content.problem.take() {
            self.add_problem(problem);
        }
        content
    }

    fn add_problem(&self, problem: BagProblem) {
        let mut problems = self.problems.borrow_mut();
        if problems.len() < MAX_PROBLEMS && !problems.contains(&problem) {
            problems.push(problem);
        }
    }

    pub(super) fn chunks(&self) -> &[Chunk] {
        &self.chunks
    }

    /// Path of the file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Length of the file in bytes.
    pub fn size(&self) -> u64 {
        self.len
    }

    /// The connections, sorted by number.
    pub fn connections(&self) -> &[Connection] {
        &self.connections
    }

    /// The problems found so far. Problems of the bag's structure are found when it is opened, problems inside chunks as messages
    /// are read.
    pub fn problems(&self) -> Ref<'_, [BagProblem]> {
        Ref::map(self.problems.borrow(), Vec::as_slice)
    }

    /// Number of chunks by compression.
    pub fn compressions(&self) -> Vec<(Compression, usize)> {
        let count = |kind| self.chunks.iter().filter(|chunk| chunk.location.compression == kind).count();
        Compression::ALL.iter().map(|&kind| (kind, count(kind))).filter(|(_, chunks)| *chunks > 0).collect()
    }

    /// Recording times of the first and the last message; `None` without messages.
    pub fn span(&self) -> Option<(Stamp, Stamp)> {
        self.chunks.iter().filter_map(|chunk| chunk.index.span).reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))
    }

    /// Number of messages on `topics` (`None`: on all topics).
    pub fn message_count(&self, topics: Option<&[&str]>) -> u64 {
        self.connections_of(topics).map(|connection| connection.messages).sum()
    }

    /// The connections of `topics` (`None`: of all topics).
    pub(super) fn connections_of(&self, topics: Option<&[&str]>) -> impl Iterator<Item = &Connection> {
        self.connections.iter().filter(move |connection| is_wanted(topics, &connection.topic))
    }

    /// The topics that carry messages of type `T`.
    pub fn topics_of<T: Message>(&self) -> Vec<&str> {
        let mut topics: Vec<&str> = self.connections.iter().filter(|c| c.carries::<T>()).map(|c| c.topic.as_str()).collect();
        topics.sort_unstable();
        topics.dedup();
        topics
    }

    /// Checks that the bag has `topic` and that it carries messages of type `T`; the error lists the alternatives.
    pub fn expect_topic<T: Message>(&self, topic: &str) -> Result<(), BagError> {
        let mut connections = self.connections.iter().filter(|connection| connection.topic == topic).peekable();
        if connections.peek().is_none() {
            return Err(self.no_such_topic::<T>(topic));
        }
        connections.try_for_each(|connection| self.check_type::<T>(connection))
    }

    pub(super) fn check_type<T: Message>(&self, connection: &Connection) -> Result<(), BagError> {
        let (path, topic) = (self.path.clone(), connection.topic.clone());
        if connection.carries::<T>() {
            Ok(())
        } else if connection.message_type == T::TYPE {
            let found = connection.md5.clone();
            Err(BagError::WrongVersion { path, topic, message_type: T::TYPE, found, expected: &T::definition().md5 })
        } else {
            let found = connection.message_type.clone();
            Err(BagError::WrongType { path, topic, found, expected: T::TYPE })
        }
    }

    fn no_such_topic<T: Message>(&self, topic: &str) -> BagError {
        let mut candidates = self.topics_of::<T>();
        let nearest = nearest_name(topic, candidates.iter().copied());
        candidates.sort_by_key(|&candidate| Some(candidate) != nearest);
        let alternatives = if candidates.is_empty() {
            format!("no topic carries {}", T::TYPE)
        } else {
            format!("topics with {}: {}", T::TYPE, candidates.join(", "))
        };
        let damage = self.problems.borrow().first().map_or_else(String::new, |first| format!("; the bag is damaged: {first}"));
        BagError::NoSuchTopic { path: self.path.clone(), topic: topic.into(), alternatives: alternatives + &damage }
    }
}

fn is_wanted(topics: Option<&[&str]>, topic: &str) -> bool {
    topics.is_none_or(|topics| topics.contains(&topic))
}

/// Checks the first line of the file, and leaves the file position at the first record.
fn check_magic(path: &Path, file: &mut File) -> Result<(), BagError> {
    let mut start = Vec::new();
    file.take(MAX_MAGIC_BYTES).read_to_end(&mut start).map_err(BagError::io(path, "read"))?;
    if start.starts_with(MAGIC) {
        return file.seek(SeekFrom::Start(MAGIC.len() as u64)).map(|_| ()).map_err(BagError::io(path, "read"));
    }
    let path = path.into();
    if let Some(version) = start.strip_prefix(b"#ROSBAG V").or(start.strip_prefix(b"#ROSRECORD V")) {
        let version = version.split(|byte| *byte == b'\n').next().unwrap_or_default();
        let what = format!("a bag of version {}", String::from_utf8_lossy(version).trim_end());
        return Err(BagError::Unsupported { path, what, remedy: "convert it to version 2.0 with `rosbag fix OLD.bag NEW.bag`" });
    }
    let reason = match start.as_slice() {
        [] => "it is empty",
        start if MAGIC.starts_with(start) => "it ends within its first line",
        start if start.starts_with(b"SQLite format 3") => return Err(ros2_bag(path, "SQLite (.db3)")),
        start if start.starts_with(b"\x89MCAP") => return Err(ros2_bag(path, "MCAP (.mcap)")),
        _ if path.ends_with("metadata.yaml") => return Err(ros2_bag(path, "and this file is only its table of contents")),
        _ => "it does not begin with `#ROSBAG V2.0`",
    };
    Err(BagError::NotABag { path, reason: reason.into() })
}

fn ros2_bag(path: PathBuf, format: &str) -> BagError {
    let remedy = "convert it to a ROS 1 bag with `rosbags-convert` (pip install rosbags)";
    BagError::Unsupported { path, what: format!("a ROS 2 bag, {format}"), remedy }
}

fn directory_error(path: &Path) -> BagError {
    let is_ros2_file =
        |path: PathBuf| path.ends_with("metadata.yaml") || path.extension().is_some_and(|e| e == "db3" || e == "mcap");
    let mut entries = path.read_dir().into_iter().flatten().flatten();
    if entries.any(|entry| is_ros2_file(entry.path())) {
        return ros2_bag(path.into(), "a folder of metadata.yaml and .db3 or .mcap files");
    }
    BagError::NotABag { path: path.into(), reason: "it is a directory".into() }
}
