//! `std_msgs`.

use super::definition::messages;
use crate::time::Stamp;

messages! { "std_msgs":
    Header { seq: u32, stamp: super::Time, frame_id: String }
    ColorRGBA { r: f32, g: f32, b: f32, a: f32 }
    Empty {}
    Int32 { data: i32 }
}

impl Header {
    /// A header with the sequence number `seq` and the frame `frame`.
    pub fn new(seq: u32, stamp: Stamp, frame: &str) -> Self {
        Self { seq, stamp: stamp.into(), frame_id: frame.into() }
    }
}
