//! Layout of the segment: must match `include/anytime_scan_matcher/shared_memory.h`.
//!
//! Every field is an atomic, in the byte order of the machine. The fields of each writer have their own cache lines, 128 bytes
//! apart: processors fetch lines of 64 bytes in pairs, and some have lines of 128 bytes.

use std::mem::offset_of;
use std::sync::atomic::{AtomicU32, AtomicU64};

/// First bytes of a segment of this project: "ANYTSCAN" read as a little-endian number.
pub const MAGIC: u64 = u64::from_le_bytes(*b"ANYTSCAN");

/// Version of this layout and its protocol; other versions are incompatible.
pub const VERSION: u32 = 1;

/// Size of the segment, bytes.
pub const SIZE: u32 = 512;

/// The whole segment. Counts begin at 0 and wrap around; compare them by their wrapping difference.
#[derive(Debug)]
#[repr(C)]
pub struct Segment {
    /// Format and owner of the segment.
    pub identity: Identity,
    /// Fields that controllers write.
    pub controller: Controller,
    /// Fields that the node writes.
    pub node: Node,
    /// The newest estimate.
    pub estimate: Estimate,
}

/// Format and owner of the segment.
///
/// The process id does not show whether the owner is alive, because the system may have reused it. Instead, the owner holds an
/// exclusive `flock` on the segment, which the kernel releases when the owner dies in whatever way.
#[derive(Debug)]
#[repr(C, align(128))]
pub struct Identity {
    /// [`MAGIC`], stored last: a segment with this value is completely initialized.
    pub magic: AtomicU64,
    /// [`VERSION`].
    pub version: AtomicU32,
    /// [`SIZE`].
    pub size: AtomicU32,
    /// Process id of the owner, only for messages.
    pub owner: AtomicU32,
    /// 1 once the owner has closed the segment: there will be no more answers.
    pub closed: AtomicU32,
}

/// Fields that controllers write.
#[derive(Debug)]
#[repr(C, align(128))]
pub struct Controller {
    /// Number of requests made. Adding one makes a request; the sum is its number. A futex.
    pub requested: AtomicU32,
}

/// Fields that the node writes.
#[derive(Debug)]
#[repr(C, align(128))]
pub struct Node {
    /// Number of the last answered request; all earlier ones are answered, too. A futex.
    pub acknowledged: AtomicU32,
    /// Number of estimates completed. Its parity is the value of the topic `icp_state`. A futex.
    pub completed: AtomicU32,
    /// 1 while the node is idle: a request must then wake the futex `requested`, on which the node sleeps. While it processes a
    /// scan, the node polls `requested` itself, and a system call would only cost it processor time.
    pub idle: AtomicU32,
}

/// The newest estimate, protected by a sequence lock: it is consistent if `sequence` is even, and the same before and after
/// reading.
#[derive(Debug, Default)]
#[repr(C, align(128))]
pub struct Estimate {
    /// Odd while the node writes.
    pub sequence: AtomicU32,
    /// Bitwise or of the `FLAG_*` constants.
    pub flags: AtomicU32,
    /// Number of completed estimates including this one.
    pub number: AtomicU32,
    /// Stamp of the scan: whole seconds.
    pub stamp_seconds: AtomicU32,
    /// Stamp of the scan: remaining nanoseconds.
    pub stamp_nanoseconds: AtomicU32,
    /// Always zero.
    pub reserved: AtomicU32,
    /// x of the position, m: the bits of an `f64`.
    pub x: AtomicU64,
    /// y of the position, m: the bits of an `f64`.
    pub y: AtomicU64,
    /// Heading, rad: the bits of an `f64`.
    pub theta: AtomicU64,
    /// Standard deviation of the position, m: the bits of an `f64`.
    pub position_deviation: AtomicU64,
    /// Standard deviation of the heading, rad: the bits of an `f64`.
    pub heading_deviation: AtomicU64,
    /// Time from the scan's arrival to the estimate, ns: an integer.
    pub elapsed_nanoseconds: AtomicU64,
}

/// There is an estimate. Without this flag, the other fields are meaningless.
pub const FLAG_PRESENT: u32 = 1;
/// The scan was matched. Without this flag, the pose is the prediction.
pub const FLAG_OK: u32 = 2;
/// The deadline was met.
pub const FLAG_DEADLINE_MET: u32 = 4;
/// A request ended the refinement early.
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
