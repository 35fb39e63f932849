//! The node under the faults that happen on robots: masters that are replaced, connections that break or stall, invalid messages,
//! floods of messages, signals at bad times.

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
