//! Occupancy grids, distance fields, and indoor areas.

pub mod distance;
pub mod grid;
pub mod indoors;
