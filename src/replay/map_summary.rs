//! Summary of a mapping run, as text and as JSON.

use std::fmt::Write as _;
use std::time::Duration;

use comfy_table::{Table, presets};
use serde_json::{Value, json};

use super::path_length;
use crate::evaluation::trajectory::StampedPose;
use crate::knobs::KnobValue;
use crate::map::grid::{Cell, OccupancyGrid};
use crate::mapping::{Mapper, Progress};
use crate::scan::Sectors;

/// Computation time of the stages of mapping.
#[derive(Clone, Copy, Debug, Default)]
pub struct Stages {
    /// Reading the bags and matching their scans.
    pub replay: Duration,
    /// Creating keyframes and the edges between consecutive ones, while the bags are read.
    pub keyframes: Duration,
    /// Closing loops, and optimizing the pose graph.
    pub graph: Duration,
    /// Rendering the occupancy grid.
    pub grid: Duration,
}

/// Summary of a mapping run.
pub struct MapSummary {
    /// Number of scans.
    pub scans: usize,
    /// Length of the final path, m.
    pub distance: f64,
    /// Number of keyframes.
    pub keyframes: usize,
    /// Loop edges and residuals.
    pub progress: Progress,
    /// Columns and rows of the map.
    pub size: (usize, usize),
    /// Free area, m^2.
    pub area: f64,
    /// Sectors in which the laser sees the robot itself.
    pub self_hits: Sectors,
    /// Computation time by stage.
    pub stages: Stages,
    /// Warnings for the user.
    pub problems: Vec<String>,
}

impl MapSummary {
    /// Summarizes a completed map.
    pub fn new(
        mapper: &Mapper,
        path: &[StampedPose],
        map: &OccupancyGrid,
        self_hits: Sectors,
        stages: Stages,
        problems: Vec<String>,
    ) -> Self {
        let free = map.cells().iter().filter(|cell| **cell == Cell::Free).count();
        Self {
            scans: path.len(),
            distance: path_length(path),
            keyframes: mapper.keyframes().len(),
            progress: mapper.progress(),
            size: (map.width(), map.height()),
            area: free as f64 * map.resolution() * map.resolution(),
            self_hits,
            stages,
            problems,
        }
    }

    /// Formats the summary as a JSON object.
    pub fn to_json(&self) -> Value {
        let Stages { replay, keyframes, graph, grid } = self.stages;
        let Progress { loops, outvoted, residual_before, residual_after } = self.progress;
        json!({
            "scans": self.scans,
            "distance_m": self.distance,
            "keyframes": self.keyframes,
            "loops": loops,
            "outvoted_loops": outvoted,
            "loop_residual_m": {"before": residual_before, "after": residual_after},
            "size": [self.size.0, self.size.1],
            "free_area_m2": self.area,
            "self_hits": self.self_hits.to_value(),
            "time_s": {
                "replay": replay.as_secs_f64(),
                "keyframes": keyframes.as_secs_f64(),
                "graph": graph.as_secs_f64(),
                "grid": grid.as_secs_f64(),
            },
            "problems": self.problems,
        })
    }

    /// Formats the summary as a table.
    pub fn to_text(&self) -> String {
        let Stages { replay, keyframes, graph, grid } = self.stages;
        let Progress { loops, outvoted, residual_before, residual_after } = self.progress;
        let mut table = Table::new();
        table.load_style(presets::NOTHING);
        table.add_row(["scans", &self.scans.to_string()]);
        table.add_row(["path length", &format!("{:.2} m", self.distance)]);
        table.add_row(["keyframes", &self.keyframes.to_string()]);
        let outliers =
            if outvoted > 0 { format!(", {outvoted} of them outliers that contradict the others") } else { String::new() };
        table.add_row(["loop edges", &format!("{loops}{outliers}")]);
        if loops > 0 {
            let text = format!("RMS {residual_before:.3} m with odometry alone, {residual_after:.3} m after optimization");
            table.add_row(["loop residual", &text]);
        }
        table.add_row(["map", &format!("{} x {} cells, {:.1} m^2 free", self.size.0, self.size.1, self.area)]);
        if !self.self_hits.0.is_empty() {
            let sectors = self.self_hits.to_value();
            table.add_row(["self hits", &format!("masked; to mask them in other runs: scan.masked_sectors={sectors}")]);
        }
        let [replay, keyframes, graph, grid] = [replay, keyframes, graph, grid].map(|time| time.as_secs_f64());
        table.add_row([
            "time",
            &format!("replay {replay:.2} s, keyframes {keyframes:.2} s, graph {graph:.2} s, grid {grid:.2} s"),
        ]);
        let mut text = format!("{table}\n");
        for problem in &self.problems {
            let _ = writeln!(text, "note: {problem}");
        }
        text
    }
}
