//! A simulated racecar: a world, a lidar, a vehicle and its odometer.
//!
//! [`drive::simulate`] puts them together: a [`scene`] gives the walls and the route through them, a [`driver`] steers the
//! [`vehicle`] along the route into a [`motion`], and the [`lidar`] and the [`odometer`] measure that motion, amid
//! [`traffic`] if wanted. A [`world`](world::World) may answer for all [`rays`] of a scan at once. The same seed makes the same
//! messages, bit for bit.
//!
//! Live, a [`car`] goes where it is told to, moment by moment; beams of its lidar may take the short way through a [`marched_world`].
//!
//! For the study of one match at a time, [`pairs`] takes two scans close together in a [`random_world`], and [`information`] says
//! how well any matcher could do there.

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
