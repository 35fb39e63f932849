//! A schedule of contracts, read from a CSV file: replaces the controller that would request them on the robot.

use std::path::{Path, PathBuf};

use serde::Deserialize;
use thiserror::Error;

use crate::anytime::contract::{Contract, ContractError};
use crate::knobs::{KnobValue, Seconds};

/// Why a schedule is invalid.
#[derive(Debug, Error)]
pub enum ScheduleError {
    /// The file cannot be read, or a line is malformed.
    #[error(
        "{}: {problem}; a schedule has the columns time (s), time_budget (s, or text such as 5ms), \
         translation_error_bound (m, optional) and rotation_error_bound (rad, optional)",
        path.display()
    )]
    Table {
        /// The file.
        path: PathBuf,
        /// What is wrong, and in which line.
        problem: csv::Error,
    },
    /// A line has an invalid contract.
    #[error("{}: line {line}: {problem}", path.display())]
    Contract {
        /// The file.
        path: PathBuf,
        /// Its line.
        line: u64,
        /// What is wrong.
        problem: ContractError,
    },
    /// A time is not later than that of the line before.
    #[error("{}: line {line}: time {time} must be a number of seconds greater than that of the line before", path.display())]
    Time {
        /// The file.
        path: PathBuf,
        /// Its line.
        line: u64,
        /// The time, s.
        time: f64,
    },
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Row {
    time: f64,
    time_budget: String,
    #[serde(default)]
    translation_error_bound: f64,
    #[serde(default)]
    rotation_error_bound: f64,
}

/// Contracts, each in force from its start time until the next one.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ContractSchedule {
    /// Start time, s after the first scan, and contract; sorted by time.
    steps: Vec<(f64, Contract)>,
}

impl ContractSchedule {
    /// The contract in force `seconds` after the first scan; `None` before that of the first line.
    pub fn at(&self, seconds: f64) -> Option<Contract> {
        let next = self.steps.partition_point(|(time, _)| *time <= seconds);
        self.steps[..next].last().map(|(_, contract)| *contract)
    }
}

/// Reads a schedule from a file.
pub fn read(path: &Path) -> Result<ContractSchedule, ScheduleError> {
    let table = |problem| ScheduleError::Table { path: path.into(), problem };
    let mut reader = csv::ReaderBuilder::new().trim(csv::Trim::All).comment(Some(b'#')).from_path(path).map_err(table)?;
    let headers = reader.headers().map_err(table)?.clone();
    let mut schedule = ContractSchedule::default();
    for record in reader.records() {
        let record = record.map_err(table)?;
        let line = record.position().map_or(0, csv::Position::line);
        let row: Row = record.deserialize(Some(&headers)).map_err(table)?;
        let later = schedule.steps.last().is_none_or(|(before, _)| row.time > *before);
        if !row.time.is_finite() || !later {
            return Err(ScheduleError::Time { path: path.into(), line, time: row.time });
        }
        let contract = Contract::new(budget(&row.time_budget), row.translation_error_bound, row.rotation_error_bound)
            .map_err(|problem| ScheduleError::Contract { path: path.into(), line, problem })?;
        schedule.steps.push((row.time, contract));
    }
    Ok(schedule)
}

/// Parses a time budget: seconds, as a number or with a unit. Anything else gives NaN, which [`Contract::new`] rejects.
fn budget(text: &str) -> f64 {
    Seconds::from_value(&text.into()).map_or(f64::NAN, |span| span.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read_text(text: &str) -> Result<ContractSchedule, ScheduleError> {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), text).unwrap();
        read(file.path())
    }

    #[test]
    fn each_contract_is_in_force_until_the_next() {
        let text =
            "time, time_budget, translation_error_bound, rotation_error_bound\n0,5ms,0,0\n# slower\n2.5, 0.01, 0.02, 0.1\n";
        let schedule = read_text(text).unwrap();
        assert_eq!(schedule.at(-1.0), None);
        assert_eq!(schedule.at(1.0), Contract::new(0.005, 0.0, 0.0).ok());
        assert_eq!(schedule.at(2.5), Contract::new(0.01, 0.02, 0.1).ok());
        assert_eq!(read_text("time,time_budget\n1,200us\n").unwrap().at(1.0), Contract::new(2e-4, 0.0, 0.0).ok());
    }

    #[test]
    fn errors_name_the_line() {
        let problem = |text: &str| read_text(text).unwrap_err().to_string();
        assert!(problem("time,time_budget\n0,5ms\n0,6ms\n").contains("line 3: time 0"));
        assert!(problem("time,time_budget\n0,soon\n").contains("line 2"));
        assert!(problem("time,time_budget,bound\n0,5ms,1\n").contains("columns time (s), time_budget"));
        assert!(problem("time,time_budget\n0\n").contains("line"));
        assert!(read(Path::new("no/such.csv")).unwrap_err().to_string().contains("no/such.csv"));
    }
}
