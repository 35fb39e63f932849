//! The configuration: the parameters of all modules.
//!
//! A parameter is named by its path, `matching.max_iterations` in files and on the command line, `~matching/max_iterations` on
//! the ROS parameter server. All sources set parameters through [`Config::set`].

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
    /// Frames and their transforms.
    pub struct FrameKnobs {
        /// The map frame, of `scan_match_location` and of the particle filter's poses.
        map_frame: String = "map".into();
        /// The odometry frame, of `icp/odom`, in which the pose never jumps. The particle filter: the frame of the odometry that
        /// it subscribes to.
        odom_frame: String = "odom".into();
        /// The robot's frame.
        base_frame: String = "base_link".into();
        /// Publish the transform from `odom_frame` to `base_frame`; suspended while another node publishes a parent of
        /// `base_frame`. The particle filter: the same for the transform from `map_frame` to `odom_frame`.
        publish_tf: bool = true;
        /// Publish the transform from `map_frame` to `odom_frame` (scan matcher and mapper); suspended while another node
        /// publishes a parent of `odom_frame`, or odometry in `odom_frame`.
        publish_map_tf: bool = true;
        /// Predict from the transform of `base_frame` in this frame that another node publishes, with priority over all other
        /// sources; unset: do not.
        prediction_frame: Option<String> = None;
    }
}

/// Number of similar names shown for an unknown one.
const NAMES_SHOWN: usize = 3;

/// Why a configuration is rejected.
#[derive(Debug, Error)]
pub enum ConfigError {
    /// There is no such parameter.
    #[error("{source_name}: there is no parameter '{path}'{hint}; the nearest names are: {nearest} (see docs/parameters.md)")]
    UnknownKnob {
        /// Where it was set.
        source_name: String,
        /// Its path.
        path: String,
        /// The name that was probably meant.
        hint: String,
        /// The most similar names.
        nearest: String,
    },
    /// The value is invalid.
    #[error("{source_name}: {path}: {problem}")]
    BadValue {
        /// Where it was set.
        source_name: String,
        /// The parameter's path.
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
    /// The text is not a YAML mapping.
    #[error("{source_name}: {problem}")]
    BadYaml {
        /// The source of the text.
        source_name: String,
        /// The problem, with its line.
        problem: String,
    },
    /// An assignment on the command line has no `=`.
    #[error("--set {text}: expected NAME=VALUE, such as matching.max_iterations=8")]
    BadAssignment {
        /// The text.
        text: String,
    },
}

/// All parameters.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Config {
    /// Frames; these parameters have no prefix.
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

    /// Path and description of every parameter.
    pub fn table(&self) -> Vec<(String, KnobInfo)> {
        let in_group = |(group, knobs): (&str, &dyn KnobGroup)| {
            let path = move |knob: &KnobInfo| if group.is_empty() { knob.name.into() } else { format!("{group}.{}", knob.name) };
            knobs.table().into_iter().map(|knob| (path(&knob), knob)).collect::<Vec<_>>()
        };
        self.groups().into_iter().flat_map(in_group).collect()
    }

    /// Rejects frames without a name, and frames that would be their own parent.
    pub fn check_frames(&self, source_name: &str) -> Result<(), ConfigError> {
        let FrameKnobs { map_frame, odom_frame, base_frame, publish_map_tf, prediction_frame, .. } = &self.frames;
        let rejected = |path: &str, problem: String| {
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
                return rejected(path, "it is empty: a frame needs a name without a leading slash, such as 'odom'".into());
            }
        }
        let clash = |a: &str, b: &str| frame_name(a) == frame_name(b);
        for (path, name) in
            [("map_frame", Some(&**map_frame)), ("odom_frame", Some(odom_frame)), ("prediction_frame", prediction)]
        {
            if name.is_some_and(|name| clash(name, base_frame)) {
                return rejected(
                    path,
                    format!(
                        "it is '{base_frame}', as base_frame is: the robot moves in this frame, so give the two frames different names"
                    ),
                );
            }
        }
        if *publish_map_tf && clash(map_frame, odom_frame) {
            let remedy = "give the two frames different names, or set publish_map_tf to false";
            return rejected(
                "odom_frame",
                format!("it is '{odom_frame}', as map_frame is, and a frame cannot be its own parent: {remedy}"),
            );
        }
        Ok(())
    }

    /// Describes the settings that have no effect in combination with others.
    pub fn warnings(&self) -> Vec<String> {
        let MatchingKnobs { correspondence, solver, .. } = &self.matching;
        let (searched, solved) = (correspondence.name(), solver.name());
        let unsupported = (!correspondence.supports(*solver)).then(|| {
            format!(
                "matching.solver {solved} has no effect with matching.correspondence {searched}, which pairs points with lines: \
                 the solver is point_to_line; to match points with points, set matching.correspondence to jump_table"
            )
        });
        let is_classic = correspondence.search().is_some();
        let of_classic = |path: &String| path.starts_with("rejection.") || path == "matching.max_correspondence_distance";
        let idle = self.changes().into_iter().map(|(path, _)| path).filter(|path| !is_classic && of_classic(path)).map(|path| {
            format!(
                "{path} has no effect with matching.correspondence {searched}, which weights its pairs and rejects none; for classic \
                 PL-ICP, set matching.correspondence to jump_table"
            )
        });
        unsupported.into_iter().chain(idle).collect()
    }

    /// The parameters that differ from their defaults, with their values.
    pub fn changes(&self) -> Vec<(String, Value)> {
        let changed = |(path, knob): (String, KnobInfo)| {
            let (group, _) = path.rsplit_once('.').unwrap_or_default();
            let (_, knobs) = self.groups().into_iter().find(|(name, _)| *name == group)?;
            knobs.get(knob.name).filter(|value| *value != knob.default).map(|value| (path, value))
        };
        self.table().into_iter().filter_map(changed).collect()
    }

    /// Sets one parameter. `source_name` names the source of the value in errors.
    pub fn set(&mut self, path: &str, value: &Value, source_name: &str) -> Result<(), ConfigError> {
        let (group, name) = path.rsplit_once('.').unwrap_or(("", path));
        let outcome = self.group_mut(group).and_then(|knobs| knobs.set(name, value));
        to_result(outcome, path, source_name, || self.table().into_iter().map(|(path, _)| path).collect())
    }

    /// Sets every parameter of a tree of mappings, such as a YAML document or the private parameters of a node.
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

    /// Sets the parameters of a YAML text.
    pub fn set_yaml(&mut self, text: &str, source_name: &str) -> Result<(), ConfigError> {
        self.set_tree(&parse_yaml(text, source_name)?, source_name)
    }

    /// Sets the parameters of a YAML file.
    pub fn set_file(&mut self, path: &Path) -> Result<(), ConfigError> {
        let name = path.display().to_string();
        let text = std::fs::read_to_string(path).map_err(|error| ConfigError::Unreadable { path: name.clone(), error })?;
        self.set_yaml(&text, &name)
    }

    /// Sets one parameter from `NAME=VALUE`, with the value in YAML.
    pub fn set_assignment(&mut self, text: &str) -> Result<(), ConfigError> {
        let (path, value) = text.split_once('=').ok_or_else(|| ConfigError::BadAssignment { text: text.into() })?;
        let source_name = format!("--set {text}");
        self.set(path.trim(), &parse_yaml(value.trim(), &source_name)?, &source_name)
    }

    /// The table of all parameters in Markdown.
    pub fn markdown_table(&self) -> String {
        let mut text = String::from("| parameter | default | values | unit | description |\n|---|---|---|---|---|\n");
        for (path, knob) in self.table() {
            let default = if knob.default.is_null() { "unset".into() } else { knob.default.to_string() };
            let values = knob.accepts.replace('|', "\\|");
            let _ = writeln!(text, "| `{path}` | `{default}` | {values} | {} | {} |", knob.unit, knob.help);
        }
        text
    }
}

/// Sets parameters of a single group from a mapping of names to values; `null` sets none.
pub fn set_group(knobs: &mut dyn KnobGroup, values: &Value, source_name: &str) -> Result<(), ConfigError> {
    for (name, value) in values.as_object().into_iter().flatten() {
        let outcome = knobs.set(name, value);
        to_result(outcome, name, source_name, || knobs.table().iter().map(|knob| knob.name.into()).collect())?;
    }
    Ok(())
}

/// Converts the outcome of [`KnobGroup::set`] to a result; `valid` lists the existing parameters.
fn to_result(
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
    use crate::matching::classic::correspondence::CorrespondenceKind;
    use crate::matching::solver::SolverKind;

    #[test]
    fn all_sources_set_the_same_parameters() {
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
    fn changed_parameters_are_listed() {
        let mut config = Config::default();
        assert!(config.changes().is_empty());
        config.set_yaml("base_frame: car\nmatching: {max_iterations: 8, solver: point_to_line}\n", "x.yaml").unwrap();
        assert_eq!(config.changes(), [("base_frame".into(), "car".into()), ("matching.max_iterations".into(), 8.into())]);
    }

    #[test]
    fn frames_need_distinct_names() {
        let problem = |text: &str| {
            let mut config = Config::default();
            config.set_yaml(text, "x.yaml").unwrap();
            config.check_frames("x.yaml").err().map(|error| error.to_string()).unwrap_or_default()
        };
        for good in ["{}", "odom_frame: map\npublish_map_tf: false", "prediction_frame: odom", "prediction_frame: ''"] {
            assert_eq!(problem(good), "");
        }
        for (text, expected) in [
            ("map_frame: ''", "x.yaml: map_frame: it is empty"),
            ("odom_frame: /", "x.yaml: odom_frame: it is empty"),
            ("base_frame: ' '", "x.yaml: base_frame: it is empty"),
            ("odom_frame: map", "x.yaml: odom_frame: it is 'map', as map_frame is"),
            ("odom_frame: /map", "publish_map_tf to false"),
            ("base_frame: odom", "x.yaml: odom_frame: it is 'odom', as base_frame is"),
            ("map_frame: base_link\npublish_map_tf: false", "x.yaml: map_frame: it is 'base_link', as base_frame is"),
            ("prediction_frame: base_link", "x.yaml: prediction_frame: it is 'base_link'"),
        ] {
            assert!(problem(text).contains(expected), "{text}: {}", problem(text));
        }
    }

    #[test]
    fn settings_without_effect_are_reported() {
        let warnings = |text: &str| {
            let mut config = Config::default();
            config.set_yaml(text, "x.yaml").unwrap();
            config.warnings()
        };
        assert!(warnings("{}").is_empty());
        let points = warnings("matching: {solver: point_to_point}");
        assert!(points.len() == 1 && points[0].contains("point_to_point has no effect with"), "{points:?}");
        assert!(points[0].contains("projective") && points[0].contains("jump_table"), "{points:?}");
        let trimmed = warnings("rejection: {trim_percentile: 0.9}");
        assert!(trimmed.len() == 1 && trimmed[0].starts_with("rejection.trim_percentile has no effect"), "{trimmed:?}");
        assert!(
            warnings("matching: {solver: point_to_point, correspondence: kd_tree}\nrejection: {trim_percentile: 0.9}").is_empty()
        );
    }

    #[test]
    fn the_configuration_file_of_classic_pl_icp_sets_it() {
        let mut config = Config::default();
        config.set_file(Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/launch/matcher_plicp.yaml"))).unwrap();
        let MatchingKnobs { correspondence, solver, .. } = config.matching;
        assert_eq!((correspondence, solver), (CorrespondenceKind::JumpTable, SolverKind::PointToLine));
        assert!(config.rejection.trim_percentile < 1.0 && config.warnings().is_empty());
    }

    #[test]
    fn errors_name_the_problem_and_the_remedy() {
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
