//! The configuration: every module's knobs under one roof.
//!
//! A knob is named by its path, `matching.max_iterations` in files and on the command line, `~matching/max_iterations` on the ROS
//! parameter server. All ways in end in [`Config::set`].

use std::fmt::Write as _;
use std::path::Path;

use thiserror::Error;

use crate::anytime::contract::ContractKnobs;
use crate::cloud::CloudKnobs;
use crate::io::yaml;
use crate::knobs::{KnobGroup, KnobInfo, Value, nearest_name, nearest_names};
use crate::localization::LocalizationKnobs;
use crate::localization::motion::MotionKnobs;
use crate::localization::sensor::SensorKnobs;
use crate::mapping::MappingKnobs;
use crate::matching::MatchingKnobs;
use crate::matching::classic::rejection::RejectionKnobs;
use crate::odometry::OdometryKnobs;
use crate::scan::ScanKnobs;
use crate::transforms::frame_name;

crate::knobs! {
    /// Frames.
    pub struct FrameKnobs {
        /// The frame of the map: of `scan_match_location`, and of the particle filter's poses.
        map_frame: String = "map".into();
        /// The frame in which the pose never jumps: of `icp/odom`. The particle filter: that of the odometry it hears.
        odom_frame: String = "odom".into();
        /// The robot's frame.
        base_frame: String = "base_link".into();
        /// Publish the transform from `odom_frame` to `base_frame`; held back while another node publishes a parent of `base_frame`.
        /// The particle filter: the same from `map_frame` to `odom_frame`.
        publish_tf: bool = true;
        /// The scan matcher: publish the transform from `map_frame` to `odom_frame`; held back while another node publishes a parent of
        /// `odom_frame`, or odometry of its own in it. The mapper: the same.
        publish_map_tf: bool = true;
        /// Predict from what another node's transforms say of `base_frame` in this frame, rather than from anything else; unset: do not.
        prediction_frame: Option<String> = None;
    }
}

/// Names shown for one that is unknown.
const NAMES_SHOWN: usize = 3;

/// Why a configuration is refused.
#[derive(Debug, Error)]
pub enum ConfigError {
    /// There is no such knob.
    #[error("{source_name}: there is no parameter '{path}'{hint}; the nearest are: {nearest} (docs/parameters.md has all)")]
    UnknownKnob {
        /// Where it was set.
        source_name: String,
        /// Its path.
        path: String,
        /// The one that may have been meant.
        hint: String,
        /// The nearest names.
        nearest: String,
    },
    /// The value does not fit.
    #[error("{source_name}: {path}: {problem}")]
    BadValue {
        /// Where it was set.
        source_name: String,
        /// The knob's path.
        path: String,
        /// What was expected and what was found.
        problem: String,
    },
    /// The file could not be read.
    #[error("cannot read the configuration {path}: {error}")]
    Unreadable {
        /// The file.
        path: String,
        /// The system's reason.
        error: std::io::Error,
    },
    /// The text is no YAML mapping.
    #[error("{source_name}: {problem}")]
    BadYaml {
        /// Where the text is from.
        source_name: String,
        /// What is wrong, with its line.
        problem: String,
    },
    /// An assignment on the command line has no `=`.
    #[error("--set {text}: expected NAME=VALUE, such as matching.max_iterations=8")]
    BadAssignment {
        /// The text.
        text: String,
    },
}

/// All knobs.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Config {
    /// Frames; these knobs have no prefix.
    pub frames: FrameKnobs,
    /// `contract.*`
    pub contract: ContractKnobs,
    /// `scan.*`
    pub scan: ScanKnobs,
    /// `odometry.*`
    pub odometry: OdometryKnobs,
    /// `matching.*`
    pub matching: MatchingKnobs,
    /// `rejection.*`
    pub rejection: RejectionKnobs,
    /// `cloud.*`
    pub cloud: CloudKnobs,
    /// `localization.*`
    pub localization: LocalizationKnobs,
    /// `localization.motion.*`
    pub motion: MotionKnobs,
    /// `localization.sensor.*`
    pub sensor: SensorKnobs,
    /// `mapping.*`
    pub mapping: MappingKnobs,
}

impl Config {
    fn groups(&self) -> [(&'static str, &dyn KnobGroup); 11] {
        [
            ("", &self.frames),
            ("contract", &self.contract),
            ("scan", &self.scan),
            ("odometry", &self.odometry),
            ("matching", &self.matching),
            ("rejection", &self.rejection),
            ("cloud", &self.cloud),
            ("localization", &self.localization),
            ("localization.motion", &self.motion),
            ("localization.sensor", &self.sensor),
            ("mapping", &self.mapping),
        ]
    }

    fn group_mut(&mut self, name: &str) -> Option<&mut dyn KnobGroup> {
        match name {
            "" => Some(&mut self.frames),
            "contract" => Some(&mut self.contract),
            "scan" => Some(&mut self.scan),
            "odometry" => Some(&mut self.odometry),
            "matching" => Some(&mut self.matching),
            "rejection" => Some(&mut self.rejection),
            "cloud" => Some(&mut self.cloud),
            "localization" => Some(&mut self.localization),
            "localization.motion" => Some(&mut self.motion),
            "localization.sensor" => Some(&mut self.sensor),
            "mapping" => Some(&mut self.mapping),
            _ => None,
        }
    }

    /// Path and description of every knob.
    pub fn table(&self) -> Vec<(String, KnobInfo)> {
        let in_group = |(group, knobs): (&str, &dyn KnobGroup)| {
            let path = move |knob: &KnobInfo| if group.is_empty() { knob.name.into() } else { format!("{group}.{}", knob.name) };
            knobs.table().into_iter().map(|knob| (path(&knob), knob)).collect::<Vec<_>>()
        };
        self.groups().into_iter().flat_map(in_group).collect()
    }

    /// Refuses frames without a name, and two that would be each other's parent.
    pub fn check_frames(&self, source_name: &str) -> Result<(), ConfigError> {
        let FrameKnobs { map_frame, odom_frame, base_frame, publish_map_tf, prediction_frame, .. } = &self.frames;
        let refused = |path: &str, problem: String| {
            Err(ConfigError::BadValue { source_name: source_name.into(), path: path.into(), problem })
        };
        let prediction = prediction_frame.as_deref();
        let named = [
            ("map_frame", Some(&**map_frame)),
            ("odom_frame", Some(odom_frame)),
            ("base_frame", Some(base_frame)),
            ("prediction_frame", prediction),
        ];
        for (path, name) in named {
            if name.is_some_and(|name| frame_name(name).trim().is_empty()) {
                return refused(path, "it is empty: a frame needs a name, such as 'odom'; without a slash before it".into());
            }
        }
        let clash = |a: &str, b: &str| frame_name(a) == frame_name(b);
        for (path, name) in
            [("map_frame", Some(&**map_frame)), ("odom_frame", Some(odom_frame)), ("prediction_frame", prediction)]
        {
            if name.is_some_and(|name| clash(name, base_frame)) {
                return refused(
                    path,
                    format!("it is '{base_frame}', as base_frame is: the robot moves in it, so give the two different names"),
                );
            }
        }
        if *publish_map_tf && clash(map_frame, odom_frame) {
            let remedy = "give the two different names, or set publish_map_tf to false";
            return refused(
                "odom_frame",
                format!("it is '{odom_frame}', as map_frame is, and no frame is its own parent: {remedy}"),
            );
        }
        Ok(())
    }

    /// Settings that change nothing beside the others, in words.
    pub fn warnings(&self) -> Vec<String> {
        let MatchingKnobs { correspondence, solver, .. } = &self.matching;
        let (searched, solved) = (correspondence.name(), solver.name());
        let unserved = (!correspondence.serves(*solver)).then(|| {
            format!(
                "matching.solver {solved} changes nothing with matching.correspondence {searched}: its pairs are of points with lines, \
                 and point_to_line solves for them; for points with points set matching.correspondence to jump_table"
            )
        });
        let is_classic = correspondence.search().is_some();
        let of_classic = |path: &String| path.starts_with("rejection.") || path == "matching.max_correspondence_distance";
        let idle = self.changes().into_iter().map(|(path, _)| path).filter(|path| !is_classic && of_classic(path)).map(|path| {
            format!(
                "{path} changes nothing with matching.correspondence {searched}, which weighs its pairs and leaves none out; for classic \
                 PL-ICP set matching.correspondence to jump_table"
            )
        });
        unserved.into_iter().chain(idle).collect()
    }

    /// The knobs that are not at their defaults, with their values.
    pub fn changes(&self) -> Vec<(String, Value)> {
        let changed = |(path, knob): (String, KnobInfo)| {
            let (group, _) = path.rsplit_once('.').unwrap_or_default();
            let (_, knobs) = self.groups().into_iter().find(|(name, _)| *name == group)?;
            knobs.get(knob.name).filter(|value| *value != knob.default).map(|value| (path, value))
        };
        self.table().into_iter().filter_map(changed).collect()
    }

    /// Sets one knob. `source_name` says in errors where the value comes from.
    pub fn set(&mut self, path: &str, value: &Value, source_name: &str) -> Result<(), ConfigError> {
        let (group, name) = path.rsplit_once('.').unwrap_or(("", path));
        let outcome = self.group_mut(group).and_then(|knobs| knobs.set(name, value));
        judge(outcome, path, source_name, || self.table().into_iter().map(|(path, _)| path).collect())
    }

    /// Sets every knob of a tree of mappings, such as a YAML document or the private parameters of a node.
    pub fn set_tree(&mut self, tree: &Value, source_name: &str) -> Result<(), ConfigError> {
        match tree {
            Value::Null => Ok(()),
            Value::Object(_) => self.set_subtree("", tree, source_name),
            _ => {
                Err(ConfigError::BadYaml { source_name: source_name.into(), problem: "expected a mapping of parameters".into() })
            }
        }
    }

    fn set_subtree(&mut self, prefix: &str, tree: &Value, source_name: &str) -> Result<(), ConfigError> {
        let Value::Object(entries) = tree else { return self.set(prefix, tree, source_name) };
        for (name, value) in entries {
            let path = if prefix.is_empty() { name.clone() } else { format!("{prefix}.{name}") };
            self.set_subtree(&path, value, source_name)?;
        }
        Ok(())
    }

    /// Sets the knobs of a YAML text.
    pub fn set_yaml(&mut self, text: &str, source_name: &str) -> Result<(), ConfigError> {
        self.set_tree(&parse_yaml(text, source_name)?, source_name)
    }

    /// Sets the knobs of a YAML file.
    pub fn set_file(&mut self, path: &Path) -> Result<(), ConfigError> {
        let name = path.display().to_string();
        let text = std::fs::read_to_string(path).map_err(|error| ConfigError::Unreadable { path: name.clone(), error })?;
        self.set_yaml(&text, &name)
    }

    /// Sets one knob from `NAME=VALUE`, the value in YAML.
    pub fn set_assignment(&mut self, text: &str) -> Result<(), ConfigError> {
        let (path, value) = text.split_once('=').ok_or_else(|| ConfigError::BadAssignment { text: text.into() })?;
        let source_name = format!("--set {text}");
        self.set(path.trim(), &parse_yaml(value.trim(), &source_name)?, &source_name)
    }

    /// The table of parameters for people, in Markdown.
    pub fn markdown_table(&self) -> String {
        let mut text = String::from("| parameter | default | takes | unit | what |\n|---|---|---|---|---|\n");
        for (path, knob) in self.table() {
            let default = if knob.default.is_null() { "unset".into() } else { knob.default.to_string() };
            let takes = knob.accepts.replace('|', "\\|");
            let _ = writeln!(text, "| `{path}` | `{default}` | {takes} | {} | {} |", knob.unit, knob.help);
        }
        text
    }
}

/// Sets knobs of a group that stands by itself from a mapping of names to values; `null` sets none.
pub fn set_group(knobs: &mut dyn KnobGroup, values: &Value, source_name: &str) -> Result<(), ConfigError> {
    for (name, value) in values.as_object().into_iter().flatten() {
        let outcome = knobs.set(name, value);
        judge(outcome, name, source_name, || knobs.table().iter().map(|knob| knob.name.into()).collect())?;
    }
    Ok(())
}

/// The error for what [`KnobGroup::set`] said of a knob, if it was one; `valid` names the knobs there are.
fn judge(
    outcome: Option<Result<(), String>>,
    path: &str,
    source_name: &str,
    valid: impl FnOnce() -> Vec<String>,
) -> Result<(), ConfigError> {
    let (source_name, path) = (source_name.into(), path.into());
    match outcome {
        Some(Ok(())) => Ok(()),
        Some(Err(problem)) => Err(ConfigError::BadValue { source_name, path, problem }),
        None => {
            let valid = valid();
            let names = || valid.iter().map(String::as_str);
            let hint = nearest_name(&path, names()).map_or_else(String::new, |near| format!(" (did you mean '{near}'?)"));
            let nearest = nearest_names(&path, names(), NAMES_SHOWN).join(", ");
            Err(ConfigError::UnknownKnob { source_name, path, hint, nearest })
        }
    }
}

fn parse_yaml(text: &str, source_name: &str) -> Result<Value, ConfigError> {
    if text.trim().is_empty() {
        return Ok(Value::Null);
    }
    yaml::from_str(text).map_err(|problem| ConfigError::BadYaml { source_name: source_name.into(), problem })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Pose2;
    use crate::matching::classic::correspondence::Correspondence;
    use crate::matching::solver::SolverKind;

    #[test]
    fn every_way_in_sets_the_same_knobs() {
        let mut by_yaml = Config::default();
        by_yaml
            .set_yaml("base_frame: car\nmatching:\n  solver: linearized\n  max_correspondence_distance: 1\ncontract: {time_budget: 5ms}\nodometry:\n  laser_in_base: [0.275, 0, 0]\n", "x.yaml")
            .unwrap();
        let mut by_assignment = Config::default();
        for text in [
            "base_frame=car",
            "matching.solver=linearized",
            "matching.max_correspondence_distance=1",
            "contract.time_budget=0.005",
            "odometry.laser_in_base=[0.275, 0, 0]",
        ] {
            by_assignment.set_assignment(text).unwrap();
        }
        assert_eq!(by_yaml, by_assignment);
        assert_eq!(by_yaml.matching.solver, SolverKind::Linearized);
        assert_eq!(by_yaml.odometry.laser_in_base, Some(Pose2::new(0.275, 0.0, 0.0).into()));
    }

    #[test]
    fn what_was_changed_is_known() {
        let mut config = Config::default();
        assert!(config.changes().is_empty());
        config.set_yaml("base_frame: car\nmatching: {max_iterations: 8, solver: point_to_line}\n", "x.yaml").unwrap();
        assert_eq!(config.changes(), [("base_frame".into(), "car".into()), ("matching.max_iterations".into(), 8.into())]);
    }

    #[test]
    fn frames_need_names_and_names_of_their_own() {
        let problem = |text: &str| {
            let mut config = Config::default();
            config.set_yaml(text, "x.yaml").unwrap();
            config.check_frames("x.yaml").err().map(|error| error.to_string()).unwrap_or_default()
        };
        for good in ["{}", "odom_frame: map\npublish_map_tf: false", "prediction_frame: odom", "prediction_frame: ''"] {
            assert_eq!(problem(good), "");
        }
        for (text, said) in [
            ("map_frame: ''", "x.yaml: map_frame: it is empty"),
            ("odom_frame: /", "x.yaml: odom_frame: it is empty"),
            ("base_frame: ' '", "x.yaml: base_frame: it is empty"),
            ("odom_frame: map", "x.yaml: odom_frame: it is 'map', as map_frame is"),
            ("odom_frame: /map", "publish_map_tf to false"),
            ("base_frame: odom", "x.yaml: odom_frame: it is 'odom', as base_frame is"),
            ("map_frame: base_link\npublish_map_tf: false", "x.yaml: map_frame: it is 'base_link', as base_frame is"),
            ("prediction_frame: base_link", "x.yaml: prediction_frame: it is 'base_link'"),
        ] {
            assert!(problem(text).contains(said), "{text}: {}", problem(text));
        }
    }

    #[test]
    fn settings_that_change_nothing_are_said() {
        let warnings = |text: &str| {
            let mut config = Config::default();
            config.set_yaml(text, "x.yaml").unwrap();
            config.warnings()
        };
        assert!(warnings("{}").is_empty());
        let points = warnings("matching: {solver: point_to_point}");
        assert!(points.len() == 1 && points[0].contains("point_to_point changes nothing with"), "{points:?}");
        assert!(points[0].contains("projective") && points[0].contains("jump_table"), "{points:?}");
        let trimmed = warnings("rejection: {trim_percentile: 0.9}");
        assert!(trimmed.len() == 1 && trimmed[0].starts_with("rejection.trim_percentile changes nothing"), "{trimmed:?}");
        assert!(
            warnings("matching: {solver: point_to_point, correspondence: kd_tree}\nrejection: {trim_percentile: 0.9}").is_empty()
        );
    }

    #[test]
    fn the_file_of_classic_pl_icp_says_what_it_is() {
        let mut config = Config::default();
        config.set_file(Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/launch/matcher_plicp.yaml"))).unwrap();
        let MatchingKnobs { correspondence, solver, .. } = config.matching;
        assert_eq!((correspondence, solver), (Correspondence::JumpTable, SolverKind::PointToLine));
        assert!(config.rejection.trim_percentile < 1.0 && config.warnings().is_empty());
    }

    #[test]
    fn mistakes_are_named_with_their_remedy() {
        let mut config = Config::default();
        let message = |result: Result<(), ConfigError>| result.unwrap_err().to_string();
        let typo = message(config.set_yaml("matching:\n  max_iteration: 3\n", "car.yaml"));
        assert!(
            typo.contains("car.yaml")
                && typo.contains("did you mean 'matching.max_iterations'?")
                && typo.matches(", ").count() == 2,
            "{typo}"
        );
        let range = message(config.set_assignment("matching.max_iterations=0"));
        assert!(range.contains("matching.max_iterations") && range.contains("1 to 1000, got 0"), "{range}");
        let kind = message(config.set_assignment("matching.solver=newton"));
        assert!(kind.contains("point_to_line | point_to_point"), "{kind}");
        assert!(message(config.set_assignment("matching.max_iterations")).contains("NAME=VALUE"));
        assert!(message(config.set_yaml("a: [", "car.yaml")).contains("not YAML"));
        assert!(message(config.set_yaml("- a\n", "car.yaml")).contains("mapping"));
        assert!(message(config.set_file(Path::new("no/such.yaml"))).contains("no/such.yaml"));
        assert_eq!(config, Config::default());
    }

    #[test]
    fn the_defaults_are_within_their_own_ranges() {
        let mut config = Config::default();
        for (path, knob) in Config::default().table() {
            config.set(&path, &knob.default, "defaults").unwrap();
        }
        assert_eq!(config, Config::default());
    }
}
