//! A summary for people.

use std::collections::BTreeSet;
use std::fmt;
use std::time::{Duration, UNIX_EPOCH};

use comfy_table::{CellAlignment, Table, presets};

use super::BagSummary;

impl fmt::Display for BagSummary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let chunks: Vec<String> = self.chunks.iter().map(|(kind, chunks)| format!("{chunks} chunks, {kind}")).collect();
        writeln!(f, "{}", self.path)?;
        writeln!(f, "{:.1} MB ({})", self.size_bytes as f64 * 1e-6, chunks.join("; "))?;
        if let Some(start) = self.start_s.and_then(|start| Duration::try_from_secs_f64(start).ok()) {
            let start = humantime::format_rfc3339_millis(UNIX_EPOCH + start);
            writeln!(f, "{} messages in {:.3} s from {start}", self.messages, self.duration_s)?;
        }
        if !self.topics.is_empty() {
            writeln!(f, "\n{}", self.topic_table())?;
        }
        if !self.lasers.is_empty() {
            writeln!(f, "\n{}", self.laser_table())?;
        }
        if !self.clouds.is_empty() {
            writeln!(f, "\n{}", self.cloud_table())?;
        }
        if !self.odometry.is_empty() {
            writeln!(f, "\n{}", self.odometry_table())?;
        }
        match self.problems.as_slice() {
            [] => write!(f, "\nno problems found"),
            problems => {
                write!(f, "\nproblems found:")?;
                problems.iter().try_for_each(|problem| write!(f, "\n  - {problem}"))
            }
        }
    }
}

impl BagSummary {
    fn topic_table(&self) -> Table {
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
        table(&header, rows, 2)
    }

    fn laser_table(&self) -> Table {
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
                listed(&laser.frames),
                laser.beams.to_string(),
                format!("{:.1}", laser.field_of_view_deg),
                format!("{:.1}", laser.angle_min_deg),
                format!("{:.3}", laser.increment_deg),
                format!("{:.2} to {:.2}", laser.range_min_m, laser.range_max_m),
                format!("{:.1} %", laser.valid_percent),
                laser.usable.to_string(),
                laser.unusable.to_string(),
            ]
        });
        table(&header, rows, 2)
    }

    fn cloud_table(&self) -> Table {
        let header = ["clouds on", "frame", "points", "heights in it [m]", "usable", "unusable"];
        let rows = self.clouds.iter().map(|cloud| {
            let heights = cloud.lowest_m.zip(cloud.highest_m).map(|(low, high)| format!("{low:.2} to {high:.2}"));
            vec![
                cloud.topic.clone(),
                listed(&cloud.frames),
                format!("{} x {}", cloud.width, cloud.height),
                heights.unwrap_or("-".into()),
                cloud.usable.to_string(),
                cloud.unusable.to_string(),
            ]
        });
        table(&header, rows, 2)
    }

    fn odometry_table(&self) -> Table {
        let rows = self
            .odometry
            .iter()
            .map(|odometry| vec![odometry.topic.clone(), listed(&odometry.frames), listed(&odometry.child_frames)]);
        table(&["odometry on", "frame", "child frame"], rows, 3)
    }
}

/// A table whose columns from `first_number` on are flush right.
fn table(header: &[&str], rows: impl Iterator<Item = Vec<String>>, first_number: usize) -> Table {
    let mut table = Table::new();
    table.load_style(presets::UTF8_BORDERS_ONLY).set_header(header.to_vec()).add_rows(rows);
    for column in table.column_iter_mut().skip(first_number) {
        column.set_cell_alignment(CellAlignment::Right);
    }
    table
}

fn listed(names: &BTreeSet<String>) -> String {
    let names: Vec<&str> = names.iter().map(|name| if name.is_empty() { "(none)" } else { name }).collect();
    names.join(", ")
}
