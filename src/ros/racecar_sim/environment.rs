//! The environment that the simulated car drives in.

use std::path::Path;

use super::{RANGE_MAX, RacecarSimKnobs};
use crate::geometry::Pose2;
use crate::io::map_file;
use crate::knobs::KnobValue as _;
use crate::ros::NodeError;
use crate::simulation::built_in::BuiltIn;
use crate::simulation::driver::Driver;
use crate::simulation::marched_world::MarchedWorld;
use crate::simulation::route::Route;
use crate::simulation::scene::Scene;
use crate::simulation::world::World;

/// A world and, if there is one, a loop through it.
pub(super) struct Environment {
    pub(super) world: Box<dyn World>,
    route: Option<Route>,
    start: Pose2,
}

impl Environment {
    pub(super) fn new(knobs: &RacecarSimKnobs) -> Result<Self, NodeError> {
        let (world, route) = match BuiltIn::from_value(&knobs.world.as_str().into()) {
            Ok(which) => Scene::built_in(which).map(|scene| (scene.world, Some(scene.route)))?,
            Err(_) => of_map(knobs)?,
        };
        let on_route = || route.as_ref().map(|route| Driver::new(route, &knobs.autopilot()).start());
        let start = knobs.initial_pose.or_else(on_route).unwrap_or_default();
        Ok(Self { world, route, start })
    }

    /// Start pose of the car.
    pub(super) fn start(&self) -> Pose2 {
        self.start
    }

    /// The autopilot, if it is wanted.
    pub(super) fn driver(&self, knobs: &RacecarSimKnobs) -> Option<Driver<'_>> {
        let route = self.route.as_ref().filter(|_| knobs.autopilot)?;
        let mut driver = Driver::new(route, &knobs.autopilot());
        driver.find(self.start.translation());
        Some(driver)
    }
}

/// A map and a loop through it. A map without a loop is an error only for the autopilot.
fn of_map(knobs: &RacecarSimKnobs) -> Result<(Box<dyn World>, Option<Route>), NodeError> {
    let map = map_file::read(Path::new(&knobs.world))?;
    let route = match Scene::in_map(map.clone(), knobs.seed) {
        Ok(scene) => Some(scene.route),
        Err(error) if knobs.autopilot => return Err(error.into()),
        Err(_) => None,
    };
    Ok((Box::new(MarchedWorld::new(map, RANGE_MAX)), route))
}
