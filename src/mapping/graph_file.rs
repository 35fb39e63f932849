//! Saves and loads the pose graph of a map, to extend the map with more bags later.
//!
//! | bytes | what |
//! |---|---|
//! | 8 | `ATSMGRAF` |
//! | 4 | format version |
//! | 8 | total length of the sections |
//! | 4 | CRC-32 of the sections |
//! | | sections: name (4 letters), length (8 bytes), content |
//!
//! All numbers are little-endian. Sections with unknown names are skipped, so later programs may add some. The version is incremented
//! only if older programs would misread the sections they know.

use std::sync::Arc;

use flate2::Crc;
use nalgebra::Matrix3;
use thiserror::Error;

use super::trajectory::TrajectoryNode;
use super::{Edge, EdgeKind, GridScan, Keyframe, Mapper};
use crate::geometry::Pose2;
use crate::matching::MatchingKnobs;
use crate::matching::classic::rejection::RejectionKnobs;
use crate::scan::{BeamGeometry, Scan};
use crate::time::Stamp;

const MAGIC: &[u8; 8] = b"ATSMGRAF";
const VERSION: u32 = 1;
/// Size of the header before the sections, bytes.
const HEADER_SIZE: usize = 24;

/// Why a graph file cannot be loaded.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum GraphFileError {
    /// The file does not start with the magic number of graph files.
    #[error("not a graph file: give the PREFIX.graph written by `anytime map`")]
    NotAGraph,
    /// A newer program has written the file.
    #[error(
        "the file has version {found}, but this program reads up to version {VERSION}: use the program that wrote it, or a newer one"
    )]
    Version {
        /// Version of the file.
        found: u32,
    },
    /// The end of the file is missing.
    #[error("the file is cut off: it has {found} of {expected} bytes; build the map again from the bags, or use a complete copy")]
    CutOff {
        /// Size of the file, bytes.
        found: usize,
        /// Size according to the header, bytes.
        expected: u64,
    },
    /// The checksum is wrong, or a value is invalid.
    #[error("the file is damaged ({problem}): build the map again from the bags, or use a complete copy")]
    Damaged {
        /// What is wrong.
        problem: &'static str,
    },
}

const fn damaged(problem: &'static str) -> GraphFileError {
    GraphFileError::Damaged { problem }
}

impl Mapper {
    /// Serializes the graph.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut sections = Vec::new();
        let mut section = |name: &[u8; 4], content: Writer| {
            sections.extend_from_slice(name);
            sections.extend_from_slice(&(content.bytes.len() as u64).to_le_bytes());
            sections.extend(content.bytes);
        };
        section(b"KEYF", self.keyframe_section());
        section(b"EDGE", self.edge_section());
        section(b"DRAW", self.grid_scan_section());
        let mut crc = Crc::new();
        crc.update(&sections);
        let mut file = MAGIC.to_vec();
        file.extend(VERSION.to_le_bytes());
        file.extend((sections.len() as u64).to_le_bytes());
        file.extend(crc.sum().to_le_bytes());
        file.extend(sections);
        file
    }

    fn keyframe_section(&self) -> Writer {
        let mut out = Writer::default();
        out.count(self.keyframes.len());
        for (i, keyframe) in self.keyframes.iter().enumerate() {
            out.stamp(keyframe.stamp);
            out.count(keyframe.run);
            out.number(keyframe.path_length);
            out.number(self.distances_to_next[i]);
            for pose in [keyframe.odom_from_laser, self.dead_reckoned[i], self.graph.poses()[i]] {
                out.pose(&pose);
            }
            match &keyframe.view {
                Some(view) => out.scan(view.scan()),
                None => out.no_scan(),
            }
        }
        out
    }

    fn edge_section(&self) -> Writer {
        let mut out = Writer::default();
        out.count(self.graph.edges().len());
        for edge in self.graph.edges() {
            out.count(edge.from);
            out.count(edge.to);
            out.bytes.push(match edge.kind {
                EdgeKind::Odometry => 0,
                EdgeKind::Sequence => 1,
                EdgeKind::Loop => 2,
            });
            out.pose(&edge.motion);
            edge.covariance.iter().for_each(|&value| out.number(value));
        }
        out
    }

    fn grid_scan_section(&self) -> Writer {
        let mut out = Writer::default();
        out.count(self.grid_scans.iter().filter(|scan| !scan.points.is_empty()).count());
        for GridScan { node, points, .. } in self.grid_scans.iter().filter(|scan| !scan.points.is_empty()) {
            out.stamp(node.stamp);
            out.count(node.keyframe);
            out.number(node.distance);
            out.pose(&node.odom_from_base);
            out.pose(&node.odom_from_laser);
            out.count(points.len());
            points.as_flattened().iter().for_each(|&coordinate| out.short(coordinate));
        }
        out
    }

    /// Loads a graph. Scans added afterwards belong to a new run.
    pub fn from_bytes(bytes: &[u8], matching: &MatchingKnobs, rejection: &RejectionKnobs) -> Result<Self, GraphFileError> {
        let sections = checked_sections(bytes)?;
        let mut mapper = Self::new(matching, rejection);
        let mut reader = Reader { bytes: sections };
        while !reader.bytes.is_empty() {
            let (name, length) = (reader.take(4)?, reader.long()?);
            let content = reader.take(usize::try_from(length).map_err(|_| damaged("invalid length"))?)?;
            let mut content = Reader { bytes: content };
            match name {
                b"KEYF" => mapper.read_keyframes(&mut content)?,
                b"EDGE" => mapper.read_edges(&mut content)?,
                b"DRAW" => mapper.read_grid_scans(&mut content)?,
                _ => {}
            }
        }
        Ok(mapper)
    }

    fn read_keyframes(&mut self, content: &mut Reader) -> Result<(), GraphFileError> {
        let mut geometries = Vec::new();
        for _ in 0..content.count()? {
            let (stamp, run) = (content.stamp()?, content.count()?);
            let (path_length, distance_to_next) = (content.number()?, content.number()?);
            let [odom_from_laser, dead_reckoned, pose] = [content.pose()?, content.pose()?, content.pose()?];
            let view = content.scan(stamp, &mut geometries)?.map(|scan| self.matcher.view(scan));
            self.keyframes.push(Keyframe { stamp, odom_from_laser, view, run, path_length });
            self.dead_reckoned.push(dead_reckoned);
            self.distances_to_next.push(distance_to_next);
            self.graph.add_pose(pose);
        }
        Ok(())
    }

    fn read_edges(&mut self, content: &mut Reader) -> Result<(), GraphFileError> {
        for _ in 0..content.count()? {
            let (from, to) = (content.count()?, content.count()?);
            let kind = match content.take(1)? {
                [0] => EdgeKind::Odometry,
                [1] => EdgeKind::Sequence,
                [2] => EdgeKind::Loop,
                _ => return Err(damaged("unknown kind of edge")),
            };
            let motion = content.pose()?;
            let mut covariance = Matrix3::zeros();
            for value in &mut covariance {
                *value = content.number()?;
            }
            if from.max(to) >= self.keyframes.len() {
                return Err(damaged("an edge refers to a missing keyframe"));
            }
            self.graph.add_edge(Edge { from, to, motion, covariance, kind });
        }
        Ok(())
    }

    fn read_grid_scans(&mut self, content: &mut Reader) -> Result<(), GraphFileError> {
        for _ in 0..content.count()? {
            let (stamp, keyframe, distance) = (content.stamp()?, content.count()?, content.number()?);
            let (odom_from_base, odom_from_laser) = (content.pose()?, content.pose()?);
            if keyframe >= self.keyframes.len() {
                return Err(damaged("a scan refers to a missing keyframe"));
            }
            let count = content.count()?;
            let coordinates = content.take(count.checked_mul(8).ok_or(damaged("invalid length"))?)?;
            let (pairs, _) = coordinates.as_chunks::<8>();
            let points = pairs
                .iter()
                .map(|&[a, b, c, d, e, f, g, h]| [f32::from_le_bytes([a, b, c, d]), f32::from_le_bytes([e, f, g, h])])
                .collect();
            let node = TrajectoryNode { stamp, keyframe, odom_from_base, odom_from_laser, distance };
            self.grid_scans.push(GridScan { node, points, inserted_at: None });
        }
        Ok(())
    }
}

/// Checks header, length and checksum; returns the sections.
fn checked_sections(bytes: &[u8]) -> Result<&[u8], GraphFileError> {
    if !bytes.starts_with(MAGIC) {
        return Err(GraphFileError::NotAGraph);
    }
    let mut header = Reader { bytes: &bytes[MAGIC.len()..] };
    let cut_off = |expected: u64| GraphFileError::CutOff { found: bytes.len(), expected };
    if bytes.len() < HEADER_SIZE {
        return Err(cut_off(HEADER_SIZE as u64));
    }
    let found = u32::from_le_bytes(header.array()?);
    if found > VERSION {
        return Err(GraphFileError::Version { found });
    }
    let (length, sum) = (header.long()?, u32::from_le_bytes(header.array()?));
    let sections = usize::try_from(length).ok().and_then(|length| header.bytes.get(..length));
    let sections = sections.ok_or_else(|| cut_off(length.saturating_add(HEADER_SIZE as u64)))?;
    let mut crc = Crc::new();
    crc.update(sections);
    if crc.sum() == sum { Ok(sections) } else { Err(damaged("wrong checksum")) }
}

#[derive(Default)]
struct Writer {
    bytes: Vec<u8>,
}

impl Writer {
    fn count(&mut self, count: usize) {
        self.bytes.extend((count as u64).to_le_bytes());
    }

    fn stamp(&mut self, stamp: Stamp) {
        self.bytes.extend(stamp.nanoseconds().to_le_bytes());
    }

    fn number(&mut self, number: f64) {
        self.bytes.extend(number.to_le_bytes());
    }

    fn short(&mut self, number: f32) {
        self.bytes.extend(number.to_le_bytes());
    }

    fn pose(&mut self, pose: &Pose2) {
        for number in [pose.x, pose.y, pose.theta] {
            self.number(number);
        }
    }

    /// A scan that was dropped is saved as one without beams.
    fn no_scan(&mut self) {
        self.number(0.0);
        self.number(0.0);
        self.count(0);
        self.bytes.push(1);
    }

    /// Beams as start and increment if evenly spaced, else one by one; ranges with `inf` for rays without a return.
    #[allow(clippy::cast_possible_truncation)] // to single precision: micrometres
    fn scan(&mut self, scan: &Scan) {
        let beams = scan.beams();
        self.number(beams.angle(0));
        self.number(beams.angle_increment());
        self.count(scan.len());
        self.bytes.push(u8::from(beams.is_uniform()));
        if !beams.is_uniform() {
            beams.directions().iter().for_each(|direction| self.number(direction.y.atan2(direction.x)));
        }
        for (i, &range) in scan.ranges().iter().enumerate() {
            self.short(if scan.is_out_of_range(i) { f32::INFINITY } else { range as f32 });
        }
    }
}

struct Reader<'a> {
    bytes: &'a [u8],
}

impl<'a> Reader<'a> {
    fn take(&mut self, count: usize) -> Result<&'a [u8], GraphFileError> {
        let (taken, rest) = self.bytes.split_at_checked(count).ok_or(damaged("truncated section"))?;
        self.bytes = rest;
        Ok(taken)
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], GraphFileError> {
        let taken = self.take(N)?;
        taken.try_into().map_err(|_| damaged("truncated section"))
    }

    fn long(&mut self) -> Result<u64, GraphFileError> {
        Ok(u64::from_le_bytes(self.array()?))
    }

    /// A count or an index.
    fn count(&mut self) -> Result<usize, GraphFileError> {
        usize::try_from(self.long()?).map_err(|_| damaged("invalid count"))
    }

    fn stamp(&mut self) -> Result<Stamp, GraphFileError> {
        Ok(Stamp::from_nanoseconds(i64::from_le_bytes(self.array()?)))
    }

    fn number(&mut self) -> Result<f64, GraphFileError> {
        let number = f64::from_le_bytes(self.array()?);
        if number.is_finite() { Ok(number) } else { Err(damaged("number not finite")) }
    }

    fn pose(&mut self) -> Result<Pose2, GraphFileError> {
        Ok(Pose2::new(self.number()?, self.number()?, self.number()?))
    }

    /// The scan of a keyframe; `None` if it was dropped.
    fn scan(&mut self, stamp: Stamp, geometries: &mut Vec<Arc<BeamGeometry>>) -> Result<Option<Scan>, GraphFileError> {
        let (angle, increment, count) = (self.number()?, self.number()?, self.count()?);
        if count == 0 {
            return self.take(1).map(|_| None);
        }
        if count > crate::scan::MAX_BEAMS || increment == 0.0 {
            return Err(damaged("invalid beams of a scan"));
        }
        let is_even = self.take(1)? == [1];
        let beams = if is_even {
            shared_geometry(geometries, angle, increment, count)
        } else {
            let mut directions = Vec::with_capacity(count);
            for _ in 0..count {
                let (sin, cos) = self.number()?.sin_cos();
                directions.push([cos, sin].into());
            }
            Arc::new(BeamGeometry::with_directions(angle, increment, directions))
        };
        let mut ranges = Vec::with_capacity(count);
        for _ in 0..count {
            ranges.push(f64::from(f32::from_le_bytes(self.array()?)));
        }
        Scan::new(stamp, beams, (0.0, f64::MAX), ranges).map(Some).map_err(|_| damaged("invalid ranges of a scan"))
    }
}

/// Evenly spaced beams, shared by all scans with the same geometry.
fn shared_geometry(geometries: &mut Vec<Arc<BeamGeometry>>, angle: f64, increment: f64, count: usize) -> Arc<BeamGeometry> {
    let is_same = |beams: &&Arc<BeamGeometry>| {
        let numbers = [beams.angle(0), beams.angle_increment()];
        beams.len() == count && numbers.map(f64::to_bits) == [angle, increment].map(f64::to_bits)
    };
    if let Some(beams) = geometries.iter().rev().find(is_same) {
        return Arc::clone(beams);
    }
    geometries.push(Arc::new(BeamGeometry::new(angle, increment, count)));
    Arc::clone(&geometries[geometries.len() - 1])
}
