//! Translation of the parameters of `laser_scan_matcher` to those of this node.

use std::collections::BTreeSet;

use rosrust::api::Master;
use serde_json::Map;

use crate::config::{Config, ConfigError, set_group};
use crate::knobs::{KnobGroup as _, Value, nearest_name};
use crate::ros::NodeError;
use crate::ros::params::{CONFIG_FILE, configure, private_parameters};

crate::knobs! {
    /// Parameters of `laser_scan_matcher` without a direct counterpart in this node.
    #[allow(unreachable_pub)]
    pub struct CompatKnobs {
        /// Frame of the published poses.
        fixed_frame: String = "world".into();
        /// Whether to match point clouds instead of scans.
        use_cloud_input: bool = false;
        /// Distance after which a new keyframe is made.
        kf_dist_linear: f64 = 0.1, in 0 to 100, unit "m";
        /// Rotation after which a new keyframe is made.
        kf_dist_angular: f64 = 10.0_f64.to_radians(), in 0 to 4, unit "rad";
        /// Whether to predict the heading with `imu/data`.
        use_imu: bool = true;
        /// Whether to predict with `odom`.
        use_odom: bool = true;
        /// Whether to predict with the transforms from `fixed_frame` to the base.
        use_tf: bool = false;
        /// Whether to predict with `vel`.
        use_vel: bool = false;
        /// Whether `vel` has stamped messages.
        stamped_vel: bool = false;
        /// Whether to publish `pose2D`.
        publish_pose: bool = true;
        /// Whether to publish `pose_stamped`.
        publish_pose_stamped: bool = false;
        /// Whether to publish `pose_with_covariance`.
        publish_pose_with_covariance: bool = false;
        /// Whether to publish `pose_with_covariance_stamped`.
        publish_pose_with_covariance_stamped: bool = false;
        /// A match that moves the prediction by more than this is rejected.
        max_linear_correction: f64 = 0.5, in 0.01 to 100, unit "m";
        /// A match that rotates the prediction by more than this is rejected.
        max_angular_correction_deg: f64 = 45.0, in 0.6 to 180, unit "deg";
        /// Whether to match points to lines (1) or to points (0).
        use_point_to_line_distance: u32 = 1, in 0 to 1;
        /// Whether each reference point may be used at most once, 0 or 1.
        outliers_remove_doubles: u32 = 1, in 0 to 1;
    }
}

/// Parameters with other names in this node. Their defaults are those of this node: the defaults of `laser_scan_matcher` suit its
/// own matcher.
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

/// Parameters that have no effect on this matcher.
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

/// Parameters that only the closest-point search uses.
const CLOSEST_POINT_ONLY: [&str; 4] = [
    "matching.max_correspondence_distance",
    "rejection.trim_percentile",
    "rejection.adaptive_percentile",
    "rejection.adaptive_multiplier",
];

/// Which pose topics to publish.
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
    /// Stamped velocities.
    pub(in crate::ros) stamped_velocity: bool,
}

/// Optional inputs and outputs of the node.
#[derive(Clone, Debug, PartialEq)]
pub(in crate::ros) struct NodeInterface {
    pub(in crate::ros) predictors: Predictors,
    /// Pose topics of `laser_scan_matcher`; `None`: not in compatibility mode.
    pub(in crate::ros) poses: Option<PoseTopics>,
    /// Parameters that are set but have no effect in this node.
    pub(in crate::ros) ignored: Vec<String>,
}

impl NodeInterface {
    /// The interface without compatibility mode.
    pub(in crate::ros) fn native() -> Self {
        let predictors = Predictors { odometry: true, imu: true, velocity: true, stamped_velocity: false };
        Self { predictors, poses: None, ignored: Vec::new() }
    }
}

/// Reads the configuration from the private parameters of `node`, which may have the names of `laser_scan_matcher` or those of
/// this node.
pub(in crate::ros) fn read(master: &Master, node: &str) -> Result<(Config, NodeInterface), NodeError> {
    let tree = private_parameters(master, node)?;
    translate(tree, node).map_err(|problem| NodeError::Parameters { node: node.into(), problem })
}

fn translate(mut tree: Value, node: &str) -> Result<(Config, NodeInterface), ConfigError> {
    let source = format!("parameters of {node}");
    let mut compat = CompatKnobs::default();
    let (mut ignored, mut renamed) = (Vec::new(), Vec::new());
    if let Value::Object(parameters) = &mut tree {
        let mut take = |name: &str| parameters.remove(name);
        ignored.extend(IGNORED.iter().filter(|name| take(name).is_some()).map(|name| (*name).to_owned()));
        renamed.extend(RENAMED.iter().filter_map(|(name, ours)| Some((*name, *ours, take(name)?))));
        let known = compat.table();
        let given = known.iter().filter_map(|knob| Some((knob.name.to_owned(), take(knob.name)?))).collect();
        set_group(&mut compat, &Value::Object(given), &source)?;
        ignored.extend(remove_unknown(parameters, "", &native_names()));
    }
    let mut defaults = Config::default();
    apply_compat(&compat, &mut defaults, &source)?;
    for (_, path, value) in &renamed {
        defaults.set(path, value, &source)?;
    }
    let config = configure(defaults, tree, node).map_err(with_compat_name)?;
    // Parameters of the closest-point search have no effect if correspondences are found by projection.
    let is_used = |path: &str| config.matching.correspondence.search().is_some() || !CLOSEST_POINT_ONLY.contains(&path);
    ignored.extend(renamed.iter().filter(|(_, path, _)| !is_used(path)).map(|(name, ..)| (*name).to_owned()));
    let predictors = Predictors {
        odometry: compat.use_odom,
        imu: compat.use_imu,
        velocity: compat.use_vel && !compat.stamped_vel,
        stamped_velocity: compat.use_vel && compat.stamped_vel,
    };
    let poses = PoseTopics {
        pose: compat.publish_pose,
        stamped: compat.publish_pose_stamped,
        with_covariance: compat.publish_pose_with_covariance,
        with_covariance_stamped: compat.publish_pose_with_covariance_stamped,
    };
    let interface = NodeInterface { predictors, poses: Some(poses), ignored };
    Ok((config, interface))
}

/// The names of all parameters of this node.
fn native_names() -> BTreeSet<String> {
    Config::default().table().into_iter().map(|(path, _)| path).chain([CONFIG_FILE.into()]).collect()
}

/// Removes parameters that neither node knows, since `laser_scan_matcher` would ignore them. Returns their names, each with the
/// likely intended one.
fn remove_unknown(parameters: &mut Map<String, Value>, prefix: &str, known: &BTreeSet<String>) -> Vec<String> {
    let mut unknown = Vec::new();
    parameters.retain(|name, value| {
        let path = format!("{prefix}{name}");
        if let Value::Object(inner) = value {
            unknown.extend(remove_unknown(inner, &format!("{path}."), known));
            return true;
        }
        let is_known = known.contains(&path);
        if !is_known {
            let compat = CompatKnobs::default().table();
            let near = if prefix.is_empty() {
                nearest_name(&path, compat.iter().map(|knob| knob.name).chain(RENAMED.iter().map(|(name, _)| *name)))
            } else {
                nearest_name(&path, known.iter().map(String::as_str))
            };
            unknown.push(near.map_or_else(|| path.clone(), |near| format!("{path} (did you mean {near}?)")));
        }
        is_known
    });
    unknown
}

/// Renames the frame in an error: both frames of this node are `fixed_frame` in `laser_scan_matcher`.
fn with_compat_name(error: ConfigError) -> ConfigError {
    match error {
        ConfigError::BadValue { source_name, path, problem } if ["map_frame", "odom_frame"].contains(&&*path) => {
            ConfigError::BadValue { source_name, path: "fixed_frame".into(), problem }
        }
        error => error,
    }
}

/// Sets this node's parameters to the meaning of those of `laser_scan_matcher`.
fn apply_compat(compat: &CompatKnobs, config: &mut Config, source: &str) -> Result<(), ConfigError> {
    let matching_to_points = compat.use_point_to_line_distance == 0;
    let settings: [(&str, Value); 10] = [
        ("map_frame", compat.fixed_frame.clone().into()),
        ("odom_frame", compat.fixed_frame.clone().into()),
        ("publish_map_tf", false.into()),
        ("cloud.input", compat.use_cloud_input.into()),
        ("odometry.reference", "keyframe".into()),
        ("odometry.keyframe_distance", compat.kf_dist_linear.into()),
        ("odometry.keyframe_angle", compat.kf_dist_angular.into()),
        ("odometry.max_correction_distance", compat.max_linear_correction.into()),
        ("odometry.max_correction_angle", compat.max_angular_correction_deg.to_radians().into()),
        ("rejection.remove_duplicates", (compat.outliers_remove_doubles == 1).into()),
    ];
    let to_points = [("matching.solver", "point_to_point".into()), ("matching.correspondence", "jump_table".into())];
    let by_transforms = [("prediction_frame", compat.fixed_frame.clone().into())];
    let more = to_points.into_iter().filter(|_| matching_to_points).chain(by_transforms.into_iter().filter(|_| compat.use_tf));
    settings.into_iter().chain(more).try_for_each(|(path, value)| config.set(path, &value, source))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::matching::solver::SolverKind;
    use crate::odometry::ReferenceChoice;
    use serde_json::json;

    #[test]
    fn visible_defaults_are_those_of_laser_scan_matcher() {
        let (config, interface) = translate(Value::Null, "/node").unwrap();
        assert_eq!((config.frames.odom_frame.as_str(), config.frames.base_frame.as_str()), ("world", "base_link"));
        assert_eq!(config.odometry.reference, ReferenceChoice::Keyframe);
        assert!((config.odometry.keyframe_distance - 0.1).abs() < 1e-12 && (config.odometry.keyframe_angle - 0.174).abs() < 1e-3);
        assert!(!config.cloud.input);
        assert_eq!(interface.predictors, Predictors { odometry: true, imu: true, velocity: false, stamped_velocity: false });
        let poses = PoseTopics { pose: true, stamped: false, with_covariance: false, with_covariance_stamped: false };
        assert_eq!((interface.poses, interface.ignored.len()), (Some(poses), 0));
    }

    #[test]
    fn parameters_are_translated_and_those_without_effect_are_listed() {
        let tree = json!({
            "fixed_frame": "map", "base_frame": "car", "use_cloud_input": true, "kf_dist_linear": 0.3, "use_odom": false, "use_vel": true,
            "stamped_vel": true, "publish_pose": false, "publish_pose_with_covariance_stamped": true, "use_tf": true,
            "max_iterations": 20, "sigma": 0.02, "use_point_to_line_distance": 0, "max_angular_correction_deg": 90.0,
            "restart": 1, "use_sigma_weights": 0, "contract": {"time_budget": "5ms"},
        });
        let (config, interface) = translate(tree, "/node").unwrap();
        assert_eq!((config.frames.odom_frame.as_str(), config.frames.base_frame.as_str()), ("map", "car"));
        assert_eq!(config.frames.prediction_frame.as_deref(), Some("map"));
        assert!(config.cloud.input && (config.odometry.keyframe_distance - 0.3).abs() < 1e-12);
        assert!(
            (config.odometry.max_correction_angle - std::f64::consts::FRAC_PI_2).abs() < 1e-4
                && (config.matching.range_noise - 0.02).abs() < 1e-12
        );
        assert_eq!((config.matching.max_iterations, config.matching.solver), (20, SolverKind::PointToPoint));
        assert!((config.contract.time_budget.0 - 0.005).abs() < 1e-12, "this node's own names work too");
        assert_eq!(interface.predictors, Predictors { odometry: false, imu: true, velocity: false, stamped_velocity: true });
        assert_eq!(interface.ignored, ["restart", "use_sigma_weights"]);
        let range = translate(json!({"kf_dist_linear": -1}), "/node").unwrap_err().to_string();
        assert!(range.contains("kf_dist_linear") && range.contains("0 to 100"), "{range}");
    }

    #[test]
    fn unknown_parameters_are_listed_and_not_fatal() {
        let tree = json!({
            "use_alpha_beta": true, "alpha": 1.0, "beta": 0.8, "publy_pose": true, "kf_dist_lineal": 1, "sigma": 0.02,
            "contract": {"time_budget": "5ms", "time_bugdet": 1},
        });
        let (config, interface) = translate(tree, "/node").unwrap();
        let names: Vec<&str> = interface.ignored.iter().map(|text| text.split(' ').next().unwrap()).collect();
        assert_eq!(names, ["alpha", "beta", "contract.time_bugdet", "kf_dist_lineal", "publy_pose", "use_alpha_beta"]);
        for meant in ["contract.time_budget", "kf_dist_linear", "publish_pose"] {
            assert!(
                interface.ignored.iter().any(|text| text.ends_with(&format!("(did you mean {meant}?)"))),
                "{:?}",
                interface.ignored
            );
        }
        assert!((config.contract.time_budget.0 - 0.005).abs() < 1e-12 && (config.matching.range_noise - 0.02).abs() < 1e-12);
        assert!(translate(json!({"sigma": "much"}), "/node").is_err(), "an invalid value is still an error");
    }

    #[test]
    fn translated_parameters_are_used_by_the_matcher_or_listed() {
        let tree =
            |to_lines| json!({"outliers_maxPerc": 0.8, "max_correspondence_dist": 0.4, "use_point_to_line_distance": to_lines});
        let (_, interface) = translate(tree(1), "/node").unwrap();
        assert_eq!(interface.ignored, ["max_correspondence_dist", "outliers_maxPerc"]);
        let (config, interface) = translate(tree(0), "/node").unwrap();
        assert!(interface.ignored.is_empty() && config.warnings().is_empty(), "{:?} {:?}", interface.ignored, config.warnings());
        assert!((config.rejection.trim_percentile - 0.8).abs() < 1e-12);
        assert!((config.matching.max_correspondence_distance - 0.4).abs() < 1e-12);
    }

    #[test]
    fn errors_about_frames_name_the_parameter_that_was_set() {
        let problem = |tree| translate(tree, "/node").unwrap_err().to_string();
        assert!(problem(json!({"fixed_frame": ""})).contains("fixed_frame: it is empty"));
        assert!(problem(json!({"base_frame": "world"})).contains("fixed_frame: it is 'world'"));
    }
}
