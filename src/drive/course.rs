//! A course: a world, its map if it has one, and the path to follow.

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
use crate::simulation::scene::plan_loop;
use crate::simulation::world::World;

/// Maximum range of the laser, m.
const MAX_RANGE: f64 = 30.0;
/// Distance between the path points whose clearance is stored, m.
const SPACING: f64 = 0.2;

/// A world to drive in and the path through it.
pub struct Course {
    /// Name of the world.
    pub name: String,
    /// The walls.
    pub world: Box<dyn World + Send + Sync>,
    /// The map, if there is one.
    pub map: Option<OccupancyGrid>,
    /// The path to follow.
    pub path: Path,
    /// Clearance of the path, m, every [`SPACING`].
    clearances: Vec<f64>,
}

impl Course {
    /// Loads a course: `corridor`, `room`, or the YAML file of a map, with a raceline from a file or a planned loop.
    pub fn load(world: &str, path: Option<&FilePath>) -> Result<Self, DriveError> {
        let (walls, map, path) = match BuiltIn::from_value(&world.into()) {
            Ok(which) => load_built_in(which, path)?,
            Err(_) => load_map(map_file::read(FilePath::new(world))?, path)?,
        };
        Self::new(world, walls, map, path)
    }

    fn new(name: &str, world: Box<dyn World + Send + Sync>, map: Option<OccupancyGrid>, path: Path) -> Result<Self, DriveError> {
        let start = path.point(0.0);
        if world.clearance(start) <= 0.0 {
            return Err(DriveError::InWall { x: start.x, y: start.y });
        }
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // a length in steps
        let samples = (path.length() / SPACING).ceil() as usize;
        let clearances = (0..samples).map(|sample| world.clearance(path.point(sample as f64 * SPACING))).collect();
        Ok(Self { name: name.into(), world, map, path, clearances })
    }

    /// Minimum clearance of the path within the distance `ahead` from `along`, m.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // sample indices
    pub fn clearance(&self, along: f64, ahead: f64) -> f64 {
        let count = self.clearances.len();
        let first = (along.rem_euclid(self.path.length()) / SPACING) as usize;
        let samples = (ahead / SPACING).ceil() as usize + 1;
        (first..first + samples).map(|sample| self.clearances[sample % count]).fold(f64::INFINITY, f64::min)
    }

    /// Maximum absolute curvature of the path within the distance `ahead` from `along`, 1/m.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)] // sample indices
    pub fn curvature(&self, along: f64, ahead: f64) -> f64 {
        let samples = (ahead / SPACING).ceil() as usize;
        (0..=samples).map(|sample| self.path.curvature(along + sample as f64 * SPACING).abs()).fold(0.0, f64::max)
    }

    /// Points on the walls, for the pictures.
    pub fn wall_points(&self) -> Vec<Point> {
        self.map.as_ref().map_or_else(|| self.visible_walls(), |map| map.centres(Cell::Occupied))
    }

    /// Points on the walls that are visible from the path.
    fn visible_walls(&self) -> Vec<Point> {
        let viewpoints = (0..self.clearances.len()).step_by(5).map(|sample| self.path.point(sample as f64 * SPACING));
        let rays = |from: Point| {
            (0..360_u32).filter_map(move |degree| {
                let (sin, cos) = f64::from(degree).to_radians().sin_cos();
                let direction = Point::new(cos, sin);
                self.world.range(from, direction, MAX_RANGE).map(|range| from + direction * range)
            })
        };
        viewpoints.flat_map(rays).collect()
    }

    /// The pose on the path at a fraction of its length.
    pub fn start(&self, fraction: f64) -> Pose2 {
        self.path.pose(fraction * self.path.length())
    }
}

type CourseParts = (Box<dyn World + Send + Sync>, Option<OccupancyGrid>, Path);

fn load_built_in(which: BuiltIn, path: Option<&FilePath>) -> Result<CourseParts, DriveError> {
    let (world, corners) = which.build();
    let path = match path {
        Some(path) => read_path(path)?,
        None => path_along_route(&Route::smooth(&corners, &world, MARGIN).ok_or(NoLoop::NoIsland)?)?,
    };
    Ok((Box::new(world), None, path))
}

fn load_map(map: OccupancyGrid, path: Option<&FilePath>) -> Result<CourseParts, DriveError> {
    let path = path.map_or_else(|| path_along_route(&plan_loop(&GridWorld::new(map.clone()))?), read_path)?;
    Ok((Box::new(MarchedWorld::new(map.clone(), MAX_RANGE)), Some(map), path))
}

fn path_along_route(route: &Route) -> Result<Path, DriveError> {
    let waypoints: Vec<_> = route.points().iter().map(|&point| Waypoint { point, speed: None }).collect();
    // Cannot fail: a route has at least three distinct points.
    Path::new(&waypoints, true).map_err(|problem| DriveError::Path { path: "the planned path".into(), problem })
}

fn read_path(path: &FilePath) -> Result<Path, DriveError> {
    let text = fs::read_to_string(path).map_err(|problem| DriveError::File { path: path.into(), problem })?;
    let waypoints = waypoint_file::parse(&text).map_err(|problem| DriveError::Waypoints { path: path.into(), problem })?;
    Path::closed_if_loop(&waypoints).map_err(|problem| DriveError::Path { path: path.into(), problem })
}
