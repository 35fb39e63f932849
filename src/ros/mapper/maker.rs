//! The mapping thread: keeps the map up to date, publishes it, and saves it.

use std::path::Path;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::Duration;

use super::feed::{MapCommand, SharedMapFromOdom};
use super::publishers::Publishers;
use crate::anytime::clock::Clock;
use crate::config::Config;
use crate::io::map_files::{MapFiles, MapPaths};
use crate::knobs::KnobValue as _;
use crate::mapping::{EvidenceGrid, LiveMap, PosedScan};
use crate::parallel::lock;
use crate::ros::log::Log;
use crate::ros::priority::lower_priority;
use crate::ros::services::Reply;
use crate::scan::{Scan, Sectors};
use crate::time::Stamp;

/// Minimum time between two published maps.
const PERIOD: Duration = Duration::from_secs(1);
/// Minimum time between two published maps as a multiple of the time to make one: publishing takes at most a twentieth of the
/// time.
const PERIOD_FACTOR: u32 = 20;
/// Number of scans added to the grid at once, which takes some milliseconds.
const BATCH_SIZE: usize = 16;
/// Maximum delay of a map that is being redrawn; after it the incomplete map is published.
const MAX_DELAY: Duration = Duration::from_secs(5);

/// Everything that the mapping thread owns.
pub(super) struct MapMaker {
    config: Config,
    clock: Arc<dyn Clock>,
    log: Log,
    publishers: Publishers,
    map_from_odom: SharedMapFromOdom,
    map: LiveMap,
    /// Number of the odometry run.
    run: u64,
    /// Stamp of the newest scan.
    stamp: Stamp,
    /// Earliest time at which the next map may be published.
    next: Duration,
    /// Whether the map has pending work.
    has_more: bool,
    /// Whether the graph has changed since it was published.
    is_graph_new: bool,
    /// Number of self-hit sectors that have been logged.
    logged_self_hits: usize,
    has_logged_loop: bool,
}

impl MapMaker {
    pub(super) fn new(
        config: Config,
        clock: Arc<dyn Clock>,
        log: Log,
        publishers: Publishers,
        map_from_odom: SharedMapFromOdom,
    ) -> Self {
        let map = LiveMap::new(&config.matching, &config.rejection, config.mapping.resolution);
        let (run, stamp, next) = (0, Stamp::default(), Duration::ZERO);
        Self {
            config,
            clock,
            log,
            publishers,
            map_from_odom,
            map,
            run,
            stamp,
            next,
            has_more: false,
            is_graph_new: false,
            logged_self_hits: 0,
            has_logged_loop: false,
        }
    }

    /// Runs until a command ends it.
    pub(super) fn run(mut self, commands: &Receiver<MapCommand>) {
        lower_priority();
        while self.run_commands(commands) {
            self.has_more = self.map.work(BATCH_SIZE);
            self.share_map_from_odom();
            self.publish();
        }
        if self.config.mapping.save_on_exit {
            let _ = self.save(); // logged
        }
    }

    /// Waits for commands, unless there is pending work, and executes all of them. Returns `false` at the end.
    fn run_commands(&mut self, commands: &Receiver<MapCommand>) -> bool {
        let left = self.next.saturating_sub(self.clock.now()).max(PERIOD / 10);
        let mut next = commands.recv_timeout(if self.has_more { Duration::ZERO } else { left });
        loop {
            match next {
                Ok(MapCommand::Add(run, seen)) => self.add(run, *seen),
                Ok(MapCommand::Save(reply)) => drop(reply.send(self.save())), // the caller may be gone
                Ok(MapCommand::End) | Err(RecvTimeoutError::Disconnected) => return false,
                Err(RecvTimeoutError::Timeout) => return true,
            }
            next = commands.recv_timeout(Duration::ZERO);
        }
    }

    fn add(&mut self, run: u64, (posed_scan, measured): (PosedScan, Scan)) {
        (self.run, self.stamp) = (run, posed_scan.scan.stamp());
        self.is_graph_new |= self.map.add(posed_scan, &measured);
        let hits = self.map.self_hits();
        if hits.len() > self.logged_self_hits {
            self.logged_self_hits = hits.len();
            let sectors = Sectors(hits.to_vec()).to_value();
            self.log.warn(&format!(
                "some rays hit the robot itself and are left out of the map; to exclude them from matching as well, set the \
                 parameter scan/masked_sectors to {sectors}"
            ));
        }
    }

    /// Shares the pose of the odometry frame on the map with the matching thread.
    fn share_map_from_odom(&self) {
        *lock(&self.map_from_odom) = (self.run, self.map.map_from_odom());
    }

    /// Publishes graph and map when they are due. While the map is being redrawn, publishing waits for up to [`MAX_DELAY`].
    fn publish(&mut self) {
        let begun = self.clock.now();
        if begun < self.next || (self.has_more && begun < self.next + MAX_DELAY) {
            return;
        }
        if std::mem::take(&mut self.is_graph_new) {
            self.publishers.publish_graph(self.map.mapper(), self.stamp);
            self.log_first_loop();
        }
        let grid = self.map.changed_grid().and_then(EvidenceGrid::to_map);
        match grid {
            Some(Ok(grid)) => self.publishers.publish_map(&grid, self.stamp),
            Some(Err(problem)) => self.log.error(&format!("the map cannot be published: {problem}")),
            None => {}
        }
        let now = self.clock.now();
        self.next = begun + PERIOD.max(PERIOD_FACTOR * now.saturating_sub(begun));
    }

    /// Logs the first loop closure.
    fn log_first_loop(&mut self) {
        if !self.has_logged_loop && self.map.mapper().progress().loops > 0 {
            self.has_logged_loop = true;
            self.log.info("first loop closure: the map has been corrected (later ones are not logged)");
        }
    }

    /// Saves the map and logs the outcome.
    fn save(&mut self) -> Reply {
        let reply = self.try_save();
        match &reply {
            Ok(text) => self.log.info(text),
            Err(problem) => self.log.error(problem),
        }
        reply
    }

    fn try_save(&mut self) -> Reply {
        let knobs = &self.config.mapping;
        let paths = MapPaths::new(&Path::new(&knobs.directory).join(&knobs.name));
        let shown = std::path::absolute(&paths.yaml).unwrap_or_else(|_| paths.yaml.clone());
        let failed = |problem: &dyn std::fmt::Display| {
            format!(
                "the map is not saved: {problem}; it is still in memory: check mapping/directory and mapping/name, and try again"
            )
        };
        let mut files = MapFiles::create(paths).map_err(|problem| failed(&problem))?;
        self.map.settle();
        let Some(map) = self.map.grid().to_map() else {
            return Err("the map is not saved: it is empty, no scan has been added yet".into());
        };
        let map = map.map_err(|problem| failed(&problem))?;
        files.write(&map, &self.map.mapper().to_bytes()).map_err(|problem| failed(&problem))?;
        files.commit().map_err(|problem| failed(&problem))?;
        Ok(format!("the map is saved: {} ({} x {} cells of {} m)", shown.display(), map.width(), map.height(), map.resolution()))
    }
}
