//! Raceline files: one waypoint per line, in the formats of the F1TENTH software stacks.
//!
//! Values are separated by `,` or `;`; text after `#` is a comment. A comment or first line with column names defines the columns
//! (`# s_m; x_m; y_m; psi_rad; kappa_radpm; vx_mps; ax_mps2`, as written by TUM's global planner). Without names a line is
//! `x, y`, `x, y, speed`, or `x, y, yaw, speed`, as written by F1TENTH's waypoint logger.

use thiserror::Error;

use super::path::Waypoint;
use crate::geometry::Point;

/// Names of the x column, in lower case.
const X: [&str; 3] = ["x", "x_m", "x_ref_m"];
/// Names of the y column, in lower case.
const Y: [&str; 3] = ["y", "y_m", "y_ref_m"];
/// Names of the speed column, in lower case.
const SPEED: [&str; 6] = ["speed", "v", "vx", "vx_mps", "v_mps", "velocity"];

/// Why a file is not a valid waypoint file.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum WaypointFileError {
    /// An invalid line.
    #[error(
        "line {line}: expected numbers (x, y[, speed], or x, y, yaw, speed; name other columns in a line '# x_m; y_m; ...'), got '{text}'"
    )]
    Line {
        /// Line number, from 1.
        line: usize,
        /// The line.
        text: String,
    },
    /// The file has no line with numbers.
    #[error("the file has no waypoints: expected lines x, y[, speed]")]
    Empty,
}

/// Indices of the columns.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Columns {
    x: usize,
    y: usize,
    speed: Option<usize>,
}

impl Columns {
    /// Columns by name, if the text holds column names.
    fn named(text: &str) -> Option<Self> {
        let names: Vec<String> = values(text).map(str::to_lowercase).collect();
        let find = |wanted: &[&str]| names.iter().position(|name| wanted.contains(&name.as_str()));
        Some(Self { x: find(&X)?, y: find(&Y)?, speed: find(&SPEED) })
    }

    /// Columns by the number of values.
    fn counted(count: usize) -> Option<Self> {
        let speed = match count {
            2 => None,
            3 => Some(2),
            4 => Some(3),
            _ => return None,
        };
        Some(Self { x: 0, y: 1, speed })
    }

    fn waypoint(self, numbers: &[f64]) -> Option<Waypoint> {
        let point = Point::new(*numbers.get(self.x)?, *numbers.get(self.y)?);
        let is_finite = point.x.is_finite() && point.y.is_finite();
        is_finite.then(|| Waypoint { point, speed: self.speed.and_then(|speed| numbers.get(speed).copied()) })
    }
}

fn values(text: &str) -> impl Iterator<Item = &str> {
    text.split([',', ';']).map(str::trim)
}

/// Parses the waypoints of a file.
pub fn parse(text: &str) -> Result<Vec<Waypoint>, WaypointFileError> {
    let mut columns = None;
    let mut waypoints = Vec::new();
    for (index, whole) in text.lines().enumerate() {
        let (content, comment) = whole.split_once('#').unwrap_or((whole, ""));
        let content = content.trim().trim_end_matches([',', ';']);
        let named = Columns::named(comment).or_else(|| if waypoints.is_empty() { Columns::named(content) } else { None });
        if content.is_empty() || named.is_some() {
            columns = named.or(columns);
            continue;
        }
        let numbers: Option<Vec<f64>> = values(content).map(|value| value.parse().ok()).collect();
        let waypoint = numbers.and_then(|numbers| columns.or_else(|| Columns::counted(numbers.len()))?.waypoint(&numbers));
        waypoints.push(waypoint.ok_or_else(|| WaypointFileError::Line { line: index + 1, text: whole.trim().into() })?);
    }
    if waypoints.is_empty() { Err(WaypointFileError::Empty) } else { Ok(waypoints) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Vec<(f64, f64, Option<f64>)> {
        parse(text).unwrap().iter().map(|w| (w.point.x, w.point.y, w.speed)).collect()
    }

    #[test]
    fn racelines_of_common_stacks_are_parsed() {
        assert_eq!(read("1,2\n3, 4\n"), [(1.0, 2.0, None), (3.0, 4.0, None)]);
        assert_eq!(read("# a lap\n1, 2, 5 # fast\n\n3;4;6\n"), [(1.0, 2.0, Some(5.0)), (3.0, 4.0, Some(6.0))]);
        assert_eq!(read("1.5,2,0.7,4"), [(1.5, 2.0, Some(4.0))]);
        let tum = "# 6f1c\n# s_m; x_m; y_m; psi_rad; kappa_radpm; vx_mps; ax_mps2\n0.0; 1.0; 2.0; 0.1; 0.0; 7.5; 0.0\n";
        assert_eq!(read(tum), [(1.0, 2.0, Some(7.5))]);
        assert_eq!(read("# x_m, y_m, w_tr_right_m, w_tr_left_m\n1,2,1.1,1.1\n"), [(1.0, 2.0, None)]);
        assert_eq!(read("x,y,speed\n1,2,3\n"), [(1.0, 2.0, Some(3.0))]);
    }

    #[test]
    fn errors_name_the_line() {
        let problem = parse("1,2\nNaN,2\n").unwrap_err();
        assert_eq!(problem, WaypointFileError::Line { line: 2, text: "NaN,2".into() });
        assert!(parse("1,2,3,4,5").unwrap_err().to_string().contains("line 1"));
        assert_eq!(parse("# nothing\n\n"), Err(WaypointFileError::Empty));
    }
}
