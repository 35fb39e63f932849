//! The mapping thread: keeps the map up to date, publishes it, and saves it.

use std::path::Path;
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::sync::{Arc, PoisonError};
use std::time::Duration;

use super::feed::{Order, Place};
use super::publishers::Publishers;
use crate::anytime::clock::Clock;
use crate::config::Config;
use crate::io::map_files::{MapFiles, MapPaths};
use crate::knobs::KnobValue as _;
use crate::mapping::{EvidenceGrid, LiveMap, Sighting};
use crate::ros::log::Log;
use crate::ros::priority::give_way;
use crate::ros::services::Reply;
use crate::scan::{Scan, Sectors};
use crate::time::Stamp;

/// Least time from one published map to the next, ...
const PERIOD: Duration = Duration::from_secs(1);
/// ... as a multiple of the time that making one takes, too: publishing is a twentieth of the work at most.
const PERIODS_OF_WORK: u32 = 20;
/// Scans drawn at once: some milliseconds.
const PORTION: usize = 16;
/// An incomplete map is published after this time at the latest.
const MAX_DELAY: Duration = Duration::from_secs(5);

/// Everything the mapping thread owns.
pub(super) struct MapMaker {
    config: Config,
    clock: Arc<dyn Clock>,
    log: Log,
    publishers: Publishers,
    place: Place,
    map: LiveMap,
    /// Number of the odometry's run.
    run: u64,
    /// Of the newest scan.
    stamp: Stamp,
    /// Reading of the clock at which the next map may be published.
    next: Duration,
    /// The map has work left.
    has_more: bool,
    is_graph_new: bool,
    self_hits_told: usize,
    has_told_loop: bool,
}

impl MapMaker {
    pub(super) fn new(config: Config, clock: Arc<dyn Clock>, log: Log, publishers: Publishers, place: Place) -> Self {
        let map = LiveMap::new(&config.matching, &config.rejection, config.mapping.resolution);
        let (run, stamp, next) = (0, Stamp::default(), Duration::ZERO);
        Self {
            config,
            clock,
            log,
            publishers,
            place,
            map,
            run,
            stamp,
            next,
            has_more: false,
            is_graph_new: false,
            self_hits_told: 0,
            has_told_loop: false,
        }
    }

    /// Works until it is told to end.
    pub(super) fn run(mut self, orders: &Receiver<Order>) {
        give_way();
        while self.take_orders(orders) {
            self.has_more = self.map.work(PORTION);
            self.say_place();
            self.publish();
        }
        if self.config.mapping.save_on_exit {
            let _ = self.save(); // logged
        }
    }

    /// Waits for orders, unless there is more to do anyway, and takes all there are; answers whether to go on.
    fn take_orders(&mut self, orders: &Receiver<Order>) -> bool {
        let left = self.next.saturating_sub(self.clock.now()).max(PERIOD / 10);
        let mut next = orders.recv_timeout(if self.has_more { Duration::ZERO } else { left });
        loop {
            match next {
                Ok(Order::Add(run, seen)) => self.add(run, *seen),
                Ok(Order::Save(reply)) => drop(reply.send(self.save())), // who asked may be gone
                Ok(Order::End) | Err(RecvTimeoutError::Disconnected) => return false,
                Err(RecvTimeoutError::Timeout) => return true,
            }
            next = orders.recv_timeout(Duration::ZERO);
        }
    }

    fn add(&mut self, run: u64, (sighting, measured): (Sighting, Scan)) {
        (self.run, self.stamp) = (run, sighting.scan.stamp());
        self.is_graph_new |= self.map.add(sighting, &measured);
        let hits = self.map.self_hits();
        if hits.len() > self.self_hits_told {
            self.self_hits_told = hits.len();
            let sectors = Sectors(hits.to_vec()).to_value();
            self.log.warn(&format!(
                "some rays see the robot itself: they are not drawn; to match without them, too, set the parameter scan/masked_sectors to \
                 {sectors}"
            ));
        }
    }

    /// Tells the matching thread where the odometry's frame is on the map.
    fn say_place(&self) {
        *self.place.lock().unwrap_or_else(PoisonError::into_inner) = (self.run, self.map.map_from_odom());
    }

    /// A map that is being drawn anew is not shown half done, if it takes no longer than that.
    fn publish(&mut self) {
        let begun = self.clock.now();
        if begun < self.next || (self.has_more && begun < self.next + MAX_DELAY) {
            return;
        }
        if std::mem::take(&mut self.is_graph_new) {
            self.publishers.publish_graph(self.map.mapper(), self.stamp);
            self.tell_first_loop();
        }
        let grid = self.map.changed_grid().and_then(EvidenceGrid::to_map);
        match grid {
            Some(Ok(grid)) => self.publishers.publish_map(&grid, self.stamp),
            Some(Err(problem)) => self.log.error(&format!("the map cannot be published: {problem}")),
            None => {}
        }
        let now = self.clock.now();
        self.next = begun + PERIOD.max(PERIODS_OF_WORK * now.saturating_sub(begun));
    }

    /// The first loop is news to whoever waits for one.
    fn tell_first_loop(&mut self) {
        if !self.has_told_loop && self.map.mapper().progress().loops > 0 {
            self.has_told_loop = true;
            self.log.info("the first loop is closed: the map is corrected by it, and by those to come");
        }
    }

    /// Saves the map; what comes of it is logged as well.
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
                "the map is not saved: {problem} (parameters mapping/directory and mapping/name say where); it is kept, try again"
            )
        };
        let mut files = MapFiles::create(paths).map_err(|problem| failed(&problem))?;
        self.map.settle();
        let Some(map) = self.map.grid().to_map() else { return Err("the map is not saved: nothing has been seen yet".into()) };
        let map = map.map_err(|problem| failed(&problem))?;
        files.write(&map, &self.map.mapper().to_bytes()).map_err(|problem| failed(&problem))?;
        files.commit().map_err(|problem| failed(&problem))?;
        Ok(format!("the map is saved: {} ({} x {} cells of {} m)", shown.display(), map.width(), map.height(), map.resolution()))
    }
}
