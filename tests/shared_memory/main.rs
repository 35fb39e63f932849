//! The shared memory between the node and a controller: handshakes under random timing, peers that die, segments that are not one,
//! and the C header.
#![cfg(target_os = "linux")]
#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stderr)]

mod c_header;
mod handshakes;
mod node;
mod peers;
mod refusals;
