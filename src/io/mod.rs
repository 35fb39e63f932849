//! Files: bags, trajectories, relations, maps.

pub mod bag;
