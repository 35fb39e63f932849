//! A simulated racecar: a world, a lidar, a vehicle and its odometer.
//!
//! [`drive::simulate`] combines them: a [`scene`] provides walls and a route, a [`driver`] steers the [`vehicle`] along the
//! route, which gives a [`motion`], and the [`lidar`] and the [`odometer`] measure that motion, with optional [`traffic`]. A
//! [`world`](world::World) casts all [`rays`] of a scan at once. Messages with the same seed are bitwise identical.
//!
//! In live simulation a [`car`] executes commands step by step; a [`marched_world`] casts its laser beams faster.
//!
//! For tests of single matches, [`pairs`] samples two scans taken close to each other in a [`random_world`], and [`information`]
//! computes the best accuracy that any matcher can reach there.

pub mod built_in;
pub mod car;
pub mod drive;
pub mod driver;
pub mod grid_world;
pub mod information;
pub mod lidar;
pub mod marched_world;
pub mod motion;
pub mod odometer;
pub mod pairs;
pub mod planner;
pub mod racecar;
pub mod random_world;
pub mod rays;
pub mod route;
pub mod scene;
pub mod shapes;
pub mod traffic;
pub mod vehicle;
pub mod world;
