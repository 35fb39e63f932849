//! Markers for `RViz`.

use crate::geometry::{Point, Pose2};
use crate::messages::geometry_msgs::{self, Vector3};
use crate::messages::std_msgs::{ColorRGBA, Header};
use crate::messages::visualization_msgs::Marker;

/// Height of one marker above the next, and of the first above the map, m: at the same height they would flicker.
const LAYER: f64 = 0.02;

/// Style of a marker.
#[derive(Clone, Copy)]
pub(super) struct Style {
    /// `Marker::POINTS`, `LINE_LIST` or `LINE_STRIP`.
    pub(super) kind: i32,
    /// Width, m.
    pub(super) width: f64,
    /// Red, green and blue, from 0 to 1.
    pub(super) color: [f32; 3],
}

/// Makes a marker for each style and its points, one above the other.
pub(super) fn markers<const N: usize>(
    header: &Header,
    namespace: &str,
    shown: [(Style, Vec<geometry_msgs::Point>); N],
) -> [Marker; N] {
    let mut id = -1;
    shown.map(|(Style { kind, width, color: [r, g, b] }, points)| {
        id += 1;
        let mut pose = geometry_msgs::Pose::from(Pose2::IDENTITY);
        pose.position.z = LAYER * f64::from(id + 1);
        Marker {
            header: header.clone(),
            ns: namespace.into(),
            id,
            type_: kind,
            // RViz reports lines without points as an error.
            action: if points.is_empty() { Marker::DELETE } else { Marker::ADD },
            pose,
            scale: Vector3 { x: width, y: width, z: 0.0 },
            color: ColorRGBA { r, g, b, a: 1.0 },
            points,
            ..Marker::default()
        }
    })
}

/// A point at height zero.
pub(super) fn point(p: &Point) -> geometry_msgs::Point {
    geometry_msgs::Point { x: p.x, y: p.y, z: 0.0 }
}
