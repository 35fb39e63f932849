//! Markers of the pose graph.

use crate::mapping::{EdgeKind, Mapper};
use crate::messages::std_msgs::Header;
use crate::messages::visualization_msgs::Marker;
use crate::ros::markers::{self, Style, point};
use crate::time::Stamp;

/// Markers of the keyframes, of the path through them, and of the loop closures.
pub(super) fn markers(mapper: &Mapper, stamp: Stamp, frame: &str) -> [Marker; 3] {
    let poses = mapper.graph().poses();
    let keyframe = |i: usize| point(&poses[i].translation());
    let ends = |wanted: EdgeKind| {
        let edges = mapper.graph().edges().iter().filter(move |edge| edge.kind == wanted);
        edges.flat_map(|edge| [keyframe(edge.from), keyframe(edge.to)]).collect()
    };
    let style = |kind, width, color| Style { kind, width, color };
    let shown = [
        (style(Marker::LINE_LIST, 0.03, [0.35, 0.45, 0.65]), ends(EdgeKind::Odometry)),
        (style(Marker::LINE_LIST, 0.02, [0.3, 0.8, 0.3]), ends(EdgeKind::Loop)),
        (style(Marker::POINTS, 0.08, [0.95, 0.55, 0.1]), (0..poses.len()).map(keyframe).collect()),
    ];
    markers::markers(&Header::new(0, stamp, frame), "graph", shown)
}
