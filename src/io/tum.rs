//! Trajectories in the TUM format: `timestamp x y z qx qy qz qw` on each line, seconds and metres.
//!
//! Format of Sturm et al., IROS 2012. The planar form `timestamp x y theta` is read, too. Of 3D poses only x, y and yaw are used.

use std::io::{self, Write};
use std::path::Path;

use super::text::{self, TextFileError};
use crate::evaluation::trajectory::{StampedPose, Trajectory};
use crate::geometry::Pose2;
use crate::messages::geometry_msgs::Quaternion;

const COLUMNS: &str = "timestamp x y z qx qy qz qw";
/// Maximum deviation of a quaternion's norm from 1: accepts files with three decimals, but rejects columns in the wrong order.
pub(super) const NORM_TOLERANCE: f64 = 0.01;

/// Reads a trajectory from a file.
pub fn read(path: &Path) -> Result<Trajectory, TextFileError> {
    parse(&text::load(path, COLUMNS)?, path)
}

/// Parses the text of a trajectory file; `path` names the file in errors.
pub fn parse(text: &str, path: &Path) -> Result<Trajectory, TextFileError> {
    let mut columns_before = None;
    let poses = text::records(text, path, |columns| {
        // A truncated line must not be taken for one of the shorter form.
        let expected = *columns_before.get_or_insert(columns.len());
        if columns.len() != expected {
            return Err(format!("{} columns, but {expected} in the lines before (truncated? remove the line)", columns.len()));
        }
        parse_pose(columns)
    })?;
    // All numbers are known to be finite here, so the only possible error is that there is no pose.
    Trajectory::new(poses).map_err(|_| TextFileError::Empty { path: path.into(), expected: COLUMNS })
}

fn parse_pose(columns: &[&str]) -> Result<StampedPose, String> {
    let pose = match columns.len() {
        4 => {
            let [x, y, theta] = text::numbers(["x", "y", "theta"], &columns[1..])?;
            Pose2::new(x, y, theta)
        }
        8 => {
            let [x, y, _, qx, qy, qz, qw] = text::numbers(["x", "y", "z", "qx", "qy", "qz", "qw"], &columns[1..])?;
            Pose2::new(x, y, yaw([qx, qy, qz, qw])?)
        }
        count => return Err(format!("{count} columns: expected `{COLUMNS}` or `timestamp x y theta`")),
    };
    Ok(StampedPose { stamp: text::stamp(columns[0])?, pose })
}

fn yaw([x, y, z, w]: [f64; 4]) -> Result<f64, String> {
    let quaternion = Quaternion { x, y, z, w };
    let norm = quaternion.norm();
    if (norm - 1.0).abs() > NORM_TOLERANCE {
        return Err(format!("the quaternion's norm is {norm:.3}: expected 1 (are the columns `{COLUMNS}`?)"));
    }
    Ok(quaternion.yaw())
}

/// Writes a trajectory pose by pose.
///
/// Each pose is written by one `write_all` of a complete line. If the program is killed, a plain [`std::fs::File`] loses nothing
/// and a [`std::io::BufWriter`] only the last lines.
#[derive(Debug)]
pub struct TumWriter<W: Write> {
    sink: W,
}

impl<W: Write> TumWriter<W> {
    /// Writes to `sink`.
    pub fn new(sink: W) -> Self {
        Self { sink }
    }

    /// Writes a pose with a resolution of 1 ns and 1 nm.
    pub fn write(&mut self, stamped: &StampedPose) -> io::Result<()> {
        let StampedPose { stamp, pose } = stamped;
        let (qz, qw) = (0.5 * pose.theta).sin_cos();
        self.sink.write_all(format!("{stamp} {:.9} {:.9} 0 0 0 {qz:.12} {qw:.12}\n", pose.x, pose.y).as_bytes())
    }

    /// Returns the sink.
    pub fn into_sink(self) -> W {
        self.sink
    }

    /// Flushes the sink.
    pub fn flush(&mut self) -> io::Result<()> {
        self.sink.flush()
    }
}
