//! `visualization_msgs`.

use super::definition::messages;
use super::geometry_msgs::{Point, Pose, Vector3};
use super::std_msgs::{ColorRGBA, Header};

messages! { "visualization_msgs":
    Marker {
        header: Header,
        ns: String,
        id: i32,
        type_: i32,
        action: i32,
        pose: Pose,
        scale: Vector3,
        color: ColorRGBA,
        lifetime: super::Duration,
        frame_locked: bool,
        points: Vec<Point>,
        colors: Vec<ColorRGBA>,
        text: String,
        mesh_resource: String,
        mesh_use_embedded_materials: bool,
    }
}

#[allow(missing_docs)] // values of `type` and `action`, named as in the definition
impl Marker {
    pub const LINE_STRIP: i32 = 4;
    pub const LINE_LIST: i32 = 5;
    pub const POINTS: i32 = 8;
    pub const ADD: i32 = 0;
    pub const DELETE: i32 = 2;
}
