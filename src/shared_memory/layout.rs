//! What lies where in the segment: the Rust twin of `include/anytime_scan_matcher/shared_memory.h`.
//!
//! Every field is an atomic, in the byte order of the machine. Who writes what has its own cache lines, 128 bytes apart: processors
//! fetch lines of 64 bytes in pairs, and some have lines of 128.

use std::mem::offset_of;
use std::sync::atomic::{AtomicU32, AtomicU64};

/// First bytes of a segment of this project: "ANYTSCAN" read as a little-endian number.
pub const MAGIC: u64 = u64::from_le_bytes(*b"ANYTSCAN");

/// Number of this layout and its protocol; another number is another contract.
pub const VERSION: u32 = 1;

/// Size of the segment, bytes.
pub const SIZE: u32 = 512;

/// The whole segment. Counts begin at 0 and wrap around: compare them by their wrapping difference.
#[derive(Debug)]
#[repr(C)]
pub struct Segment {
    /// Whose segment this is, and of which form.
    pub identity: Identity,
    /// What controllers write.
    pub controller: Controller,
    /// What the node writes.
    pub node: Node,
    /// The newest estimate.
    pub estimate: Estimate,
}

/// Whose segment this is, and of which form.
///
/// That the owner lives is not told by its number, which may be another process's by now: the owner holds an exclusive `flock` on
/// the segment, which the kernel lets go of at the owner's death, whatever way it dies.
#[derive(Debug)]
#[repr(C, align(128))]
pub struct Identity {
    /// [`MAGIC`], stored last: a segment that has it is complete.
    pub magic: AtomicU64,
    /// [`VERSION`].
    pub version: AtomicU32,
    /// [`SIZE`].
    pub size: AtomicU32,
    /// Process id of the owner, for messages only.
    pub owner: AtomicU32,
    /// 1 once the owner has closed the segment: nothing more will come.
    pub closed: AtomicU32,
}

/// What controllers write.
#[derive(Debug)]
#[repr(C, align(128))]
pub struct Controller {
    /// Requests ever made. Adding one makes a request, whose number is the sum. A futex.
    pub requested: AtomicU32,
}

/// What the node writes.
#[derive(Debug)]
#[repr(C, align(128))]
pub struct Node {
    /// Number of the last request answered, and with it of all before. A futex.
    pub acknowledged: AtomicU32,
    /// Estimates completed. Its parity is the value of the topic `icp_state`. A futex.
    pub completed: AtomicU32,
    /// 1 while the node is idle: a request must wake the futex `requested`, on which it sleeps. At work it looks by itself, and a
    /// system call would only take processor time from it.
    pub idle: AtomicU32,
}

/// The newest estimate, behind a sequence lock: consistent if `sequence` is even, and the same before and after reading.
#[derive(Debug, Default)]
#[repr(C, align(128))]
pub struct Estimate {
    /// Odd while the node writes.
    pub sequence: AtomicU32,
    /// Sum of the `FLAG_*`.
    pub flags: AtomicU32,
    /// The count of completed estimates that this one made.
    pub number: AtomicU32,
    /// Stamp of the scan, whole seconds.
    pub stamp_seconds: AtomicU32,
    /// Stamp of the scan, the nanoseconds beyond them.
    pub stamp_nanoseconds: AtomicU32,
    /// Zero.
    pub reserved: AtomicU32,
    /// Position, m: the bits of an `f64`, as all that follow but the last.
    pub x: AtomicU64,
    /// Position, m.
    pub y: AtomicU64,
    /// Heading, rad.
    pub theta: AtomicU64,
    /// Standard deviation of the position, m.
    pub position_deviation: AtomicU64,
    /// Standard deviation of the heading, rad.
    pub heading_deviation: AtomicU64,
    /// Time from the scan's arrival to the estimate, ns: an integer.
    pub elapsed_nanoseconds: AtomicU64,
}

/// There is an estimate: without it the other fields mean nothing.
pub const FLAG_PRESENT: u32 = 1;
/// The scan was matched; without it the pose is the prediction.
pub const FLAG_OK: u32 = 2;
/// The answer came in time.
pub const FLAG_DEADLINE_MET: u32 = 4;
/// A request cut the refinement short.
pub const FLAG_INTERRUPTED: u32 = 8;

const _: () = {
    assert!(size_of::<Segment>() == SIZE as usize);
    assert!(offset_of!(Segment, identity.magic) == 0);
    assert!(offset_of!(Segment, identity.version) == 8);
    assert!(offset_of!(Segment, identity.size) == 12);
    assert!(offset_of!(Segment, identity.owner) == 16);
    assert!(offset_of!(Segment, identity.closed) == 20);
    assert!(offset_of!(Segment, controller.requested) == 128);
    assert!(offset_of!(Segment, node.acknowledged) == 256);
    assert!(offset_of!(Segment, node.completed) == 260);
    assert!(offset_of!(Segment, node.idle) == 264);
    assert!(offset_of!(Segment, estimate.sequence) == 384);
    assert!(offset_of!(Segment, estimate.flags) == 388);
    assert!(offset_of!(Segment, estimate.number) == 392);
    assert!(offset_of!(Segment, estimate.stamp_seconds) == 396);
    assert!(offset_of!(Segment, estimate.stamp_nanoseconds) == 400);
    assert!(offset_of!(Segment, estimate.reserved) == 404);
    assert!(offset_of!(Segment, estimate.x) == 408);
    assert!(offset_of!(Segment, estimate.y) == 416);
    assert!(offset_of!(Segment, estimate.theta) == 424);
    assert!(offset_of!(Segment, estimate.position_deviation) == 432);
    assert!(offset_of!(Segment, estimate.heading_deviation) == 440);
    assert!(offset_of!(Segment, estimate.elapsed_nanoseconds) == 448);
};
