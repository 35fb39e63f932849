//! Files of relations: `t1 t2 x y z roll pitch yaw` on each line, seconds, metres and radians.
//!
//! Format of Kuemmerle et al., Autonomous Robots 27, 2009. Only planar motion is evaluated: z, roll and pitch must be numbers,
//! but are ignored.

use std::path::Path;

use super::text::{self, TextFileError};
use crate::evaluation::relations::Relation;
use crate::geometry::Pose2;

const COLUMNS: &str = "t1 t2 x y z roll pitch yaw";

/// Reads relations from a file, which must have at least one.
pub fn read(path: &Path) -> Result<Vec<Relation>, TextFileError> {
    parse(&text::load(path, COLUMNS)?, path)
}

/// Parses the text of a file of relations; `path` names the file in errors.
pub fn parse(text: &str, path: &Path) -> Result<Vec<Relation>, TextFileError> {
    let relations = text::records(text, path, parse_relation)?;
    if relations.is_empty() {
        return Err(TextFileError::Empty { path: path.into(), expected: COLUMNS });
    }
    Ok(relations)
}

fn parse_relation(columns: &[&str]) -> Result<Relation, String> {
    if columns.len() != 8 {
        return Err(format!("{} columns: expected `{COLUMNS}`", columns.len()));
    }
    let (from, to) = (text::stamp(columns[0])?, text::stamp(columns[1])?);
    let [x, y, _, _, _, yaw] = text::numbers(["x", "y", "z", "roll", "pitch", "yaw"], &columns[2..])?;
    Ok(Relation { from, to, motion: Pose2::new(x, y, yaw) })
}
