//! Text files with one record of numbers per line: code shared by the readers of trajectories, relations and CARMEN logs.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use thiserror::Error;

use crate::time::Stamp;

/// Why a text file cannot be read.
#[derive(Debug, Error)]
pub enum TextFileError {
    /// The operating system cannot read the file.
    #[error("cannot read {}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        source: io::Error,
    },
    /// A line is invalid.
    #[error("{}:{line}: {problem}", path.display())]
    Line {
        /// The file.
        path: PathBuf,
        /// Number of the line, from 1.
        line: usize,
        /// What is wrong, and what to do about it.
        problem: String,
    },
    /// The file has no record.
    #[error("{} has no data: expected lines of `{expected}`", path.display())]
    Empty {
        /// The file.
        path: PathBuf,
        /// The columns of a record.
        expected: &'static str,
    },
}

/// Reads a whole text file.
pub(super) fn load(path: &Path, expected: &str) -> Result<String, TextFileError> {
    let bytes = fs::read(path).map_err(|source| TextFileError::Read { path: path.into(), source })?;
    String::from_utf8(bytes).map_err(|error| {
        let readable = &error.as_bytes()[..error.utf8_error().valid_up_to()];
        let line = readable.split(|byte| *byte == b'\n').count();
        let problem = format!("this is not text (is it a bag?): expected lines of `{expected}`");
        TextFileError::Line { path: path.into(), line, problem }
    })
}

/// Applies `parse` to the columns of each line; blank lines and `#` comments are skipped.
pub(super) fn records<T>(
    text: &str,
    path: &Path,
    mut parse: impl FnMut(&[&str]) -> Result<T, String>,
) -> Result<Vec<T>, TextFileError> {
    text.lines()
        .enumerate()
        .map(|(index, line)| (index + 1, line.split_whitespace().collect::<Vec<_>>()))
        .filter(|(_, columns)| columns.first().is_some_and(|first| !first.starts_with('#')))
        .map(|(line, columns)| parse(&columns).map_err(|problem| TextFileError::Line { path: path.into(), line, problem }))
        .collect()
}

/// Parses the numbers of a record, one for each of `names`.
pub(super) fn numbers<const N: usize>(names: [&str; N], columns: &[&str]) -> Result<[f64; N], String> {
    let mut numbers = [0.0; N];
    for ((number, name), text) in numbers.iter_mut().zip(names).zip(columns) {
        *number = text
            .parse()
            .ok()
            .filter(|number: &f64| number.is_finite())
            .ok_or_else(|| format!("{name} is `{text}`: expected a finite number (fix or remove the line)"))?;
    }
    Ok(numbers)
}

/// Parses a stamp in decimal seconds (`1795374577.083470347` or `1.795374577083470347e+09`), rounded to the nearest nanosecond.
///
/// Does not use `f64`, which for today's dates would be off by up to 120 ns.
pub(super) fn stamp(text: &str) -> Result<Stamp, String> {
    nanoseconds(text)
        .map(Stamp::from_nanoseconds)
        .ok_or_else(|| format!("the stamp is `{text}`: expected seconds such as 1795374577.083470347"))
}

fn nanoseconds(text: &str) -> Option<i64> {
    let unsigned = text.strip_prefix(['-', '+']).unwrap_or(text);
    let (mantissa, exponent) = unsigned.split_once(['e', 'E']).unwrap_or((unsigned, "0"));
    let (whole, fraction) = mantissa.split_once('.').unwrap_or((mantissa, ""));
    let digits = [whole, fraction].concat().into_bytes();
    if digits.is_empty() || !digits.iter().all(u8::is_ascii_digit) {
        return None;
    }
    // Moving the decimal point nine places further to the right converts seconds to nanoseconds.
    let point = i64::try_from(whole.len()).ok()? + i64::from(exponent.parse::<i32>().ok()?) + 9;
    let kept = usize::try_from(point.max(0)).ok()?;
    let mut value = digits.iter().take(kept).try_fold(0_i64, |value, digit| push_digit(value, digit - b'0'))?;
    if value != 0 {
        let missing = u32::try_from(kept.saturating_sub(digits.len())).ok()?;
        value = value.checked_mul(10_i64.checked_pow(missing)?)?;
    }
    if point >= 0 && digits.get(kept).is_some_and(|digit| *digit >= b'5') {
        value = value.checked_add(1)?;
    }
    Some(if text.starts_with('-') { -value } else { value })
}

fn push_digit(value: i64, digit: u8) -> Option<i64> {
    value.checked_mul(10)?.checked_add(i64::from(digit))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn stamps_are_parsed_in_every_notation() {
        for (text, expected) in [
            ("1795374577.083470347", 1_795_374_577_083_470_347),
            ("1.795374577083470347e+09", 1_795_374_577_083_470_347),
            ("91.199600", 91_199_600_000),
            ("91", 91_000_000_000),
            ("+.5", 500_000_000),
            ("-1.5", -1_500_000_000),
            ("5.", 5_000_000_000),
            ("25E-1", 2_500_000_000),
            ("0.0000000004", 0),
            ("0.0000000005", 1),
            ("1e-10", 0),
            ("5e-10", 1),
            ("0e2000000000", 0),
            ("000000000000000000000000001", 1_000_000_000),
        ] {
            assert_eq!(nanoseconds(text), Some(expected), "{text}");
        }
    }

    #[test]
    fn invalid_stamps_are_rejected() {
        for text in
            ["", ".", "-", "e5", "nan", "inf", "1e", "1e+", "1.2.3", "--1", "1,5", "9223372037", "1e300", "1e2000000000", "٣"]
        {
            assert_eq!(nanoseconds(text), None, "{text}");
        }
    }

    proptest! {
        #[test]
        fn a_printed_stamp_is_parsed_back_unchanged(ns in -i64::MAX..i64::MAX) {
            prop_assert_eq!(nanoseconds(&Stamp::from_nanoseconds(ns).to_string()), Some(ns));
        }
    }
}
