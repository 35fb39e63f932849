//! Trajectories in the TUM format: `timestamp x y z qx qy qz qw` on each line, seconds and metres.
//!
//! Sturm et al., IROS 2012. Reads also `timestamp x y theta`, the plane's own form. Of poses in space the plane's part is kept.

use std::io::{self, Write};
use std::path::Path;

use super::text::{self, TextFileError};
use crate::evaluation::trajectory::{StampedPose, Trajectory};
use crate::geometry::Pose2;
use crate::messages::geometry_msgs::Quaternion;

const COLUMNS: &str = "timestamp x y z qx qy qz qw";
/// How far from 1 the norm of a quaternion may be: files with three decimals pass, columns in the wrong order do not.
const NORM_TOLERANCE: f64 = 0.01;

/// Reads a trajectory from a file.
pub fn read(path: &Path) -> Result<Trajectory, TextFileError> {
    parse(&text::load(path, COLUMNS)?, path)
}

/// Reads a trajectory from the text of a file; `path` names it in errors.
pub fn parse(text: &str, path: &Path) -> Result<Trajectory, TextFileError> {
    let mut columns_before = None;
    let poses = text::records(text, path, |columns| {
        // A line that was cut off in the middle must not pass as one of the shorter form.
        let expected = *columns_before.get_or_insert(columns.len());
        if columns.len() != expected {
            return Err(format!("{} columns, but {expected} in the lines before (cut off? remove the line)", columns.len()));
        }
        parse_pose(columns)
    })?;
    // All numbers are finite by now: no pose at all is the only fault left.
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
/// Each pose is one `write_all` of a complete line: over a bare [`std::fs::File`] nothing of a killed run is lost, over a
/// [`std::io::BufWriter`] only the last lines, and neither leaves half a line behind.
#[derive(Debug)]
pub struct TumWriter<W: Write> {
    sink: W,
}

impl<W: Write> TumWriter<W> {
    /// Writes to `sink`.
    pub fn new(sink: W) -> Self {
        Self { sink }
    }

    /// Adds a pose: to the nanosecond and the nanometre.
    pub fn write(&mut self, stamped: &StampedPose) -> io::Result<()> {
        let StampedPose { stamp, pose } = stamped;
        let (qz, qw) = (0.5 * pose.theta).sin_cos();
        self.sink.write_all(format!("{stamp} {:.9} {:.9} 0 0 0 {qz:.12} {qw:.12}\n", pose.x, pose.y).as_bytes())
    }

    /// The sink.
    pub fn into_sink(self) -> W {
        self.sink
    }

    /// Flushes `sink`.
    pub fn flush(&mut self) -> io::Result<()> {
        self.sink.flush()
    }
}
