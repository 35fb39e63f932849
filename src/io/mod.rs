//! Files: bags, trajectories, relations, maps.

pub mod bag;
pub mod relations;
pub mod text;
pub mod tum;
