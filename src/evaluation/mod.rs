//! Trajectories against truth: ATE, RPE, relations; plots.
