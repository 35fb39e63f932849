//! The layout for `PlotJuggler` draws what messages have: every curve is a number of a message that is published on its topic.

use std::fs;
use std::path::Path;

use anytime_scan_matcher::messages::Message;
use anytime_scan_matcher::messages::geometry_msgs::PoseStamped;
use anytime_scan_matcher::messages::nav_msgs::Odometry;
use anytime_scan_matcher::messages::own::MatchReport;
use anytime_scan_matcher::messages::std_msgs::Int32;

/// Types that `PlotJuggler` makes a number of.
const NUMBERS: [&str; 13] =
    ["bool", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64", "float32", "float64", "time", "duration"];

type Definitions = &'static [(&'static str, &'static str)];

/// The messages of the layout's topics.
const TOPICS: [(&str, Definitions); 5] = [
    ("/icp_report", MatchReport::DEFINITIONS),
    ("/scan_match_location", PoseStamped::DEFINITIONS),
    ("/icp_state", Int32::DEFINITIONS),
    ("/icp/odom", Odometry::DEFINITIONS),
    ("/odom", Odometry::DEFINITIONS),
];

fn layout() -> String {
    fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("launch/plotjuggler.xml")).unwrap()
}

/// The `name` of every element of this kind.
fn names<'a>(layout: &'a str, element: &str) -> Vec<&'a str> {
    let opening = format!("<{element} name=\"");
    layout.split(&opening).skip(1).map(|rest| rest.split('"').next().unwrap()).collect()
}

/// The type of a field of a message of type `name`.
fn field_type(definitions: Definitions, name: &str, field: &str) -> Option<String> {
    let (_, text) = definitions.iter().find(|(defined, _)| *defined == name || defined.ends_with(&format!("/{name}")))?;
    let fields = text.lines().map(|line| line.split('#').next().unwrap()).filter(|line| !line.contains('='));
    let pairs = fields.filter_map(|line| line.split_once(char::is_whitespace));
    pairs.map(|(kind, name)| (kind.trim(), name.trim())).find(|(_, name)| *name == field).map(|(kind, _)| kind.to_owned())
}

/// Whether a message has a number at the end of this path of fields.
fn is_number(definitions: Definitions, path: &str) -> bool {
    let start = definitions[0].0.to_owned();
    let end = path.split('/').try_fold(start, |name, field| field_type(definitions, &name, field));
    end.is_some_and(|kind| NUMBERS.contains(&kind.as_str()))
}

fn is_drawn(curve: &str) -> bool {
    let of_topic = |(topic, definitions): &(&str, Definitions)| {
        curve.strip_prefix(topic).and_then(|rest| rest.strip_prefix('/')).is_some_and(|path| is_number(definitions, path))
    };
    TOPICS.iter().any(of_topic)
}

#[test]
fn every_curve_is_a_number_of_a_message() {
    let layout = layout();
    let curves = names(&layout, "curve");
    assert!(curves.len() > 10, "{curves:?}");
    let missing: Vec<_> = curves.into_iter().filter(|curve| !is_drawn(curve)).collect();
    assert!(missing.is_empty(), "{missing:?}");
    for topic in names(&layout, "topic") {
        assert!(TOPICS.iter().any(|(known, _)| *known == topic), "{topic}");
    }
    for wrong in ["/icp_report/elapsd", "/icp_report/reason", "/icp_report/header", "/icp_reports/elapsed", "/odom/pose/pose/x"] {
        assert!(!is_drawn(wrong), "{wrong}");
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
