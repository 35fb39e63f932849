//! Reads and writes files: bags, CARMEN logs, trajectories, relations, maps.

pub mod bag;
pub mod carmen;
pub mod contract_schedule;
pub mod cost_file;
pub mod csv_file;
pub mod gray_image;
pub mod map_file;
pub mod map_files;
pub mod profile_file;
pub mod relations;
pub mod simulated_bag;
pub mod text;
pub mod tum;
pub mod yaml;
