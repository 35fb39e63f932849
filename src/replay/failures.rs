//! What kinds of scans came to nothing, how many of each, and what was wrong with the first.

use std::collections::BTreeMap;

use crate::odometry::FailureReason;

/// Failures by kind, in the order of their codes.
#[derive(Clone, Debug, Default)]
pub struct Failures(BTreeMap<String, Kind>);

/// Those of one kind.
#[derive(Clone, Debug, Default)]
struct Kind {
    count: usize,
    /// The first in words.
    first: String,
}

impl Failures {
    /// Adds one: its kind's code, and what was wrong in words.
    pub fn add(&mut self, code: &str, reason: &str) {
        let kind = self.0.entry(code.to_owned()).or_insert_with(|| Kind { count: 0, first: reason.to_owned() });
        kind.count += 1;
    }

    /// How many there are of each kind, by code.
    pub fn counts(&self) -> BTreeMap<&str, usize> {
        self.0.iter().map(|(code, kind)| (code.as_str(), kind.count)).collect()
    }

    /// Those of scans that could not be used at all.
    #[must_use]
    pub fn unusable(&self) -> Self {
        let codes = [FailureReason::MalformedScan, FailureReason::TiltedMount].map(FailureReason::name);
        let found = self.0.iter().filter(|(code, _)| codes.contains(&code.as_str()));
        Self(found.map(|(code, kind)| (code.clone(), kind.clone())).collect())
    }

    /// How many there are.
    pub fn count(&self) -> usize {
        self.0.values().map(|kind| kind.count).sum()
    }

    /// One sentence for each kind, of so many `scans`.
    pub fn in_words(&self, scans: usize) -> Vec<String> {
        let sentence = |(code, Kind { count, first }): (&String, &Kind)| {
            if *code == FailureReason::MalformedScan.name() {
                format!("{count} of {scans} scans are malformed, the first: {first}")
            } else {
                format!("{count} of {scans} scans failed ({code}), the first: {first}")
            }
        };
        self.0.iter().map(sentence).collect()
    }
}
