//! The node among everything that goes wrong on robots: masters that are replaced, connections that break or stand still, messages
//! that are none, floods of them, signals at bad moments.
#![cfg(all(feature = "ros", target_os = "linux"))]
#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stderr, unreachable_pub)]

mod bench;
mod bursts;
#[path = "../common/mod.rs"]
mod common;
mod connections;
#[path = "../common/drive.rs"]
mod drive;
#[path = "../common/graph.rs"]
mod graph;
mod hostile;
mod latency;
mod master;
mod recording;
mod resources;
mod roscpp;
mod soak;
#[path = "../common/wire.rs"]
mod wire;
