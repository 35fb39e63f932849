//! Checks names of segments, and opens the segments' files.

use std::os::fd::OwnedFd;

use rustix::fs::Mode;
use rustix::shm::OFlags;

use super::error::Problem;

/// Opens the segment `name` for reading and writing, with additional `flags`. If this creates the file, only the same user may
/// open it.
pub(super) fn open(name: &str, flags: OFlags) -> Result<OwnedFd, Problem> {
    let bare = name.strip_prefix('/').unwrap_or(name);
    if bare.is_empty() || bare.len() > 254 || bare.contains(['/', '\0']) || bare.starts_with('.') {
        return Err(Problem::BadName);
    }
    rustix::shm::open(name, OFlags::RDWR | flags, Mode::RUSR | Mode::WUSR)
        .map_err(|errno| Problem::system("open the segment", errno))
}
