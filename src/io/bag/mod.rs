//! ROS 1 bags, format 2.0.
//!
//! The reader makes one pass over the record headers (seeking past the chunks). It then decompresses chunk by chunk, a few ahead
//! on other cores, so that memory stays bounded however large the bag is. It also reads bags without an index (as a killed
//! recorder leaves them) and bags truncated at any byte; [`Bag::problems`] lists what it could not read. This module exists
//! because the `rosbag` crate needs an intact index and panics without one.

mod chunk;
mod compression;
mod connection;
mod error;
mod layout;
mod messages;
mod read_ahead;
mod reader;
mod record;
pub mod summary;
mod writer;

pub use compression::Compression;
pub use connection::Connection;
pub use error::{BagError, BagProblem};
pub use messages::{BagMessage, Messages};
pub use reader::Bag;
pub use writer::BagWriter;
