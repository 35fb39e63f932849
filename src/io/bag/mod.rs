//! ROS 1 bags, format 2.0.
//!
//! The reader makes one pass over the record headers (seeking past the chunks), then unpacks chunk by chunk, a few ahead on other cores:
//! memory stays bounded however large the bag. It reads bags without an index (as a killed recorder leaves them) and bags cut off at any byte; what it
//! could not read it says in [`Bag::problems`]. The `rosbag` crate needs a sound index and panics without one, hence this module.

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
