//! `nav_msgs`.

use super::definition::messages;
use super::geometry_msgs::{Pose, PoseStamped, PoseWithCovariance, TwistWithCovariance};
use super::std_msgs::Header;

messages! { "nav_msgs":
    Odometry { header: Header, child_frame_id: String, pose: PoseWithCovariance, twist: TwistWithCovariance }
    Path { header: Header, poses: Vec<PoseStamped> }
    MapMetaData { map_load_time: super::Time, resolution: f32, width: u32, height: u32, origin: Pose }
    OccupancyGrid { header: Header, info: MapMetaData, data: Vec<i8> }
}
