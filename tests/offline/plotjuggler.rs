//! Checks the layout for `PlotJuggler` against the messages: every curve is a numeric field of a message that is published on its topic, or is
//! computed from such fields.

use std::fs;
use std::path::Path;

use anytime_scan_matcher::messages::geometry_msgs::PoseStamped;
use anytime_scan_matcher::messages::nav_msgs::Odometry;
use anytime_scan_matcher::messages::own::MatchReport;
use anytime_scan_matcher::messages::std_msgs::Int32;
use anytime_scan_matcher::messages::{Definition, Message};

/// Types that `PlotJuggler` plots as numbers.
const NUMBERS: [&str; 13] =
    ["bool", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64", "float32", "float64", "time", "duration"];

type Definitions<'a> = &'a [(&'static str, &'static str)];

type Topic = (&'static str, fn() -> &'static Definition);

/// The messages of the layout's topics.
const TOPICS: [Topic; 6] = [
    ("/icp_report", MatchReport::definition),
    ("/scan_match_location", PoseStamped::definition),
    ("/gt_pose", PoseStamped::definition),
    ("/icp_state", Int32::definition),
    ("/icp/odom", Odometry::definition),
    ("/odom", Odometry::definition),
];

fn layout() -> String {
    fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("launch/plotjuggler.xml")).unwrap()
}

/// Values that `PlotJuggler` computes from every quaternion.
const ANGLES: [&str; 3] = ["roll_deg", "pitch_deg", "yaw_deg"];

/// The values of an attribute, of all elements that have it.
fn attributes<'a>(layout: &'a str, attribute: &str) -> Vec<&'a str> {
    layout.split(&format!(" {attribute}=\"")).skip(1).map(|rest| rest.split('"').next().unwrap()).collect()
}

/// The texts of all elements with this tag.
fn texts<'a>(layout: &'a str, element: &str) -> Vec<&'a str> {
    layout.split(&format!("<{element}>")).skip(1).map(|rest| rest.split('<').next().unwrap()).collect()
}

/// The `name` of every element with this tag.
fn names<'a>(layout: &'a str, element: &str) -> Vec<&'a str> {
    let opening = format!("<{element} name=\"");
    layout.split(&opening).skip(1).map(|rest| rest.split('"').next().unwrap()).collect()
}

/// The type of a field of a message of type `name`.
fn field_type(definitions: Definitions, name: &str, field: &str) -> Option<String> {
    let (_, text) = definitions.iter().find(|(defined, _)| *defined == name || defined.ends_with(&format!("/{name}")))?;
    let fields = text.lines().map(|line| line.split('#').next().unwrap()).filter(|line| !line.contains('='));
    let pairs = fields.filter_map(|line| line.split_once(char::is_whitespace));
    let is_angle = name.ends_with("Quaternion") && ANGLES.contains(&field);
    let mut pairs = pairs.map(|(kind, name)| (kind.trim(), name.trim())).chain(is_angle.then_some(("float64", field)));
    pairs.find(|(_, name)| *name == field).map(|(kind, _)| kind.to_owned())
}

/// Whether this path of fields leads to a number in a message.
fn is_number(definitions: Definitions, path: &str) -> bool {
    let start = definitions[0].0.to_owned();
    let end = path.split('/').try_fold(start, |name, field| field_type(definitions, &name, field));
    end.is_some_and(|kind| NUMBERS.contains(&kind.as_str()))
}

fn is_drawn(curve: &str) -> bool {
    let of_topic = |(topic, definition): &Topic| {
        curve.strip_prefix(topic).and_then(|rest| rest.strip_prefix('/')).is_some_and(|path| is_number(&definition().types, path))
    };
    TOPICS.iter().any(of_topic)
}

#[test]
fn every_curve_is_a_numeric_field_of_a_message() {
    let layout = layout();
    let curves = names(&layout, "curve");
    assert!(curves.len() > 10, "{curves:?}");
    let computed = names(&layout, "snippet");
    let missing: Vec<_> = curves.into_iter().filter(|curve| !is_drawn(curve) && !computed.contains(curve)).collect();
    assert!(missing.is_empty(), "{missing:?}");
    for topic in names(&layout, "topic") {
        assert!(TOPICS.iter().any(|(known, _)| *known == topic), "{topic}");
    }
    for wrong in ["/icp_report/elapsd", "/icp_report/reason", "/icp_report/header", "/icp_reports/elapsed", "/odom/pose/pose/x"] {
        assert!(!is_drawn(wrong), "{wrong}");
    }
}

#[test]
fn planes_and_computed_curves_use_numeric_fields_of_messages() {
    let layout = layout();
    let sources = ["linked_source", "v1", "v2", "v3"].map(|element| texts(&layout, element)).concat();
    let axes = ["curve_x", "curve_y"].map(|attribute| attributes(&layout, attribute)).concat();
    assert!(sources.len() >= 4 && axes.len() >= 8, "{sources:?} {axes:?}");
    let missing: Vec<_> = sources.into_iter().chain(axes).filter(|curve| !is_drawn(curve)).collect();
    assert!(missing.is_empty(), "{missing:?}");
}

#[test]
fn truth_is_plotted_with_the_match_and_cost_with_its_limit() {
    let layout = layout();
    let plot =
        |name: &str| layout.split(&format!("<DockArea name=\"{name}\">")).nth(1).unwrap().split("</DockArea>").next().unwrap();
    for (name, curves) in [
        ("x", ["/scan_match_location/pose/position/x", "/gt_pose/pose/position/x"]),
        ("y", ["/scan_match_location/pose/position/y", "/gt_pose/pose/position/y"]),
        ("yaw", ["/scan_match_location/pose/orientation/yaw_deg", "/gt_pose/pose/orientation/yaw_deg"]),
        ("error", ["position_error", "yaw_error_deg"]),
        ("delay against the budget", ["/icp_report/elapsed", "/icp_report/time_budget"]),
    ] {
        assert_eq!(names(plot(name), "curve"), curves, "{name}");
    }
    assert_eq!(attributes(plot("path"), "curve_x"), ["/scan_match_location/pose/position/x", "/gt_pose/pose/position/x"]);
    assert_eq!(attributes(plot("residual by iterations"), "curve_x"), ["/icp_report/iterations"]);
}

/// Since `PlotJuggler` 2.1 the topics are one text, not separate elements.
#[test]
fn every_plotted_topic_is_selected() {
    let layout = layout();
    let selected: Vec<&str> =
        layout.split("<selected_topics value=\"").skip(1).map(|rest| rest.split('"').next().unwrap()).collect();
    assert_eq!(selected.len(), 2, "one list for bags, and one for live topics");
    for topics in selected {
        let mut topics: Vec<&str> = topics.split(';').collect();
        let mut known = TOPICS.map(|(topic, _)| topic);
        topics.sort_unstable();
        known.sort_unstable();
        assert_eq!(topics, known);
    }
}

#[test]
fn every_element_of_the_layout_is_closed() {
    let layout = layout();
    let mut open = Vec::new();
    for tag in layout.split('<').skip(1).map(|rest| rest.split_once('>').unwrap().0) {
        let name = tag.trim_start_matches('/').split(|c: char| c.is_whitespace() || c == '/').next().unwrap();
        if let Some(closed) = tag.strip_prefix('/') {
            assert_eq!(open.pop(), Some(closed), "{tag}");
        } else if !tag.ends_with('/') && !tag.starts_with(['?', '!']) {
            open.push(name);
        }
    }
    assert!(open.is_empty(), "{open:?}");
}
