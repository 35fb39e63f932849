//! Formats a summary as text.

use std::collections::BTreeSet;
use std::fmt;
use std::time::{Duration, UNIX_EPOCH};

use super::BagSummary;
use crate::text_table::TextTable;

impl fmt::Display for BagSummary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.write(f, None)
    }
}

impl BagSummary {
    /// Formats the summary for a terminal of `width` columns; `None` for unlimited width.
    pub fn to_text(&self, width: Option<usize>) -> String {
        let mut text = String::new();
        let _ = self.write(&mut text, width); // writing to a string never fails
        text
    }

    fn write(&self, f: &mut impl fmt::Write, width: Option<usize>) -> fmt::Result {
        let chunks: Vec<String> = self.chunks.iter().map(|(kind, chunks)| format!("{chunks} chunks, {kind}")).collect();
        writeln!(f, "{}", self.path)?;
        writeln!(f, "{:.1} MB ({})", self.size_bytes as f64 * 1e-6, chunks.join("; "))?;
        if let Some(start) = self.start_s.and_then(|start| Duration::try_from_secs_f64(start).ok()) {
            let start = humantime::format_rfc3339_millis(UNIX_EPOCH + start);
            writeln!(f, "{} messages in {:.3} s, starting at {start}", self.messages, self.duration_s)?;
        }
        if !self.topics.is_empty() {
            writeln!(f, "\n{}", self.topic_table().render(width))?;
        }
        if !self.lasers.is_empty() {
            writeln!(f, "\n{}", self.laser_table().render(width))?;
        }
        if !self.clouds.is_empty() {
            writeln!(f, "\n{}", self.cloud_table().render(width))?;
        }
        if !self.odometry.is_empty() {
            writeln!(f, "\n{}", self.odometry_table().render(width))?;
        }
        match self.problems.as_slice() {
            [] => write!(f, "\nno problems found"),
            problems => {
                write!(f, "\nproblems found:")?;
                problems.iter().try_for_each(|problem| write!(f, "\n  - {problem}"))
            }
        }
    }

    fn topic_table(&self) -> TextTable {
        let header = ["topic", "type", "messages", "rate [Hz]", "longest interval [s]", "gaps", "stamps back", "repeated"];
        let rows = self.topics.iter().map(|topic| {
            vec![
                topic.topic.clone(),
                topic.message_type.clone(),
                topic.messages.to_string(),
                topic.rate_hz.map_or("-".into(), |rate| format!("{rate:.2}")),
                topic.longest_interval_s.map_or("-".into(), |interval| format!("{interval:.3}")),
                topic.gaps.to_string(),
                topic.stamps_back.to_string(),
                topic.stamps_repeated.to_string(),
            ]
        });
        TextTable::new(&header, rows, 2)
    }

    fn laser_table(&self) -> TextTable {
        let header = [
            "scans on",
            "frame",
            "beams",
            "view [deg]",
            "from [deg]",
            "step [deg]",
            "range [m]",
            "valid rays",
            "usable",
            "unusable",
        ];
        let rows = self.lasers.iter().map(|laser| {
            vec![
                laser.topic.clone(),
                join_names(&laser.usability.frames),
                laser.beams.to_string(),
                format!("{:.1}", laser.field_of_view_deg),
                format!("{:.1}", laser.angle_min_deg),
                format!("{:.3}", laser.increment_deg),
                format!("{:.2} to {:.2}", laser.range_min_m, laser.range_max_m),
                format!("{:.1} %", laser.valid_percent),
                laser.usability.usable.to_string(),
                laser.usability.unusable.to_string(),
            ]
        });
        TextTable::new(&header, rows, 2)
    }

    fn cloud_table(&self) -> TextTable {
        let header = ["clouds on", "frame", "points", "heights [m]", "usable", "unusable"];
        let rows = self.clouds.iter().map(|cloud| {
            let heights = cloud.lowest_m.zip(cloud.highest_m).map(|(low, high)| format!("{low:.2} to {high:.2}"));
            vec![
                cloud.topic.clone(),
                join_names(&cloud.usability.frames),
                format!("{} x {}", cloud.width, cloud.height),
                heights.unwrap_or("-".into()),
                cloud.usability.usable.to_string(),
                cloud.usability.unusable.to_string(),
            ]
        });
        TextTable::new(&header, rows, 2)
    }

    fn odometry_table(&self) -> TextTable {
        let rows = self
            .odometry
            .iter()
            .map(|odometry| vec![odometry.topic.clone(), join_names(&odometry.frames), join_names(&odometry.child_frames)]);
        TextTable::new(&["odometry on", "frame", "child frame"], rows, 3)
    }
}

fn join_names(names: &BTreeSet<String>) -> String {
    let names: Vec<&str> = names.iter().map(|name| if name.is_empty() { "(none)" } else { name }).collect();
    names.join(", ")
}
