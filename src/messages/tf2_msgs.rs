//! `tf2_msgs`.

use super::definition::messages;
use super::geometry_msgs::TransformStamped;

messages! { "tf2_msgs":
    TFMessage { transforms: Vec<TransformStamped> }
}
