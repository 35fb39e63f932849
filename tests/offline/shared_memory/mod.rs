//! The shared memory between the node and a controller: handshakes with random timing, peers that die, invalid segments, and the C
//! header.

mod c_header;
mod handshakes;
mod node;
mod peers;
mod refusals;
