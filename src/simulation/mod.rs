//! A simulated racecar: a world, a lidar, a vehicle and its odometer.

pub mod built_in;
pub mod distance;
pub mod grid;
pub mod planner;
pub mod route;
pub mod scene;
pub mod shapes;
pub mod world;
