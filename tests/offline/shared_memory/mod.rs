//! The shared memory between the node and a controller: handshakes under random timing, peers that die, segments that are not one,
//! and the C header.

mod c_header;
mod handshakes;
mod node;
mod peers;
mod refusals;
