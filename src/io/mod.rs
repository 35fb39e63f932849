//! Files: bags, trajectories, relations, maps.

pub mod relations;
pub mod text;
pub mod tum;
