//! A simulated racecar: a world, a lidar, a vehicle and its odometer.

pub mod distance;
pub mod grid;
pub mod shapes;
pub mod world;
