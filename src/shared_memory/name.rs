//! Names of segments, and the files they stand for.

use std::os::fd::OwnedFd;

use rustix::fs::Mode;
use rustix::shm::OFlags;

use super::error::Problem;

/// Opens the segment `name`, with `more` flags than reading and writing. Only the same user may open one that this creates.
pub(super) fn open(name: &str, more: OFlags) -> Result<OwnedFd, Problem> {
    let bare = name.strip_prefix('/').unwrap_or(name);
    if bare.is_empty() || bare.len() > 254 || bare.contains(['/', '\0']) || bare.starts_with('.') {
        return Err(Problem::BadName);
    }
    rustix::shm::open(name, OFlags::RDWR | more, Mode::RUSR | Mode::WUSR)
        .map_err(|errno| Problem::system("open the segment", errno))
}
