//! The graph of a map as markers.

use rosrust_msg::geometry_msgs::{Point, Vector3};
use rosrust_msg::std_msgs::ColorRGBA;
use rosrust_msg::visualization_msgs::Marker;

use crate::geometry::Pose2;
use crate::mapping::{EdgeKind, Mapper};
use crate::ros::fields::{header, pose};
use crate::time::Stamp;

/// Height of one marker above another, m: or they would hide each other by turns.
const LAYER: f64 = 0.02;

/// Keyframes, the path from one to the next, and the edges to places of earlier.
pub(super) fn markers(mapper: &Mapper, stamp: Stamp, frame: &str) -> [Marker; 3] {
    let poses = mapper.graph().poses();
    let point = |i: usize| Point { x: poses[i].x, y: poses[i].y, z: 0.0 };
    let ends = |wanted: EdgeKind| {
        let edges = mapper.graph().edges().iter().filter(move |edge| edge.kind == wanted);
        edges.flat_map(|edge| [point(edge.from), point(edge.to)]).collect()
    };
    let marker = |id, kind, size, color, points| marker(stamp, frame, (id, kind, size), color, points);
    [
        marker(0, Marker::LINE_LIST, 0.03, [0.35, 0.45, 0.65], ends(EdgeKind::Odometry)),
        marker(1, Marker::LINE_LIST, 0.02, [0.3, 0.8, 0.3], ends(EdgeKind::Loop)),
        marker(2, Marker::POINTS, 0.08, [0.95, 0.55, 0.1], (0..poses.len()).map(point).collect()),
    ]
}

fn marker(stamp: Stamp, frame: &str, (id, kind, size): (i32, u8, f64), [r, g, b]: [f32; 3], points: Vec<Point>) -> Marker {
    let mut place = pose(&Pose2::IDENTITY);
    place.position.z = LAYER * f64::from(id + 1);
    // RViz takes lines without ends for an error.
    let action = if points.is_empty() { Marker::DELETE } else { Marker::ADD };
    Marker {
        header: header(0, stamp, frame),
        ns: "graph".into(),
        id,
        type_: i32::from(kind),
        action: i32::from(action),
        pose: place,
        scale: Vector3 { x: size, y: size, z: 0.0 },
        color: ColorRGBA { r, g, b, a: 1.0 },
        points,
        ..Default::default()
    }
}
