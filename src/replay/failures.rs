//! Counts scans that failed, by kind of failure, and keeps the reason of the first of each kind.

use std::collections::BTreeMap;

use crate::odometry::FailureReason;

/// Failures by kind, sorted by their codes.
#[derive(Clone, Debug, Default)]
pub struct Failures(BTreeMap<String, Kind>);

/// Failures of one kind.
#[derive(Clone, Debug, Default)]
struct Kind {
    count: usize,
    /// Reason of the first.
    first: String,
}

impl Failures {
    /// Adds a failure: the code of its kind, and its reason as text.
    pub fn add(&mut self, code: &str, reason: &str) {
        let kind = self.0.entry(code.to_owned()).or_insert_with(|| Kind { count: 0, first: reason.to_owned() });
        kind.count += 1;
    }

    /// Number of failures of each kind, by code.
    pub fn counts(&self) -> BTreeMap<&str, usize> {
        self.0.iter().map(|(code, kind)| (code.as_str(), kind.count)).collect()
    }

    /// Only the failures of scans that could not be used at all.
    #[must_use]
    pub fn unusable(&self) -> Self {
        let codes = [FailureReason::MalformedScan, FailureReason::TiltedMount].map(FailureReason::name);
        let unusable = self.0.iter().filter(|(code, _)| codes.contains(&code.as_str()));
        Self(unusable.map(|(code, kind)| (code.clone(), kind.clone())).collect())
    }

    /// Total number of failures.
    pub fn count(&self) -> usize {
        self.0.values().map(|kind| kind.count).sum()
    }

    /// One sentence for each kind of failure; `scans` is the total number of scans.
    pub fn descriptions(&self, scans: usize) -> Vec<String> {
        let sentence = |(code, Kind { count, first }): (&String, &Kind)| {
            if *code == FailureReason::MalformedScan.name() {
                format!("{count} of {scans} scans are malformed; the first: {first}")
            } else {
                format!("{count} of {scans} scans failed ({code}); the first: {first}")
            }
        };
        self.0.iter().map(sentence).collect()
    }
}
