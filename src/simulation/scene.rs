//! Where to drive: a world and a route through it.

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use crate::geometry::Point;
use crate::map::grid::OccupancyGrid;

use super::built_in::BuiltIn;
use super::grid_world::GridWorld;
use super::planner::{self, MARGIN, NoLoop};
use super::route::Route;
use super::world::World;

/// A world and a route through it.
pub struct Scene {
    /// The walls.
    pub world: Box<dyn World>,
    /// The closed route; the car starts at its first point.
    pub route: Route,
}

/// A smooth way round a map, well clear of its walls.
pub fn way_round(world: &GridWorld) -> Result<Route, NoLoop> {
    Route::smooth(&planner::find_loop(world)?, world, MARGIN).ok_or(NoLoop::NothingToGoRound)
}

impl Scene {
    /// A world that needs no map.
    pub fn built_in(which: BuiltIn) -> Result<Self, NoLoop> {
        let (world, corners) = which.draw();
        Self::new(world, &corners)
    }

    /// A map, with a route found in it. The seed picks the direction and the start.
    pub fn in_map(map: OccupancyGrid, seed: u32) -> Result<Self, NoLoop> {
        let world = GridWorld::new(map);
        let route = way_round(&world)?;
        let mut random = Pcg64::seed_from_u64(seed.into());
        let start = random.random_range(0..route.points().len());
        let route = if random.random() { route } else { route.reversed() };
        Ok(Self { world: Box::new(world), route: route.begun_at(start) })
    }

    fn new(world: impl World + 'static, corners: &[Point]) -> Result<Self, NoLoop> {
        let route = Route::smooth(corners, &world, MARGIN).ok_or(NoLoop::NothingToGoRound)?;
        Ok(Self { world: Box::new(world), route })
    }
}
