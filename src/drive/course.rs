//! Where to drive: a world, its map if it has one, and the path.

use std::fs;
use std::path::Path as FilePath;

use super::DriveError;
use crate::control::path::{Path, Waypoint};
use crate::control::waypoint_file;
use crate::geometry::{Point, Pose2};
use crate::io::map_file;
use crate::knobs::KnobValue as _;
use crate::map::grid::{Cell, OccupancyGrid};
use crate::simulation::built_in::BuiltIn;
use crate::simulation::grid_world::GridWorld;
use crate::simulation::marched_world::MarchedWorld;
use crate::simulation::planner::{MARGIN, NoLoop};
use crate::simulation::route::Route;
use crate::simulation::scene::way_round;
use crate::simulation::world::World;

/// Farthest beam of the laser, m.
const MAX_RANGE: f64 = 30.0;
/// Distance between places whose room beside the path is known, m.
const SPACING: f64 = 0.2;

/// A world to drive in and the path through it.
pub struct Course {
    /// What it is called.
    pub name: String,
    /// The walls.
    pub world: Box<dyn World + Send + Sync>,
    /// The map, where there is one.
    pub map: Option<OccupancyGrid>,
    /// The path to follow.
    pub path: Path,
    /// Room about the path, m, every [`SPACING`].
    clearances: Vec<f64>,
}

impl Course {
    /// `corridor`, `room`, or the YAML file of a map; with a raceline from a file, else a planned way round.
    pub fn load(world: &str, path: Option<&FilePath>) -> Result<Self, DriveError> {
        let ground = match BuiltIn::from_value(&world.into()) {
            Ok(which) => of_built_in(which, path)?,
            Err(_) => of_map(map_file::read(FilePath::new(world))?, path)?,
        };
        let (world_of, map, path) = ground;
        Self::new(world, world_of, map, path)
    }

    fn new(name: &str, world: Box<dyn World + Send + Sync>, map: Option<OccupancyGrid>, path: Path) -> Result<Self, DriveError> {
        let start = path.point(0.0);
        if world.clearance(start) <= 0.0 {
            return Err(DriveError::InWall { x: start.x, y: start.y });
        }
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a length in steps
        let places = (path.length() / SPACING).ceil() as usize;
        let clearances = (0..places).map(|place| world.clearance(path.point(place as f64 * SPACING))).collect();
        Ok(Self { name: name.into(), world, map, path, clearances })
    }

    /// The least room about the path within some distance ahead, m.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // places of the path
    pub fn clearance(&self, along: f64, ahead: f64) -> f64 {
        let count = self.clearances.len();
        let first = (along.rem_euclid(self.path.length()) / SPACING) as usize;
        let places = (ahead / SPACING).ceil() as usize + 1;
        (first..first + places).map(|place| self.clearances[place % count]).fold(f64::INFINITY, f64::min)
    }

    /// The greatest curvature of the path within some distance ahead, whichever way it bends, 1/m.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // places of the path
    pub fn curvature(&self, along: f64, ahead: f64) -> f64 {
        let places = (ahead / SPACING).ceil() as usize;
        (0..=places).map(|place| self.path.curvature(along + place as f64 * SPACING).abs()).fold(0.0, f64::max)
    }

    /// Points of the walls, for pictures.
    pub fn wall_points(&self) -> Vec<Point> {
        let Some(map) = &self.map else { return self.seen_walls() };
        let occupied = map.cells().iter().enumerate().filter(|(_, cell)| **cell == Cell::Occupied);
        occupied.map(|(index, _)| map.centre(index % map.width(), index / map.width())).collect()
    }

    /// What is seen of the walls from the path.
    fn seen_walls(&self) -> Vec<Point> {
        let places = (0..self.clearances.len()).step_by(5).map(|place| self.path.point(place as f64 * SPACING));
        let rays = |from: Point| {
            (0..360_u32).filter_map(move |degree| {
                let (sin, cos) = f64::from(degree).to_radians().sin_cos();
                let direction = Point::new(cos, sin);
                self.world.range(from, direction, MAX_RANGE).map(|range| from + direction * range)
            })
        };
        places.flat_map(rays).collect()
    }

    /// The pose on the path at a part of its length.
    pub fn start(&self, part: f64) -> Pose2 {
        self.path.pose(part * self.path.length())
    }
}

type Ground = (Box<dyn World + Send + Sync>, Option<OccupancyGrid>, Path);

fn of_built_in(which: BuiltIn, path: Option<&FilePath>) -> Result<Ground, DriveError> {
    let (world, corners) = which.draw();
    let path = match path {
        Some(path) => read(path)?,
        None => of_route(&Route::smooth(&corners, &world, MARGIN).ok_or(NoLoop::NothingToGoRound)?)?,
    };
    Ok((Box::new(world), None, path))
}

fn of_map(map: OccupancyGrid, path: Option<&FilePath>) -> Result<Ground, DriveError> {
    let path = path.map_or_else(|| of_route(&way_round(&GridWorld::new(map.clone()))?), read)?;
    Ok((Box::new(MarchedWorld::new(map.clone(), MAX_RANGE)), Some(map), path))
}

fn of_route(route: &Route) -> Result<Path, DriveError> {
    let waypoints: Vec<_> = route.points().iter().map(|&point| Waypoint { point, speed: None }).collect();
    // A route has three points at least, a step apart.
    Path::new(&waypoints, true).map_err(|problem| DriveError::Path { path: "the planned path".into(), problem })
}

fn read(path: &FilePath) -> Result<Path, DriveError> {
    let text = fs::read_to_string(path).map_err(|problem| DriveError::File { path: path.into(), problem })?;
    let waypoints = waypoint_file::parse(&text).map_err(|problem| DriveError::Waypoints { path: path.into(), problem })?;
    Path::closed_if_loop(&waypoints).map_err(|problem| DriveError::Path { path: path.into(), problem })
}
