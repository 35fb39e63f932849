//! A map that is made while the robot drives: work in small portions, memory by the area seen.
//!
//! New keyframes look for places of earlier as they come; once one is found that moves the map, the rest of the path looks again. The grid
//! is kept up to date scan by scan: one whose place has changed is taken out of it and drawn anew. Of each place the newest scans are
//! kept, so that what has moved away vanishes, and of keyframes the first, which have drifted least.

use std::collections::{BTreeMap, VecDeque};

use super::grid::EvidenceGrid;
use super::keyframe::{Passage, Sighting, Spacing};
use super::loops::{WINDOWS, Ways};
use super::{Drawn, FINALLY, Mapper, ROUGHLY, SelfHits};
use crate::geometry::{Point, Pose2, wrap_angle};
use crate::matching::MatchingKnobs;
use crate::matching::classic::rejection::RejectionKnobs;
use crate::scan::{Mask, Scan, ScanKnobs, Sector, Sectors};

/// After this way, m, the newest keyframes look for places of earlier: half of what these look over at once.
const LOOK: f64 = 1.0;
/// Poses that new edges say to be off by less than this, m, ...
const SLIGHT: f64 = 0.01;
/// ... and this, rad, are left alone: no wall of the grid would move.
const SLIGHT_TURN: f64 = 0.003;
/// Edges that say more than this, m, ...
const NEWS: f64 = 0.1;
/// ... or this, rad, are news for the whole path.
const NEWS_TURN: f64 = 0.02;
/// Rays of the lasers that [`Spacing::DRAWN`] is for; with more of them fewer scans show as much.
const FEW_RAYS: usize = 361;
/// Side of a place that scans are kept of, m.
const PLACE: f64 = 0.5;
/// Keyframes of a place are told apart by the eighth that the laser looked to; so many are kept with what they saw.
const VIEWS_KEPT: usize = 3;
/// The last keyframes are kept for what comes next: over this way, m.
const RECENT: f64 = 25.0;
/// A scan whose place has changed by this part of a cell is drawn anew.
const PART_OF_CELL: f64 = 0.3;
/// Turns count by what they do at this distance, m.
const LEVER: f64 = 5.0;
/// A run of which nobody knows where on the map it began is looked for when it has become so long, m, and then each time it has doubled.
const FIRST_JOIN: f64 = 6.0;
/// From one look for the robot in its own scans to the next, keyframes.
const SELF_HIT_PERIOD: usize = 25;

/// Of which run, where, and which way the laser looked.
type Place = (usize, i64, i64, i64);

/// A map of what is seen while the robot drives.
pub struct LiveMap {
    mapper: Mapper,
    grid: EvidenceGrid,
    resolution: f64,
    /// Runs so far.
    runs: usize,
    /// Scans of each place, by their indices among those drawn.
    scans: BTreeMap<Place, VecDeque<usize>>,
    /// Keyframes of each place that are kept with what they saw.
    views: BTreeMap<Place, usize>,
    /// Keyframes from here on are still with what they saw.
    oldest_recent: usize,
    /// Way at which the newest keyframes look for places of earlier.
    next_look: f64,
    /// The first keyframe that has not looked.
    unlooked: usize,
    /// Index of the window that the whole path is to look through again; past the end: none.
    window: usize,
    /// Way of the run at which its place on the map is looked for.
    next_join: f64,
    /// The first scan that may not be in its place in the grid.
    next_scan: usize,
    /// Whether the grid has changed since it was last asked for.
    has_changed: bool,
    self_hits: SelfHits,
    mask: Mask,
    masked: Vec<Sector>,
}

impl LiveMap {
    /// An empty map. `resolution`: the side of a cell of its grid, m.
    pub fn new(matching: &MatchingKnobs, rejection: &RejectionKnobs, resolution: f64) -> Self {
        Self {
            mapper: Mapper::new(matching, rejection),
            grid: EvidenceGrid::new(resolution),
            resolution,
            runs: 0,
            scans: BTreeMap::new(),
            views: BTreeMap::new(),
            oldest_recent: 0,
            next_look: LOOK,
            unlooked: 0,
            window: WINDOWS.len(),
            next_join: f64::INFINITY,
            next_scan: 0,
            has_changed: false,
            self_hits: SelfHits::default(),
            mask: Mask::new(&ScanKnobs::default()),
            masked: Vec::new(),
        }
    }

    /// Takes a scan, `measured` as the laser saw it; answers whether it has become a keyframe.
    pub fn add(&mut self, sighting: Sighting, measured: &Scan) -> bool {
        self.self_hits.add(measured, &sighting.odom_from_laser());
        let is_start = sighting.passage == Passage::Start || self.mapper.keyframes.is_empty();
        let rays = sighting.scan.len();
        let many = (rays as f64 / FEW_RAYS as f64).max(1.0);
        self.mapper.drawn_spacing = Spacing { distance: many * Spacing::DRAWN.distance, angle: many * Spacing::DRAWN.angle };
        self.runs += usize::from(is_start);
        let (before, is_first) = (self.mapper.drawn.len(), self.mapper.keyframes.is_empty());
        let is_keyframe = self.mapper.add(sighting);
        self.mapper.steps.drain(..self.mapper.steps.len().saturating_sub(1)); // nobody asks for the whole path
        (before..self.mapper.drawn.len()).for_each(|scan| self.keep(scan));
        if is_start {
            self.next_join = if is_first { f64::INFINITY } else { self.way() + FIRST_JOIN };
        }
        if is_keyframe {
            self.let_old_views_go();
            self.look_for_robot();
            self.look();
        }
        is_keyframe
    }

    /// Way to the newest keyframe, m.
    fn way(&self) -> f64 {
        self.mapper.keyframes.last().map_or(0.0, |keyframe| keyframe.way)
    }

    /// Notes a scan for its place; the oldest one there may go for it.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // ten at most
    fn keep(&mut self, scan: usize) {
        let step = self.mapper.drawn[scan].step;
        let map_from_laser = self.mapper.placer().place(&step, &step.odom_from_laser);
        mask_out(&mut self.mapper.drawn[scan].points, &self.mask);
        // Of each quarter that the laser looked to: those of one drive through it.
        let kept = (PLACE / self.mapper.drawn_spacing.distance).ceil() as usize;
        let scans = self.scans.entry(place(self.runs, &map_from_laser, PLACE, 4)).or_default();
        scans.push_back(scan);
        if scans.len() > kept
            && let Some(oldest) = scans.pop_front()
        {
            let Drawn { points, at, .. } = &mut self.mapper.drawn[oldest];
            if let Some(at) = at.take() {
                self.grid.erase(points, &at);
            }
            *points = Vec::new();
        }
        self.next_scan = self.next_scan.min(scan);
    }

    /// Of keyframes that are not among the last any more, those of places that others have seen let go of what they saw.
    fn let_old_views_go(&mut self) {
        let recent = self.way() - RECENT;
        while self.mapper.keyframes[self.oldest_recent].way < recent {
            let run = self.mapper.keyframes[self.oldest_recent].run;
            let place = place(run, &self.mapper.graph.poses()[self.oldest_recent], 2.0 * PLACE, 8);
            let views = self.views.entry(place).or_default();
            if *views < VIEWS_KEPT {
                *views += 1;
            } else {
                self.mapper.keyframes[self.oldest_recent].view = None;
                self.mapper.loops.forget(self.oldest_recent);
            }
            self.oldest_recent += 1;
        }
    }

    /// Rays that see the robot are drawn no more, nor stay in the grid.
    fn look_for_robot(&mut self) {
        if !self.mapper.keyframes.len().is_multiple_of(SELF_HIT_PERIOD) {
            return;
        }
        let found = self.self_hits.found();
        if found.len() <= self.masked.len() {
            return;
        }
        self.masked.clone_from(&found);
        self.mask = Mask::new(&ScanKnobs { masked_sectors: Sectors(found), ..ScanKnobs::default() });
        for Drawn { points, at, .. } in &mut self.mapper.drawn {
            if let Some(at) = at.take() {
                self.grid.erase(points, &at);
            }
            mask_out(points, &self.mask);
        }
        self.next_scan = 0;
    }

    /// The newest keyframes look for places of earlier.
    fn look(&mut self) {
        if self.way() >= self.next_join {
            let run = self.mapper.keyframes.last().map(|keyframe| keyframe.run);
            let begun = self.mapper.keyframes.iter().find(|keyframe| Some(keyframe.run) == run).map_or(0.0, |first| first.way);
            self.next_join = self.way() + (self.way() - begun);
            if self.mapper.unplaced_runs() == 0 {
                self.next_join = f64::INFINITY;
            } else if self.mapper.join_runs() {
                (self.next_scan, self.window) = (0, 0);
            }
        }
        if self.way() < self.next_look {
            return;
        }
        self.next_look = self.way() + LOOK;
        let newest = self.mapper.keyframes.len() - 1;
        let error = self.mapper.look_around(self.unlooked);
        self.unlooked = newest;
        let is_beyond = |distance: f64, turn: f64| error.distance() > distance || error.theta.abs() > turn;
        if is_beyond(SLIGHT, SLIGHT_TURN) {
            self.mapper.graph.optimize(ROUGHLY);
            self.next_scan = 0;
        }
        if is_beyond(NEWS, NEWS_TURN) {
            self.window = 0;
        }
    }

    /// A portion of the work that is left: drawing some `scans`, or, where all are drawn, a look over the whole path. Answers whether there is
    /// more to do.
    pub fn work(&mut self, scans: usize) -> bool {
        if self.draw(scans) {
            return true;
        }
        let has_news = self.improve();
        if has_news {
            self.next_scan = 0;
        }
        has_news
    }

    /// A look over the whole path, if there are news; answers whether there were.
    fn improve(&mut self) -> bool {
        let has_news = self.window < WINDOWS.len();
        if has_news {
            self.mapper.window = self.window;
            self.mapper.improve();
            self.window = self.mapper.window;
        }
        has_news
    }

    /// Draws some scans that are not where they belong; answers whether there are more.
    fn draw(&mut self, mut most: usize) -> bool {
        if self.next_scan >= self.mapper.drawn.len() {
            return false;
        }
        // One run is all on the map.
        let is_placed = if self.runs > 1 { self.mapper.placed() } else { vec![true; self.mapper.keyframes.len()] };
        while most > 0 && self.next_scan < self.mapper.drawn.len() {
            let Drawn { step, points, at } = &self.mapper.drawn[self.next_scan];
            let map_from_laser = self.mapper.placer().place(step, &step.odom_from_laser);
            let stays = points.is_empty() || !is_placed[step.keyframe] || at.is_some_and(|at| self.is_near(&at, &map_from_laser));
            if !stays {
                if let Some(at) = at {
                    self.grid.erase(points, at);
                }
                self.grid.draw(points, &map_from_laser);
                self.mapper.drawn[self.next_scan].at = Some(map_from_laser);
                self.has_changed = true;
                most -= 1;
            }
            self.next_scan += 1;
        }
        // The place of the last ones may change as the next keyframe comes.
        let last = self.mapper.keyframes.len() - 1;
        let open = self.mapper.drawn.iter().rev().take_while(|drawn| drawn.step.keyframe >= last).count();
        if self.next_scan >= self.mapper.drawn.len() {
            self.next_scan = self.mapper.drawn.len() - open;
            return false;
        }
        true
    }

    fn is_near(&self, a: &Pose2, b: &Pose2) -> bool {
        let most = PART_OF_CELL * self.resolution;
        (a.translation() - b.translation()).norm() < most && wrap_angle(a.theta - b.theta).abs() * LEVER < most
    }

    /// Does all the work that is left, whatever time it takes, and draws the grid anew: now every scan is where the graph says.
    pub fn settle(&mut self) {
        while self.improve() {}
        self.mapper.graph.optimize(FINALLY);
        self.grid = EvidenceGrid::new(self.resolution);
        for drawn in &mut self.mapper.drawn {
            drawn.at = None;
        }
        self.next_scan = 0;
        while self.draw(usize::MAX) {}
    }

    /// What takes the frame of the odometry, of the run that the robot is on, to the map.
    pub fn map_from_odom(&self) -> Pose2 {
        let newest = self.mapper.keyframes.last().zip(self.mapper.graph.poses().last());
        newest.map_or(Pose2::IDENTITY, |(keyframe, pose)| *pose * keyframe.odom_from_laser.inverse())
    }

    /// The grid, if it has changed since it was last asked for.
    pub fn changed_grid(&mut self) -> Option<&EvidenceGrid> {
        std::mem::take(&mut self.has_changed).then_some(&self.grid)
    }

    /// The grid as it is.
    pub fn grid(&self) -> &EvidenceGrid {
        &self.grid
    }

    /// The keyframes and what is known of the motions between them.
    pub fn mapper(&self) -> &Mapper {
        &self.mapper
    }

    /// Rays that see the robot, by their bearings and ranges.
    pub fn self_hits(&self) -> &[Sector] {
        &self.masked
    }
}

impl Mapper {
    /// Edges from the keyframes from `since` on to places of earlier, in the smallest window that has any; how far they say that the poses
    /// are off.
    fn look_around(&mut self, since: usize) -> Pose2 {
        let ways = Ways::new(&self.graph);
        for limit in WINDOWS {
            let found = self.loops.find(&self.keyframes, &ways, &mut self.matcher, limit, since);
            if found.is_empty() {
                continue;
            }
            let poses = self.graph.poses();
            let errors = found.iter().map(|edge| poses[edge.from].between(&poses[edge.to]).between(&edge.motion));
            let worst = errors.fold(Pose2::IDENTITY, |worst, error| {
                Pose2::new(worst.x.max(error.distance()), 0.0, worst.theta.max(error.theta.abs()))
            });
            for edge in found {
                self.graph.add_edge(edge);
            }
            return worst;
        }
        Pose2::IDENTITY
    }
}

#[allow(clippy::cast_possible_truncation)] // saturates
fn place(run: usize, pose: &Pose2, side: f64, directions: i64) -> Place {
    let part = std::f64::consts::TAU / directions as f64;
    let cell = |x: f64| (x / side).floor() as i64;
    (run, cell(pose.x), cell(pose.y), ((pose.theta / part).round() as i64).rem_euclid(directions))
}

#[allow(clippy::cast_possible_truncation)]
fn mask_out(points: &mut [[f32; 2]], mask: &Mask) {
    if mask.is_empty() {
        return;
    }
    for point in points {
        let end = Point::new(point[0].into(), point[1].into());
        let range = end.norm();
        if range.is_finite() && range <= mask.limit(&(end / range)) {
            *point = [f32::NAN; 2];
        }
    }
}
