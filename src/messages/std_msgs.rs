//! `std_msgs`.

#![allow(missing_docs)] // the fields are those of the definitions under msg/

use serde::{Deserialize, Serialize};

/// `std_msgs/Header`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Header {
    pub seq: u32,
    pub stamp: super::Time,
    pub frame_id: String,
}
