//! Maps: what stands where, and how far from everything that is.

pub mod distance;
pub mod grid;
pub mod indoors;
