//! Online mapping while the robot drives. Work is done in small portions, and memory grows with the mapped area, not with time.
//!
//! New keyframes search for loop closures as they arrive. After a loop closure that moves the map, the whole path is searched again.
//! The grid is kept up to date scan by scan: a scan whose pose has changed is removed and inserted again. Of each place the newest
//! scans are kept, so that objects that have moved away vanish; but the oldest keyframes, because they have drifted least.

use std::collections::{BTreeMap, VecDeque};

use super::grid::EvidenceGrid;
use super::keyframe::{MotionStatus, PosedScan, Spacing};
use super::loops::{RelativeUncertainty, WINDOWS};
use super::{COARSE_TOLERANCE, FINAL_TOLERANCE, GridScan, LEVER_ARM, Mapper, SelfHits};
use crate::geometry::{Point, Pose2};
use crate::matching::MatchingKnobs;
use crate::matching::classic::rejection::RejectionKnobs;
use crate::scan::{Mask, Scan, ScanKnobs, Sector, Sectors};

/// Path length between two loop closure searches of the newest keyframes, m: half a segment of the path.
const SEARCH_INTERVAL: f64 = 1.0;
/// New loop edges with smaller position errors than this, m, do not trigger an optimization: no wall of the grid would move.
const MIN_CORRECTION: f64 = 0.01;
/// The same for rotation errors, rad.
const MIN_ROTATION_CORRECTION: f64 = 0.003;
/// New loop edges with larger position errors than this, m, trigger a loop closure search over the whole path.
const LARGE_CORRECTION: f64 = 0.1;
/// The same for rotation errors, rad.
const LARGE_ROTATION_CORRECTION: f64 = 0.02;
/// Number of rays per scan that [`Spacing::GRID_SCANS`] is meant for. With more rays, fewer scans are enough.
const REFERENCE_RAYS: usize = 361;
/// Side length of the bins that limit the number of scans, m.
const BIN_SIZE: f64 = 0.5;
/// Maximum number of keyframes per bin that keep their scans. The bins of keyframes have eight headings.
const MAX_VIEWS_PER_BIN: usize = 3;
/// Path length over which the newest keyframes keep their scans in any case, m.
const RECENT_LENGTH: f64 = 25.0;
/// Shift of a scan, as a fraction of a cell, beyond which it is inserted again.
const MAX_SHIFT: f64 = 0.3;
/// Length at which a run with an unknown start is first searched for on the map, m; then again each time its length has doubled.
const FIRST_JOIN_LENGTH: f64 = 6.0;
/// Number of keyframes between two updates of the self-hit mask.
const SELF_HIT_PERIOD: usize = 25;

/// Key of a bin: run, column, row, heading.
type Bin = (usize, i64, i64, i64);

/// A map that is built while the robot drives.
pub struct LiveMap {
    mapper: Mapper,
    grid: EvidenceGrid,
    resolution: f64,
    /// Number of runs so far.
    runs: usize,
    /// By bin: the scans in the grid, as indices into the mapper's list.
    scans: BTreeMap<Bin, VecDeque<usize>>,
    /// By bin: number of older keyframes that keep their scans.
    views: BTreeMap<Bin, usize>,
    /// Index of the oldest keyframe within [`RECENT_LENGTH`]; later ones all have their scans.
    oldest_recent: usize,
    /// Path length at which the newest keyframes search for loop closures.
    next_search: f64,
    /// Index of the first keyframe that has not been searched for loop closures.
    first_unsearched: usize,
    /// Index of the search window that is next for the whole path; past the end if there is nothing to do.
    window_index: usize,
    /// Path length at which the current run is searched for on the map.
    next_join: f64,
    /// Index of the first scan whose pose in the grid may be outdated.
    first_outdated_scan: usize,
    /// Whether the grid has changed since the last call of [`Self::changed_grid`].
    has_changed: bool,
    self_hits: SelfHits,
    mask: Mask,
    masked_sectors: Vec<Sector>,
}

impl LiveMap {
    /// Creates an empty map; `resolution` is the side length of a grid cell, m.
    pub fn new(matching: &MatchingKnobs, rejection: &RejectionKnobs, resolution: f64) -> Self {
        Self {
            mapper: Mapper::new(matching, rejection),
            grid: EvidenceGrid::new(resolution),
            resolution,
            runs: 0,
            scans: BTreeMap::new(),
            views: BTreeMap::new(),
            oldest_recent: 0,
            next_search: SEARCH_INTERVAL,
            first_unsearched: 0,
            window_index: WINDOWS.len(),
            next_join: f64::INFINITY,
            first_outdated_scan: 0,
            has_changed: false,
            self_hits: SelfHits::default(),
            mask: Mask::new(&ScanKnobs::default()),
            masked_sectors: Vec::new(),
        }
    }

    /// Adds a scan; `measured` is the raw scan. Returns whether it has become a keyframe.
    pub fn add(&mut self, posed_scan: PosedScan, measured: &Scan) -> bool {
        self.self_hits.add(measured, &posed_scan.odom_from_laser());
        let is_start = posed_scan.motion_status == MotionStatus::Start || self.mapper.keyframes.is_empty();
        let rays = posed_scan.scan.len();
        let factor = (rays as f64 / REFERENCE_RAYS as f64).max(1.0);
        self.mapper.grid_spacing =
            Spacing { distance: factor * Spacing::GRID_SCANS.distance, angle: factor * Spacing::GRID_SCANS.angle };
        self.runs += usize::from(is_start);
        let (before, is_first) = (self.mapper.grid_scans.len(), self.mapper.keyframes.is_empty());
        let is_keyframe = self.mapper.add(posed_scan);
        self.mapper.nodes.drain(..self.mapper.nodes.len().saturating_sub(1)); // the whole path is not needed
        (before..self.mapper.grid_scans.len()).for_each(|scan| self.add_grid_scan(scan));
        if is_start {
            self.next_join = if is_first { f64::INFINITY } else { self.path_length() + FIRST_JOIN_LENGTH };
        }
        if is_keyframe {
            self.release_old_views();
            self.update_self_hit_mask();
            self.search_for_loops();
        }
        is_keyframe
    }

    /// Path length up to the newest keyframe, m.
    fn path_length(&self) -> f64 {
        self.mapper.keyframes.last().map_or(0.0, |keyframe| keyframe.path_length)
    }

    /// Adds a scan to its bin; drops the oldest scan of the bin if it is full.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // ten at most
    fn add_grid_scan(&mut self, scan: usize) {
        let node = self.mapper.grid_scans[scan].node;
        let map_from_laser = self.mapper.interpolator().map_pose(&node, &node.odom_from_laser);
        remove_masked(&mut self.mapper.grid_scans[scan].points, &self.mask);
        // For each of four headings: as many scans as one drive through the bin yields.
        let kept = (BIN_SIZE / self.mapper.grid_spacing.distance).ceil() as usize;
        let scans = self.scans.entry(bin(self.runs, &map_from_laser, BIN_SIZE, 4)).or_default();
        scans.push_back(scan);
        if scans.len() > kept
            && let Some(oldest) = scans.pop_front()
        {
            let GridScan { points, inserted_at, .. } = &mut self.mapper.grid_scans[oldest];
            if let Some(pose) = inserted_at.take() {
                self.grid.remove(points, &pose);
            }
            *points = Vec::new();
        }
        self.first_outdated_scan = self.first_outdated_scan.min(scan);
    }

    /// Drops the scans of keyframes that are no longer recent, if their bin has enough other keyframes.
    fn release_old_views(&mut self) {
        let recent = self.path_length() - RECENT_LENGTH;
        while self.mapper.keyframes[self.oldest_recent].path_length < recent {
            let run = self.mapper.keyframes[self.oldest_recent].run;
            let bin = bin(run, &self.mapper.graph.poses()[self.oldest_recent], 2.0 * BIN_SIZE, 8);
            let views = self.views.entry(bin).or_default();
            if *views < MAX_VIEWS_PER_BIN {
                *views += 1;
            } else {
                self.mapper.keyframes[self.oldest_recent].view = None;
                self.mapper.loops.forget(self.oldest_recent);
            }
            self.oldest_recent += 1;
        }
    }

    /// Updates the self-hit mask, and removes the masked rays from the grid.
    fn update_self_hit_mask(&mut self) {
        if !self.mapper.keyframes.len().is_multiple_of(SELF_HIT_PERIOD) {
            return;
        }
        let sectors = self.self_hits.sectors();
        if sectors.len() <= self.masked_sectors.len() {
            return;
        }
        self.masked_sectors.clone_from(&sectors);
        self.mask = Mask::new(&ScanKnobs { masked_sectors: Sectors(sectors), ..ScanKnobs::default() });
        for GridScan { points, inserted_at, .. } in &mut self.mapper.grid_scans {
            if let Some(pose) = inserted_at.take() {
                self.grid.remove(points, &pose);
            }
            remove_masked(points, &self.mask);
        }
        self.first_outdated_scan = 0;
    }

    /// Searches for loop closures of the newest keyframes, and for the start of a run on the map.
    fn search_for_loops(&mut self) {
        if self.path_length() >= self.next_join {
            let run = self.mapper.keyframes.last().map(|keyframe| keyframe.run);
            let start =
                self.mapper.keyframes.iter().find(|keyframe| Some(keyframe.run) == run).map_or(0.0, |first| first.path_length);
            self.next_join = self.path_length() + (self.path_length() - start);
            if self.mapper.unplaced_runs() == 0 {
                self.next_join = f64::INFINITY;
            } else if self.mapper.join_runs() {
                (self.first_outdated_scan, self.window_index) = (0, 0);
            }
        }
        if self.path_length() < self.next_search {
            return;
        }
        self.next_search = self.path_length() + SEARCH_INTERVAL;
        let newest = self.mapper.keyframes.len() - 1;
        let error = self.mapper.add_loop_edges(self.first_unsearched);
        self.first_unsearched = newest;
        let is_beyond = |distance: f64, rotation: f64| error.distance() > distance || error.theta.abs() > rotation;
        if is_beyond(MIN_CORRECTION, MIN_ROTATION_CORRECTION) {
            self.mapper.graph.optimize(COARSE_TOLERANCE);
            self.first_outdated_scan = 0;
        }
        if is_beyond(LARGE_CORRECTION, LARGE_ROTATION_CORRECTION) {
            self.window_index = 0;
        }
    }

    /// Does a portion of the pending work: inserts up to `scans` scans into the grid, or else runs one round of loop closure search
    /// over the whole path. Returns whether there is more to do.
    pub fn work(&mut self, scans: usize) -> bool {
        if self.insert_scans(scans) {
            return true;
        }
        let was_pending = self.improve();
        if was_pending {
            self.first_outdated_scan = 0;
        }
        was_pending
    }

    /// Runs one round of loop closure search over the whole path, if one is pending; returns whether it was.
    fn improve(&mut self) -> bool {
        let was_pending = self.window_index < WINDOWS.len();
        if was_pending {
            self.mapper.window_index = self.window_index;
            self.mapper.improve();
            self.window_index = self.mapper.window_index;
        }
        was_pending
    }

    /// Inserts up to `max` scans whose poses in the grid are missing or outdated; returns whether there are more.
    fn insert_scans(&mut self, mut max: usize) -> bool {
        if self.first_outdated_scan >= self.mapper.grid_scans.len() {
            return false;
        }
        // A single run is always on the map.
        let is_on_map = if self.runs > 1 { self.mapper.is_on_map() } else { vec![true; self.mapper.keyframes.len()] };
        while max > 0 && self.first_outdated_scan < self.mapper.grid_scans.len() {
            let GridScan { node, points, inserted_at } = &self.mapper.grid_scans[self.first_outdated_scan];
            let map_from_laser = self.mapper.interpolator().map_pose(node, &node.odom_from_laser);
            let is_done = points.is_empty()
                || !is_on_map[node.keyframe]
                || inserted_at.is_some_and(|pose| self.is_up_to_date(&pose, &map_from_laser));
            if !is_done {
                if let Some(pose) = inserted_at {
                    self.grid.remove(points, pose);
                }
                self.grid.insert(points, &map_from_laser);
                self.mapper.grid_scans[self.first_outdated_scan].inserted_at = Some(map_from_laser);
                self.has_changed = true;
                max -= 1;
            }
            self.first_outdated_scan += 1;
        }
        // The next keyframe may still change the poses of the scans since the last one.
        let last = self.mapper.keyframes.len() - 1;
        let unsettled = self.mapper.grid_scans.iter().rev().take_while(|scan| scan.node.keyframe >= last).count();
        if self.first_outdated_scan >= self.mapper.grid_scans.len() {
            self.first_outdated_scan = self.mapper.grid_scans.len() - unsettled;
            return false;
        }
        true
    }

    fn is_up_to_date(&self, a: &Pose2, b: &Pose2) -> bool {
        let max_shift = MAX_SHIFT * self.resolution;
        a.is_near(b, max_shift, max_shift / LEVER_ARM)
    }

    /// Completes all pending work, however long it takes, and rebuilds the grid from the optimized poses.
    pub fn settle(&mut self) {
        while self.improve() {}
        self.mapper.graph.optimize(FINAL_TOLERANCE);
        self.grid = EvidenceGrid::new(self.resolution);
        for scan in &mut self.mapper.grid_scans {
            scan.inserted_at = None;
        }
        self.first_outdated_scan = 0;
        while self.insert_scans(usize::MAX) {}
    }

    /// Transform from the odometry frame of the current run to the map.
    pub fn map_from_odom(&self) -> Pose2 {
        let newest = self.mapper.keyframes.last().zip(self.mapper.graph.poses().last());
        newest.map_or(Pose2::IDENTITY, |(keyframe, pose)| *pose * keyframe.odom_from_laser.inverse())
    }

    /// The grid, if it has changed since the last call.
    pub fn changed_grid(&mut self) -> Option<&EvidenceGrid> {
        std::mem::take(&mut self.has_changed).then_some(&self.grid)
    }

    /// The current grid.
    pub fn grid(&self) -> &EvidenceGrid {
        &self.grid
    }

    /// The mapper, with the keyframes and the pose graph.
    pub fn mapper(&self) -> &Mapper {
        &self.mapper
    }

    /// Sectors in which the laser sees the robot.
    pub fn self_hits(&self) -> &[Sector] {
        &self.masked_sectors
    }
}

impl Mapper {
    /// Adds loop edges for the keyframes from `since` on, found in the smallest window that yields any; returns their largest position
    /// error (as x) and rotation error.
    fn add_loop_edges(&mut self, since: usize) -> Pose2 {
        let uncertainty = RelativeUncertainty::new(&self.graph);
        for limit in WINDOWS {
            let found = self.loops.find(&self.keyframes, &uncertainty, &mut self.matcher, limit, since);
            if found.is_empty() {
                continue;
            }
            let poses = self.graph.poses();
            let errors = found.iter().map(|edge| poses[edge.from].between(&poses[edge.to]).between(&edge.motion));
            let max_error = errors.fold(Pose2::IDENTITY, |max_error, error| {
                Pose2::new(max_error.x.max(error.distance()), 0.0, max_error.theta.max(error.theta.abs()))
            });
            for edge in found {
                self.graph.add_edge(edge);
            }
            return max_error;
        }
        Pose2::IDENTITY
    }
}

/// The bin of a pose, with cells of `side` metres and this many headings.
#[allow(clippy::cast_possible_truncation)] // saturates
fn bin(run: usize, pose: &Pose2, side: f64, directions: i64) -> Bin {
    let step = std::f64::consts::TAU / directions as f64;
    let cell = |x: f64| (x / side).floor() as i64;
    (run, cell(pose.x), cell(pose.y), ((pose.theta / step).round() as i64).rem_euclid(directions))
}

/// Replaces the end points of masked rays by NaN.
#[allow(clippy::cast_possible_truncation)]
fn remove_masked(points: &mut [[f32; 2]], mask: &Mask) {
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
