//! The node among everything that goes wrong on robots: masters that are replaced, connections that break or stand still, messages
//! that are none, floods of them, signals at bad moments.

mod bench;
mod bursts;
mod connections;
mod hostile;
mod latency;
mod master;
mod recording;
mod resources;
mod roscpp;
mod soak;
