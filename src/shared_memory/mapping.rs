//! Maps a segment into the memory of this process: with one line of `ros::node_api`, the only unsafe code of the project.
#![allow(unsafe_code)]

use std::ops::Deref;
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::ptr::{self, NonNull};

use rustix::io::Errno;
use rustix::mm::{MapFlags, ProtFlags, mmap, munmap};

use super::error::Problem;
use super::layout::{SIZE, Segment};

/// A mapped segment, and its file.
#[derive(Debug)]
pub(super) struct Mapping {
    segment: NonNull<Segment>,
    file: OwnedFd,
}

impl Mapping {
    /// Maps `file`. Its size must be that of a segment, because an access beyond the end of the file would kill the process.
    pub(super) fn new(file: OwnedFd) -> Result<Self, Problem> {
        let system_error = |errno| Problem::system("map the segment", errno);
        let found = rustix::fs::fstat(&file).map_err(system_error)?.st_size;
        if i64::from(SIZE) != found {
            return Err(Problem::WrongSize { found, expected: SIZE });
        }
        // SAFETY: the kernel chooses an unused address.
        let start = unsafe {
            mmap(ptr::null_mut(), size_of::<Segment>(), ProtFlags::READ | ProtFlags::WRITE, MapFlags::SHARED, &file, 0)
        }
        .map_err(system_error)?;
        let segment = NonNull::new(start.cast()).ok_or(system_error(Errno::NOMEM))?;
        Ok(Self { segment, file })
    }

    /// The segment's file.
    pub(super) fn file(&self) -> BorrowedFd<'_> {
        self.file.as_fd()
    }
}

impl Deref for Mapping {
    type Target = Segment;

    fn deref(&self) -> &Segment {
        // SAFETY: the mapping is as long as a segment, aligned to a page, and lives as long as `self`. Any bytes are a valid
        // segment, as it consists of atomic integers and padding. According to the protocol, other processes change it only
        // through atomics.
        unsafe { self.segment.as_ref() }
    }
}

impl Drop for Mapping {
    fn drop(&mut self) {
        // SAFETY: this is the mapping made in `new`, and no reference to it outlives `self`.
        // It cannot fail for an existing mapping; if it did, the pages would stay mapped until the process ends.
        let _ = unsafe { munmap(self.segment.as_ptr().cast(), size_of::<Segment>()) };
    }
}

// SAFETY: the pointer is owned, and its target does not depend on the thread.
unsafe impl Send for Mapping {}
// SAFETY: a shared reference only gives access to atomics.
unsafe impl Sync for Mapping {}
