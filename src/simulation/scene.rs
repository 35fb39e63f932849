//! A scene: a world and a route through it.

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

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

/// Plans a smooth loop in a map, clear of the walls.
pub fn plan_loop(world: &GridWorld) -> Result<Route, NoLoop> {
    Route::smooth(&planner::find_loop(world)?, world, MARGIN).ok_or(NoLoop::NoIsland)
}

impl Scene {
    /// A built-in world with its route.
    pub fn built_in(which: BuiltIn) -> Result<Self, NoLoop> {
        let (world, corners) = which.build();
        let route = Route::smooth(&corners, &world, MARGIN).ok_or(NoLoop::NoIsland)?;
        Ok(Self { world: Box::new(world), route })
    }

    /// A map, with a route planned in it. The seed selects direction and start of the route.
    pub fn in_map(map: OccupancyGrid, seed: u32) -> Result<Self, NoLoop> {
        let world = GridWorld::new(map);
        let route = plan_loop(&world)?;
        let mut random = Pcg64::seed_from_u64(seed.into());
        let start = random.random_range(0..route.points().len());
        let route = if random.random() { route } else { route.reversed() };
        Ok(Self { world: Box::new(world), route: route.begun_at(start) })
    }
}
