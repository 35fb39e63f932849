//! Files: bags, trajectories, relations, maps.
