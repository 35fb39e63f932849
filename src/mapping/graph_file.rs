//! A map's graph as a file, to go on with: more bags, another day.
//!
//! | bytes | what |
//! |---|---|
//! | 8 | `ATSMGRAF` |
//! | 4 | version of what follows |
//! | 8 | length of the sections |
//! | 4 | their CRC-32 |
//! | | sections: 4 letters, 8 bytes of length, content |
//!
//! All numbers are little-endian. A section of an unknown name is passed over, so that later versions may add some; the version grows only when
//! older programs would misread what they know.

use std::sync::Arc;

use flate2::Crc;
use nalgebra::Matrix3;
use thiserror::Error;

use super::trajectory::Step;
use super::{Drawn, Edge, EdgeKind, Keyframe, Mapper};
use crate::geometry::Pose2;
use crate::matching::MatchingKnobs;
use crate::matching::classic::rejection::RejectionKnobs;
use crate::scan::{BeamGeometry, Scan};
use crate::time::Stamp;

const MAGIC: &[u8; 8] = b"ATSMGRAF";
const VERSION: u32 = 1;
/// Bytes before the sections.
const HEADER: usize = 24;

/// Why bytes are no graph.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum GraphFileError {
    /// They are something else.
    #[error("this is no graph file: give the PREFIX.graph that `anytime map` has written")]
    NotAGraph,
    /// A later program has written them.
    #[error(
        "it is of version {found}, and this program reads up to {VERSION}: use the program that has written it, or a newer one"
    )]
    Version {
        /// Its version.
        found: u32,
    },
    /// The end is missing.
    #[error("it is cut off: {found} of {expected} bytes are there; make the map anew from the bags, or take a whole copy")]
    CutOff {
        /// Bytes there are.
        found: usize,
        /// Bytes there should be.
        expected: u64,
    },
    /// The checksum does not fit, or a number is out of its range.
    #[error("it is damaged ({problem}): make the map anew from the bags, or take a whole copy")]
    Damaged {
        /// What does not fit.
        problem: &'static str,
    },
}

const fn damaged(problem: &'static str) -> GraphFileError {
    GraphFileError::Damaged { problem }
}

impl Mapper {
    /// The graph as the bytes of a file.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut sections = Vec::new();
        let mut section = |name: &[u8; 4], content: Writer| {
            sections.extend_from_slice(name);
            sections.extend_from_slice(&(content.bytes.len() as u64).to_le_bytes());
            sections.extend(content.bytes);
        };
        section(b"KEYF", self.keyframe_section());
        section(b"EDGE", self.edge_section());
        section(b"DRAW", self.drawn_section());
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
            out.number(keyframe.way);
            out.number(self.ways[i]);
            for pose in [keyframe.odom_from_laser, self.by_odometry[i], self.graph.poses()[i]] {
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

    fn drawn_section(&self) -> Writer {
        let mut out = Writer::default();
        out.count(self.drawn.iter().filter(|drawn| !drawn.points.is_empty()).count());
        for Drawn { step, points, .. } in self.drawn.iter().filter(|drawn| !drawn.points.is_empty()) {
            out.stamp(step.stamp);
            out.count(step.keyframe);
            out.number(step.way);
            out.pose(&step.odom_from_base);
            out.pose(&step.odom_from_laser);
            out.count(points.len());
            points.as_flattened().iter().for_each(|&coordinate| out.short(coordinate));
        }
        out
    }

    /// The graph that a file holds. What follows is another run.
    pub fn from_bytes(bytes: &[u8], matching: &MatchingKnobs, rejection: &RejectionKnobs) -> Result<Self, GraphFileError> {
        let sections = checked_sections(bytes)?;
        let mut mapper = Self::new(matching, rejection);
        let mut reader = Reader { bytes: sections };
        while !reader.bytes.is_empty() {
            let (name, length) = (reader.take(4)?, reader.long()?);
            let content = reader.take(usize::try_from(length).map_err(|_| damaged("a length"))?)?;
            let mut content = Reader { bytes: content };
            match name {
                b"KEYF" => mapper.read_keyframes(&mut content)?,
                b"EDGE" => mapper.read_edges(&mut content)?,
                b"DRAW" => mapper.read_drawn(&mut content)?,
                _ => {}
            }
        }
        Ok(mapper)
    }

    fn read_keyframes(&mut self, content: &mut Reader) -> Result<(), GraphFileError> {
        let mut geometries = Vec::new();
        for _ in 0..content.count()? {
            let (stamp, run) = (content.stamp()?, content.count()?);
            let (way, way_to_next) = (content.number()?, content.number()?);
            let [odom_from_laser, by_odometry, pose] = [content.pose()?, content.pose()?, content.pose()?];
            let view = content.scan(stamp, &mut geometries)?.map(|scan| self.matcher.view(scan));
            self.keyframes.push(Keyframe { stamp, odom_from_laser, view, run, way });
            self.by_odometry.push(by_odometry);
            self.ways.push(way_to_next);
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
                _ => return Err(damaged("the kind of an edge")),
            };
            let motion = content.pose()?;
            let mut covariance = Matrix3::zeros();
            for value in &mut covariance {
                *value = content.number()?;
            }
            if from.max(to) >= self.keyframes.len() {
                return Err(damaged("an edge leads to no keyframe"));
            }
            self.graph.add_edge(Edge { from, to, motion, covariance, kind });
        }
        Ok(())
    }

    fn read_drawn(&mut self, content: &mut Reader) -> Result<(), GraphFileError> {
        for _ in 0..content.count()? {
            let (stamp, keyframe, way) = (content.stamp()?, content.count()?, content.number()?);
            let (odom_from_base, odom_from_laser) = (content.pose()?, content.pose()?);
            if keyframe >= self.keyframes.len() {
                return Err(damaged("a scan is of no keyframe"));
            }
            let count = content.count()?;
            let coordinates = content.take(count.checked_mul(8).ok_or(damaged("a length"))?)?;
            let (pairs, _) = coordinates.as_chunks::<8>();
            let points = pairs
                .iter()
                .map(|&[a, b, c, d, e, f, g, h]| [f32::from_le_bytes([a, b, c, d]), f32::from_le_bytes([e, f, g, h])])
                .collect();
            let step = Step { stamp, keyframe, odom_from_base, odom_from_laser, way };
            self.drawn.push(Drawn { step, points, at: None });
        }
        Ok(())
    }
}

/// The sections of a file that is whole and of a version that can be read.
fn checked_sections(bytes: &[u8]) -> Result<&[u8], GraphFileError> {
    if !bytes.starts_with(MAGIC) {
        return Err(GraphFileError::NotAGraph);
    }
    let mut header = Reader { bytes: &bytes[MAGIC.len()..] };
    let cut_off = |expected: u64| GraphFileError::CutOff { found: bytes.len(), expected };
    if bytes.len() < HEADER {
        return Err(cut_off(HEADER as u64));
    }
    let found = u32::from_le_bytes(header.array()?);
    if found > VERSION {
        return Err(GraphFileError::Version { found });
    }
    let (length, sum) = (header.long()?, u32::from_le_bytes(header.array()?));
    let sections = usize::try_from(length).ok().and_then(|length| header.bytes.get(..length));
    let sections = sections.ok_or_else(|| cut_off(length.saturating_add(HEADER as u64)))?;
    let mut crc = Crc::new();
    crc.update(sections);
    if crc.sum() == sum { Ok(sections) } else { Err(damaged("its checksum is another one")) }
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

    /// A scan that is not kept: one without beams.
    fn no_scan(&mut self) {
        self.number(0.0);
        self.number(0.0);
        self.count(0);
        self.bytes.push(1);
    }

    /// Beams by their angles where they are even, else one by one; ranges with `inf` where nothing was seen.
    #[allow(clippy::cast_possible_truncation)] // to single precision: micrometres
    fn scan(&mut self, scan: &Scan) {
        let beams = scan.beams();
        self.number(beams.angle(0));
        self.number(beams.angle_increment());
        self.count(scan.len());
        self.bytes.push(u8::from(beams.is_even()));
        if !beams.is_even() {
            beams.directions().iter().for_each(|direction| self.number(direction.y.atan2(direction.x)));
        }
        for (i, &range) in scan.ranges().iter().enumerate() {
            self.short(if scan.saw_nothing(i) { f32::INFINITY } else { range as f32 });
        }
    }
}

struct Reader<'a> {
    bytes: &'a [u8],
}

impl<'a> Reader<'a> {
    fn take(&mut self, count: usize) -> Result<&'a [u8], GraphFileError> {
        let (taken, rest) = self.bytes.split_at_checked(count).ok_or(damaged("a section ends too early"))?;
        self.bytes = rest;
        Ok(taken)
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], GraphFileError> {
        let taken = self.take(N)?;
        taken.try_into().map_err(|_| damaged("a section ends too early"))
    }

    fn long(&mut self) -> Result<u64, GraphFileError> {
        Ok(u64::from_le_bytes(self.array()?))
    }

    /// A number of things, of which each takes a byte at least: no more than there are bytes, or an index.
    fn count(&mut self) -> Result<usize, GraphFileError> {
        usize::try_from(self.long()?).map_err(|_| damaged("a count"))
    }

    fn stamp(&mut self) -> Result<Stamp, GraphFileError> {
        Ok(Stamp::from_nanoseconds(i64::from_le_bytes(self.array()?)))
    }

    fn number(&mut self) -> Result<f64, GraphFileError> {
        let number = f64::from_le_bytes(self.array()?);
        if number.is_finite() { Ok(number) } else { Err(damaged("a number is not finite")) }
    }

    fn pose(&mut self) -> Result<Pose2, GraphFileError> {
        Ok(Pose2::new(self.number()?, self.number()?, self.number()?))
    }

    /// The scan of a keyframe; `None` where it was not kept.
    fn scan(&mut self, stamp: Stamp, geometries: &mut Vec<Arc<BeamGeometry>>) -> Result<Option<Scan>, GraphFileError> {
        let (angle, increment, count) = (self.number()?, self.number()?, self.count()?);
        if count == 0 {
            return self.take(1).map(|_| None);
        }
        if count > crate::scan::MAX_BEAMS || increment == 0.0 {
            return Err(damaged("the beams of a scan"));
        }
        let is_even = self.take(1)? == [1];
        let beams = if is_even {
            shared(geometries, angle, increment, count)
        } else {
            let mut directions = Vec::with_capacity(count);
            for _ in 0..count {
                let (sin, cos) = self.number()?.sin_cos();
                directions.push([cos, sin].into());
            }
            Arc::new(BeamGeometry::about(angle, increment, directions))
        };
        let mut ranges = Vec::with_capacity(count);
        for _ in 0..count {
            ranges.push(f64::from(f32::from_le_bytes(self.array()?)));
        }
        Scan::new(stamp, beams, (0.0, f64::MAX), ranges).map(Some).map_err(|_| damaged("the ranges of a scan"))
    }
}

/// Even beams, the same for all scans that have them.
fn shared(geometries: &mut Vec<Arc<BeamGeometry>>, angle: f64, increment: f64, count: usize) -> Arc<BeamGeometry> {
    let is_it = |beams: &&Arc<BeamGeometry>| {
        let numbers = [beams.angle(0), beams.angle_increment()];
        beams.len() == count && numbers.map(f64::to_bits) == [angle, increment].map(f64::to_bits)
    };
    if let Some(beams) = geometries.iter().rev().find(is_it) {
        return Arc::clone(beams);
    }
    geometries.push(Arc::new(BeamGeometry::new(angle, increment, count)));
    Arc::clone(&geometries[geometries.len() - 1])
}
