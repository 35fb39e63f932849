//! What came of making a map, for people and for machines.

use std::fmt::Write as _;
use std::time::Duration;

use comfy_table::{Table, presets};
use serde_json::{Value, json};

use crate::evaluation::trajectory::StampedPose;
use crate::knobs::KnobValue;
use crate::map::grid::{Cell, OccupancyGrid};
use crate::mapping::{Mapper, Progress};
use crate::scan::Sectors;

/// Time that the stages have taken.
#[derive(Clone, Copy, Debug, Default)]
pub struct Stages {
    /// Reading the bags and matching their scans.
    pub replay: Duration,
    /// Keyframes and the edges between them, while the bags are read.
    pub keyframes: Duration,
    /// Loops, and the poses that fit them.
    pub graph: Duration,
    /// Drawing.
    pub grid: Duration,
}

/// What is told of a map.
pub struct MapSummary {
    /// Scans.
    pub scans: usize,
    /// Way along the final path, m.
    pub distance: f64,
    /// Keyframes.
    pub keyframes: usize,
    /// Loops and residuals.
    pub progress: Progress,
    /// Columns and rows of the map.
    pub size: (usize, usize),
    /// Free space, m^2.
    pub area: f64,
    /// Where the laser sees the robot itself.
    pub self_hits: Sectors,
    /// Time by stage.
    pub stages: Stages,
    /// What the user should know.
    pub problems: Vec<String>,
}

impl MapSummary {
    /// Of a map that is done.
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
            distance: path.windows(2).map(|pair| pair[0].pose.between(&pair[1].pose).distance()).sum(),
            keyframes: mapper.keyframes().len(),
            progress: mapper.progress(),
            size: (map.width(), map.height()),
            area: free as f64 * map.resolution() * map.resolution(),
            self_hits,
            stages,
            problems,
        }
    }

    /// One JSON object.
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

    /// A table for people.
    pub fn to_text(&self) -> String {
        let Stages { replay, keyframes, graph, grid } = self.stages;
        let Progress { loops, outvoted, residual_before, residual_after } = self.progress;
        let mut table = Table::new();
        table.load_style(presets::NOTHING);
        table.add_row(["scans", &self.scans.to_string()]);
        table.add_row(["path", &format!("{:.2} m", self.distance)]);
        table.add_row(["keyframes", &self.keyframes.to_string()]);
        let contradicted = if outvoted > 0 { format!(", {outvoted} of them contradicted by the others") } else { String::new() };
        table.add_row(["loop edges", &format!("{loops}{contradicted}")]);
        if loops > 0 {
            table.add_row(["they miss", &format!("{residual_before:.3} m by odometry, {residual_after:.3} m on the map (RMS)")]);
        }
        table.add_row(["map", &format!("{} x {} cells, {:.1} m^2 free", self.size.0, self.size.1, self.area)]);
        if !self.self_hits.0.is_empty() {
            let sectors = self.self_hits.to_value();
            table.add_row(["the laser sees the robot", &format!("masked; for other runs: scan.masked_sectors={sectors}")]);
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
