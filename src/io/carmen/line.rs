//! One line of a CARMEN log.

use std::f64::consts::{FRAC_PI_2, PI};

use super::{CarmenOdometry, CarmenScan};
use crate::geometry::Pose2;
use crate::io::text;
use crate::scan::MAX_BEAMS;
use crate::time::Stamp;

/// Maximum length of a message name, bytes.
const MAX_NAME_BYTES: usize = 40;
/// Minimum stamp. A clock that counts from the start of the log begins at 0, which a bag does not support.
const MIN_STAMP: Stamp = Stamp::from_nanoseconds(1);

/// The content of a line.
pub(super) enum Line {
    /// A blank line or a comment.
    Blank,
    /// `FLASER`.
    FrontLaser(CarmenScan),
    /// `ROBOTLASER1`.
    RobotLaser(CarmenScan),
    /// `RAWLASER1`.
    RawLaser(CarmenScan),
    /// `ODOM`.
    Odometry(CarmenOdometry),
    /// `PARAM robot_frontlaser_offset`, m.
    FrontLaserOffset(f64),
    /// Any other message: its name.
    Other(String),
}

/// The columns of a line, read from left to right.
struct Columns<'a> {
    words: std::str::SplitWhitespace<'a>,
}

impl<'a> Columns<'a> {
    fn word(&mut self, name: &str) -> Result<&'a str, String> {
        self.words.next().ok_or_else(|| format!("the line ends before {name} (truncated? complete or remove it)"))
    }

    fn numbers<const N: usize>(&mut self, names: [&str; N]) -> Result<[f64; N], String> {
        let mut words = [""; N];
        for (word, name) in words.iter_mut().zip(names) {
            *word = self.word(name)?;
        }
        text::numbers(names, &words)
    }

    fn pose(&mut self, names: [&str; 3]) -> Result<Pose2, String> {
        self.numbers(names).map(|[x, y, theta]| Pose2::new(x, y, theta))
    }

    fn count(&mut self, name: &str) -> Result<usize, String> {
        let word = self.word(name)?;
        let count = word.parse().ok().filter(|count| *count <= MAX_BEAMS);
        count.ok_or_else(|| format!("{name} is `{word}`: expected a whole number up to {MAX_BEAMS}"))
    }

    /// Readings need not be finite: some logs use infinity for "no return".
    fn ranges(&mut self, count: usize) -> Result<Vec<f32>, String> {
        (0..count)
            .map(|_| {
                let word = self.word("the last of its ranges")?;
                word.parse().map_err(|_| format!("a range is `{word}`: expected a number (fix or remove the line)"))
            })
            .collect()
    }

    /// `ipc_timestamp ipc_hostname logger_timestamp`; some logs lack the last two. If `ipc_timestamp` is 0, `logger_timestamp` is
    /// used.
    fn stamp(&mut self) -> Result<Stamp, String> {
        let sent = text::stamp(self.word("ipc_timestamp")?)?;
        let logged = self.words.nth(1).map(text::stamp).transpose();
        let stamp = if sent == Stamp::default() { logged?.unwrap_or(sent) } else { sent };
        if stamp < Stamp::default() || stamp > Stamp::from_ros(u32::MAX, 0) {
            return Err(format!("the stamp is {stamp}: expected seconds since 1970, or since the start of the log"));
        }
        Ok(stamp.max(MIN_STAMP))
    }
}

/// Parses a line; the error says what is wrong with it.
pub(super) fn parse(line: &str, field_of_view: Option<f64>) -> Result<Line, String> {
    let mut columns = Columns { words: line.split_whitespace() };
    match columns.words.next() {
        None => Ok(Line::Blank),
        Some(word) if word.starts_with('#') => Ok(Line::Blank),
        Some("FLASER") => front_laser(&mut columns, field_of_view).map(Line::FrontLaser),
        Some("ROBOTLASER1") => robot_laser(&mut columns).map(Line::RobotLaser),
        Some("RAWLASER1") => raw_laser(&mut columns).map(Line::RawLaser),
        Some("ODOM") => odometry(&mut columns).map(Line::Odometry),
        Some("PARAM") => parameter(&mut columns),
        Some(word) if is_name(word) => Ok(Line::Other(word.into())),
        Some(word) => {
            let shown: String = word.chars().take(MAX_NAME_BYTES).collect();
            Err(format!(
                "the line begins with `{shown}`: \
                 expected FLASER, ROBOTLASER1, RAWLASER1, ODOM or another CARMEN message in capitals"
            ))
        }
    }
}

fn is_name(word: &str) -> bool {
    let is_allowed = |byte: u8| byte.is_ascii_uppercase() || byte.is_ascii_digit() || b"-_".contains(&byte);
    word.len() <= MAX_NAME_BYTES && word.starts_with(|first: char| first.is_ascii_uppercase()) && word.bytes().all(is_allowed)
}

/// `FLASER n [ranges] x y theta odom_x odom_y odom_theta ipc_timestamp ...`
fn front_laser(columns: &mut Columns, field_of_view: Option<f64>) -> Result<CarmenScan, String> {
    let beams = columns.count("num_readings")?;
    let ranges = columns.ranges(beams)?;
    let odom_from_laser = columns.pose(["x", "y", "theta"])?;
    let odom_from_base = columns.pose(["odom_x", "odom_y", "odom_theta"])?;
    let odometry = CarmenOdometry { stamp: columns.stamp()?, odom_from_base, velocity: None };
    let steps = beams.saturating_sub(1).max(1) as f64;
    let (angle_min, angle_increment) = match field_of_view {
        Some(view) => (-0.5 * view, view / steps),
        // 181 beams cover -90 to 90 degrees. 180 beams do so without the last one.
        None => (-FRAC_PI_2, PI / if beams % 2 == 1 { steps } else { steps + 1.0 }),
    };
    let has_poses = true;
    Ok(CarmenScan { odometry, odom_from_laser, has_poses, angle_min, angle_increment, no_return_range: None, ranges })
}

/// The first columns of `ROBOTLASER1` and `RAWLASER1` lines: `laser_type start_angle field_of_view angular_resolution
/// maximum_range accuracy remission_mode n [ranges] m [remissions]`.
struct Sweep {
    angle_min: f64,
    angle_increment: f64,
    no_return_range: Option<f64>,
    ranges: Vec<f32>,
}

impl Sweep {
    fn read(columns: &mut Columns) -> Result<Self, String> {
        let [_, angle_min, _, angle_increment, no_return_range, _, _] = columns.numbers([
            "laser_type",
            "start_angle",
            "field_of_view",
            "angular_resolution",
            "maximum_range",
            "accuracy",
            "remission_mode",
        ])?;
        let beams = columns.count("num_readings")?;
        let ranges = columns.ranges(beams)?;
        let remissions = columns.count("num_remissions")?;
        columns.ranges(remissions)?;
        Ok(Self { angle_min, angle_increment, no_return_range: Some(no_return_range).filter(|range| *range > 0.0), ranges })
    }

    fn scan(self, odometry: CarmenOdometry, odom_from_laser: Pose2, has_poses: bool) -> CarmenScan {
        let Self { angle_min, angle_increment, no_return_range, ranges } = self;
        CarmenScan { odometry, odom_from_laser, has_poses, angle_min, angle_increment, no_return_range, ranges }
    }
}

/// `ROBOTLASER1 [sweep] laser_x laser_y laser_theta robot_x robot_y robot_theta tv rv forward_safety side_safety turn_axis
/// ipc_timestamp ...`
fn robot_laser(columns: &mut Columns) -> Result<CarmenScan, String> {
    let sweep = Sweep::read(columns)?;
    let odom_from_laser = columns.pose(["laser_pose_x", "laser_pose_y", "laser_pose_theta"])?;
    let odom_from_base = columns.pose(["robot_pose_x", "robot_pose_y", "robot_pose_theta"])?;
    let [tv, rv, ..] = columns.numbers(["laser_tv", "laser_rv", "forward_safety_dist", "side_safety_dist", "turn_axis"])?;
    let odometry = CarmenOdometry { stamp: columns.stamp()?, odom_from_base, velocity: Some((tv, rv)) };
    Ok(sweep.scan(odometry, odom_from_laser, true))
}

/// `RAWLASER1 [sweep] ipc_timestamp ...`
fn raw_laser(columns: &mut Columns) -> Result<CarmenScan, String> {
    let sweep = Sweep::read(columns)?;
    let odometry = CarmenOdometry { stamp: columns.stamp()?, odom_from_base: Pose2::IDENTITY, velocity: None };
    Ok(sweep.scan(odometry, Pose2::IDENTITY, false))
}

/// `ODOM x y theta tv rv accel ipc_timestamp ...`
fn odometry(columns: &mut Columns) -> Result<CarmenOdometry, String> {
    let [x, y, theta, tv, rv, _] = columns.numbers(["x", "y", "theta", "tv", "rv", "accel"])?;
    Ok(CarmenOdometry { stamp: columns.stamp()?, odom_from_base: Pose2::new(x, y, theta), velocity: Some((tv, rv)) })
}

/// `PARAM name value ...`
fn parameter(columns: &mut Columns) -> Result<Line, String> {
    if columns.words.next() != Some("robot_frontlaser_offset") {
        return Ok(Line::Other("PARAM".into()));
    }
    columns.numbers(["robot_frontlaser_offset"]).map(|[offset]| Line::FrontLaserOffset(offset))
}
