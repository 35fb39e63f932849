//! The parameters of `laser_scan_matcher` in this node's words.

use std::collections::BTreeSet;

use rosrust::api::Master;
use serde_json::Map;

use crate::config::{Config, ConfigError, set_group};
use crate::knobs::{KnobGroup as _, Value, nearest_name};
use crate::ros::NodeError;
use crate::ros::params::{CONFIG_FILE, configure, private_parameters};

crate::knobs! {
    /// What has no other place in this node.
    #[allow(unreachable_pub)]
    pub struct CompatKnobs {
        /// The frame the poses are given in.
        fixed_frame: String = "world".into();
        /// Whether to match clouds.
        use_cloud_input: bool = false;
        /// A new keyframe after this way.
        kf_dist_linear: f64 = 0.1, in 0 to 100, unit "m";
        /// A new keyframe after this turn.
        kf_dist_angular: f64 = 10.0_f64.to_radians(), in 0 to 4, unit "rad";
        /// Whether to predict the heading by `imu/data`.
        use_imu: bool = true;
        /// Whether to predict by `odom`.
        use_odom: bool = true;
        /// Whether to predict by the transforms from `fixed_frame` to the base.
        use_tf: bool = false;
        /// Whether to predict by `vel`.
        use_vel: bool = false;
        /// Whether the velocities have headers.
        stamped_vel: bool = false;
        /// Whether to publish `pose2D`.
        publish_pose: bool = true;
        /// Whether to publish `pose_stamped`.
        publish_pose_stamped: bool = false;
        /// Whether to publish `pose_with_covariance`.
        publish_pose_with_covariance: bool = false;
        /// Whether to publish `pose_with_covariance_stamped`.
        publish_pose_with_covariance_stamped: bool = false;
        /// A match that corrects the prediction by more than this is not believed.
        max_linear_correction: f64 = 0.5, in 0.01 to 100, unit "m";
        /// A match that turns the prediction by more than this is not believed.
        max_angular_correction_deg: f64 = 45.0, in 0.6 to 180, unit "deg";
        /// Whether pairs are of points with lines, 0 or 1.
        use_point_to_line_distance: u32 = 1, in 0 to 1;
        /// Whether each reference point is used once at most, 0 or 1.
        outliers_remove_doubles: u32 = 1, in 0 to 1;
    }
}

/// Parameters that are called something else here. They keep this node's defaults: those of `laser_scan_matcher` suit its matcher.
const RENAMED: [(&str, &str); 10] = [
    ("max_iterations", "matching.max_iterations"),
    ("max_correspondence_dist", "matching.max_correspondence_distance"),
    ("epsilon_xy", "matching.epsilon_translation"),
    ("epsilon_theta", "matching.epsilon_rotation"),
    ("sigma", "matching.range_noise"),
    ("outliers_maxPerc", "rejection.trim_percentile"),
    ("outliers_adaptive_order", "rejection.adaptive_percentile"),
    ("outliers_adaptive_mult", "rejection.adaptive_multiplier"),
    ("cloud_range_min", "cloud.range_min"),
    ("cloud_range_max", "cloud.range_max"),
];

/// Parameters that mean nothing to this matcher.
const IGNORED: [&str; 18] = [
    "cloud_res",
    "tf_timeout",
    "position_covariance",
    "orientation_covariance",
    "use_corr_tricks",
    "restart",
    "restart_threshold_mean_error",
    "restart_dt",
    "restart_dtheta",
    "clustering_threshold",
    "orientation_neighbourhood",
    "do_alpha_test",
    "do_alpha_test_thresholdDeg",
    "do_visibility_test",
    "do_compute_covariance",
    "debug_verify_tricks",
    "use_ml_weights",
    "use_sigma_weights",
];

/// Knobs that only the search for closest points reads.
const CLASSIC: [&str; 4] = [
    "matching.max_correspondence_distance",
    "rejection.trim_percentile",
    "rejection.adaptive_percentile",
    "rejection.adaptive_multiplier",
];

/// Which topics the poses are wanted on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(clippy::struct_excessive_bools)] // one for each topic
pub(in crate::ros) struct PoseTopics {
    pub(super) pose: bool,
    pub(super) stamped: bool,
    pub(super) with_covariance: bool,
    pub(super) with_covariance_stamped: bool,
}

/// Which topics may predict the motion between two scans.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(clippy::struct_excessive_bools)] // one for each topic
pub(in crate::ros) struct Predictors {
    pub(in crate::ros) odometry: bool,
    pub(in crate::ros) imu: bool,
    pub(in crate::ros) velocity: bool,
    /// Velocities with headers.
    pub(in crate::ros) stamped_velocity: bool,
}

/// What the node reads and publishes besides what it always does.
#[derive(Clone, Debug, PartialEq)]
pub(in crate::ros) struct Face {
    pub(in crate::ros) predictors: Predictors,
    /// `None`: the node has its own face.
    pub(in crate::ros) poses: Option<PoseTopics>,
    /// Parameters that were set and mean nothing here.
    pub(in crate::ros) ignored: Vec<String>,
}

impl Face {
    /// This node's own.
    pub(in crate::ros) fn native() -> Self {
        let predictors = Predictors { odometry: true, imu: true, velocity: true, stamped_velocity: false };
        Self { predictors, poses: None, ignored: Vec::new() }
    }
}

/// Reads the configuration from the private parameters of `node`, which are called as those of `laser_scan_matcher` are, or as here.
pub(in crate::ros) fn read(master: &Master, node: &str) -> Result<(Config, Face), NodeError> {
    let tree = private_parameters(master, node)?;
    translate(tree, node).map_err(|problem| NodeError::Parameters { node: node.into(), problem })
}

fn translate(mut tree: Value, node: &str) -> Result<(Config, Face), ConfigError> {
    let source = format!("parameters of {node}");
    let mut theirs = CompatKnobs::default();
    let (mut ignored, mut renamed) = (Vec::new(), Vec::new());
    if let Value::Object(parameters) = &mut tree {
        let mut take = |name: &str| parameters.remove(name);
        ignored.extend(IGNORED.iter().filter(|name| take(name).is_some()).map(|name| (*name).to_owned()));
        renamed.extend(RENAMED.iter().filter_map(|(name, ours)| Some((*name, *ours, take(name)?))));
        let known = theirs.table();
        let own = known.iter().filter_map(|knob| Some((knob.name.to_owned(), take(knob.name)?))).collect();
        set_group(&mut theirs, &Value::Object(own), &source)?;
        ignored.extend(take_unknown(parameters, "", &names_here()));
    }
    let mut defaults = Config::default();
    adopt(&theirs, &mut defaults, &source)?;
    for (_, path, value) in &renamed {
        defaults.set(path, value, &source)?;
    }
    let config = configure(defaults, tree, node).map_err(in_their_words)?;
    // What only closest points read means nothing where pairs are looked up by projection.
    let is_read = |path: &str| config.matching.correspondence.search().is_some() || !CLASSIC.contains(&path);
    ignored.extend(renamed.iter().filter(|(_, path, _)| !is_read(path)).map(|(name, ..)| (*name).to_owned()));
    let predictors = Predictors {
        odometry: theirs.use_odom,
        imu: theirs.use_imu,
        velocity: theirs.use_vel && !theirs.stamped_vel,
        stamped_velocity: theirs.use_vel && theirs.stamped_vel,
    };
    let poses = PoseTopics {
        pose: theirs.publish_pose,
        stamped: theirs.publish_pose_stamped,
        with_covariance: theirs.publish_pose_with_covariance,
        with_covariance_stamped: theirs.publish_pose_with_covariance_stamped,
    };
    let face = Face { predictors, poses: Some(poses), ignored };
    Ok((config, face))
}

/// Every name that a parameter can have here.
fn names_here() -> BTreeSet<String> {
    Config::default().table().into_iter().map(|(path, _)| path).chain([CONFIG_FILE.into()]).collect()
}

/// Removes what neither node knows, as the other would pass over it; the names, each with the one that may have been meant.
fn take_unknown(parameters: &mut Map<String, Value>, prefix: &str, known: &BTreeSet<String>) -> Vec<String> {
    let mut unknown = Vec::new();
    parameters.retain(|name, value| {
        let path = format!("{prefix}{name}");
        if let Value::Object(inner) = value {
            unknown.extend(take_unknown(inner, &format!("{path}."), known));
            return true;
        }
        let is_known = known.contains(&path);
        if !is_known {
            let theirs = CompatKnobs::default().table();
            let near = if prefix.is_empty() {
                nearest_name(&path, theirs.iter().map(|knob| knob.name).chain(RENAMED.iter().map(|(name, _)| *name)))
            } else {
                nearest_name(&path, known.iter().map(String::as_str))
            };
            unknown.push(near.map_or_else(|| path.clone(), |near| format!("{path} (did you mean {near}?)")));
        }
        is_known
    });
    unknown
}

/// Both frames of this node are the one of the other.
fn in_their_words(error: ConfigError) -> ConfigError {
    match error {
        ConfigError::BadValue { source_name, path, problem } if ["map_frame", "odom_frame"].contains(&&*path) => {
            ConfigError::BadValue { source_name, path: "fixed_frame".into(), problem }
        }
        error => error,
    }
}

/// Sets this node's knobs by what the others mean.
fn adopt(theirs: &CompatKnobs, config: &mut Config, source: &str) -> Result<(), ConfigError> {
    let matching_to_points = theirs.use_point_to_line_distance == 0;
    let settings: [(&str, Value); 10] = [
        ("map_frame", theirs.fixed_frame.clone().into()),
        ("odom_frame", theirs.fixed_frame.clone().into()),
        ("publish_map_tf", false.into()),
        ("cloud.input", theirs.use_cloud_input.into()),
        ("odometry.reference", "keyframe".into()),
        ("odometry.keyframe_distance", theirs.kf_dist_linear.into()),
        ("odometry.keyframe_angle", theirs.kf_dist_angular.into()),
        ("odometry.max_correction_distance", theirs.max_linear_correction.into()),
        ("odometry.max_correction_angle", theirs.max_angular_correction_deg.to_radians().into()),
        ("rejection.remove_duplicates", (theirs.outliers_remove_doubles == 1).into()),
    ];
    let to_points = [("matching.solver", "point_to_point".into()), ("matching.correspondence", "jump_table".into())];
    let by_transforms = [("prediction_frame", theirs.fixed_frame.clone().into())];
    let more = to_points.into_iter().filter(|_| matching_to_points).chain(by_transforms.into_iter().filter(|_| theirs.use_tf));
    settings.into_iter().chain(more).try_for_each(|(path, value)| config.set(path, &value, source))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::matching::solver::SolverKind;
    use crate::odometry::ReferenceChoice;
    use serde_json::json;

    #[test]
    fn defaults_are_those_of_the_other_node_where_they_show() {
        let (config, face) = translate(Value::Null, "/node").unwrap();
        assert_eq!((config.frames.odom_frame.as_str(), config.frames.base_frame.as_str()), ("world", "base_link"));
        assert_eq!(config.odometry.reference, ReferenceChoice::Keyframe);
        assert!((config.odometry.keyframe_distance - 0.1).abs() < 1e-12 && (config.odometry.keyframe_angle - 0.174).abs() < 1e-3);
        assert!(!config.cloud.input);
        assert_eq!(face.predictors, Predictors { odometry: true, imu: true, velocity: false, stamped_velocity: false });
        let poses = PoseTopics { pose: true, stamped: false, with_covariance: false, with_covariance_stamped: false };
        assert_eq!((face.poses, face.ignored.len()), (Some(poses), 0));
    }

    #[test]
    fn parameters_are_translated_and_those_that_mean_nothing_named() {
        let tree = json!({
            "fixed_frame": "map", "base_frame": "car", "use_cloud_input": true, "kf_dist_linear": 0.3, "use_odom": false, "use_vel": true,
            "stamped_vel": true, "publish_pose": false, "publish_pose_with_covariance_stamped": true, "use_tf": true,
            "max_iterations": 20, "sigma": 0.02, "use_point_to_line_distance": 0, "max_angular_correction_deg": 90.0,
            "restart": 1, "use_sigma_weights": 0, "contract": {"time_budget": "5ms"},
        });
        let (config, face) = translate(tree, "/node").unwrap();
        assert_eq!((config.frames.odom_frame.as_str(), config.frames.base_frame.as_str()), ("map", "car"));
        assert_eq!(config.frames.prediction_frame.as_deref(), Some("map"));
        assert!(config.cloud.input && (config.odometry.keyframe_distance - 0.3).abs() < 1e-12);
        assert!(
            (config.odometry.max_correction_angle - std::f64::consts::FRAC_PI_2).abs() < 1e-4
                && (config.matching.range_noise - 0.02).abs() < 1e-12
        );
        assert_eq!((config.matching.max_iterations, config.matching.solver), (20, SolverKind::PointToPoint));
        assert!((config.contract.time_budget.0 - 0.005).abs() < 1e-12, "this node's own names work too");
        assert_eq!(face.predictors, Predictors { odometry: false, imu: true, velocity: false, stamped_velocity: true });
        assert_eq!(face.ignored, ["restart", "use_sigma_weights"]);
        let range = translate(json!({"kf_dist_linear": -1}), "/node").unwrap_err().to_string();
        assert!(range.contains("kf_dist_linear") && range.contains("0 to 100"), "{range}");
    }

    #[test]
    fn what_the_other_node_would_pass_over_is_named_and_not_fatal() {
        let tree = json!({
            "use_alpha_beta": true, "alpha": 1.0, "beta": 0.8, "publy_pose": true, "kf_dist_lineal": 1, "sigma": 0.02,
            "contract": {"time_budget": "5ms", "time_bugdet": 1},
        });
        let (config, face) = translate(tree, "/node").unwrap();
        let names: Vec<&str> = face.ignored.iter().map(|text| text.split(' ').next().unwrap()).collect();
        assert_eq!(names, ["alpha", "beta", "contract.time_bugdet", "kf_dist_lineal", "publy_pose", "use_alpha_beta"]);
        for meant in ["contract.time_budget", "kf_dist_linear", "publish_pose"] {
            assert!(face.ignored.iter().any(|text| text.ends_with(&format!("(did you mean {meant}?)"))), "{:?}", face.ignored);
        }
        assert!((config.contract.time_budget.0 - 0.005).abs() < 1e-12 && (config.matching.range_noise - 0.02).abs() < 1e-12);
        assert!(translate(json!({"sigma": "much"}), "/node").is_err(), "a value that cannot be used is a mistake all the same");
    }

    #[test]
    fn what_is_mapped_is_read_by_the_matcher_in_use_or_named() {
        let tree =
            |to_lines| json!({"outliers_maxPerc": 0.8, "max_correspondence_dist": 0.4, "use_point_to_line_distance": to_lines});
        let (_, face) = translate(tree(1), "/node").unwrap();
        assert_eq!(face.ignored, ["max_correspondence_dist", "outliers_maxPerc"]);
        let (config, face) = translate(tree(0), "/node").unwrap();
        assert!(face.ignored.is_empty() && config.warnings().is_empty(), "{:?} {:?}", face.ignored, config.warnings());
        assert!((config.rejection.trim_percentile - 0.8).abs() < 1e-12);
        assert!((config.matching.max_correspondence_distance - 0.4).abs() < 1e-12);
    }

    #[test]
    fn the_frame_of_the_poses_is_called_as_it_was_set() {
        let problem = |tree| translate(tree, "/node").unwrap_err().to_string();
        assert!(problem(json!({"fixed_frame": ""})).contains("fixed_frame: it is empty"));
        assert!(problem(json!({"base_frame": "world"})).contains("fixed_frame: it is 'world'"));
    }
}
