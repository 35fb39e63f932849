//! The last test program: reports how many tests were skipped by the others, and why.
#![allow(clippy::unwrap_used, dead_code, unreachable_pub)]

#[path = "common/skipped.rs"]
mod skipped;

use std::collections::BTreeMap;
use std::io::{self, Write};

/// Set if everything that tests need is installed, as by `.ci/run`: then a skipped test is an error.
const ALL_TESTS: &str = "RUN_ALL_TESTS";
/// Reasons that no installation can remove: data beside the checkout, packages that Debian does not have, other programs.
const EXCUSES: [&str; 3] = ["../shared", "the package of", "too busy"];

#[test]
fn skipped_tests_are_counted() {
    let skipped = skipped::take_skipped();
    let mut reasons: BTreeMap<&str, usize> = BTreeMap::new();
    for line in &skipped {
        *reasons.entry(line.split_once(": ").unwrap().1).or_default() += 1;
    }
    let list: Vec<String> = reasons.iter().map(|(reason, count)| format!("{count} x {reason}")).collect();
    let list = if list.is_empty() { String::new() } else { format!(": {}", list.join("; ")) };
    // Bypass the test runner, which shows only the output of failing tests.
    writeln!(io::stderr(), "\nskipped tests: {}{list}", skipped.len()).unwrap();
    if std::env::var_os(ALL_TESTS).is_some() {
        let missing: Vec<_> = skipped.iter().filter(|line| !EXCUSES.iter().any(|excuse| line.contains(excuse))).collect();
        assert!(missing.is_empty(), "{ALL_TESTS} is set, and these did not run: {missing:#?}");
    }
}
