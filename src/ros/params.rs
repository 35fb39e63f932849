//! Reads the nodes' private parameters from the parameter server.

use std::path::Path;

use rosrust::api::Master;

use super::NodeError;
use crate::config::{Config, ConfigError, set_group};
use crate::knobs::{KnobGroup, Value};

/// Parameter that names a YAML file. The file is read first; the other parameters override it.
pub(super) const CONFIG_FILE: &str = "config";
/// Deprecated frame prefix that launch files set for whole groups of nodes. It is ignored.
const TF_PREFIX: &str = "tf_prefix";

/// Reads the configuration from the private parameters of `node`.
pub(super) fn read(master: &Master, node: &str) -> Result<Config, NodeError> {
    let tree = private_parameters(master, node)?;
    configure(Config::default(), tree, node).map_err(|problem| NodeError::Parameters { node: node.into(), problem })
}

/// Reads the parameters of a node that has only one group of them.
pub(super) fn read_group<G: KnobGroup + Default>(master: &Master, node: &str) -> Result<G, NodeError> {
    let (tree, mut group) = (private_parameters(master, node)?, G::default());
    let outcome = set_group(&mut group, &tree, &format!("parameters of {node}"));
    outcome.map(|()| group).map_err(|problem| NodeError::Parameters { node: node.into(), problem })
}

/// The error for a parameter whose value is invalid together with the others.
pub(super) fn bad_value(node: &str, name: &str, problem: String) -> NodeError {
    let problem = ConfigError::BadValue { source_name: format!("parameters of {node}"), path: name.into(), problem };
    NodeError::Parameters { node: node.into(), problem }
}

/// The private parameters of `node` as a tree.
pub(super) fn private_parameters(master: &Master, node: &str) -> Result<Value, NodeError> {
    let failed = |error| NodeError::ros(format!("read the parameters of {node}"), &error);
    let exists = master.has_param(node).map_err(failed)?;
    let mut tree = if exists { master.get_param(node).map_err(failed)? } else { Value::Null };
    if let Value::Object(parameters) = &mut tree {
        parameters.remove(TF_PREFIX);
    }
    Ok(tree)
}

/// Applies the configuration file and then the parameters of a tree to `config`.
pub(super) fn configure(mut config: Config, mut tree: Value, node: &str) -> Result<Config, ConfigError> {
    if let Value::Object(parameters) = &mut tree
        && let Some(file) = parameters.remove(CONFIG_FILE)
    {
        read_file(&mut config, &file, node)?;
    }
    let source = format!("parameters of {node}");
    config.set_tree(&tree, &source)?;
    config.check_frames(&source)?;
    Ok(config)
}

/// Reads a configuration file. An empty name means none: that is what a launch file passes on by default.
fn read_file(config: &mut Config, file: &Value, node: &str) -> Result<(), ConfigError> {
    match file.as_str() {
        Some("") => Ok(()),
        Some(path) => config.set_file(Path::new(path)),
        None => Err(ConfigError::BadValue {
            source_name: format!("parameters of {node}"),
            path: CONFIG_FILE.into(),
            problem: format!("expected the name of a YAML file, got {file}"),
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn configured(tree: Value, node: &str) -> Result<Config, ConfigError> {
        configure(Config::default(), tree, node)
    }

    #[test]
    fn single_parameters_override_the_file() {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), "base_frame: car\nmatching: {max_iterations: 7}\n").unwrap();
        let tree = json!({"config": file.path(), "matching": {"max_iterations": 9}});
        let config = configured(tree, "/node").unwrap();
        assert_eq!((config.frames.base_frame.as_str(), config.matching.max_iterations), ("car", 9));
        assert_eq!(configured(Value::Null, "/node").unwrap(), Config::default());
        assert_eq!(configured(json!({"config": ""}), "/node").unwrap(), Config::default());
    }

    #[test]
    fn errors_name_the_node_and_the_remedy() {
        let typo = configured(json!({"matching": {"max_iteration": 9}}), "/node").unwrap_err().to_string();
        assert!(typo.contains("parameters of /node") && typo.contains("did you mean 'matching.max_iterations'"), "{typo}");
        assert!(configured(json!({"config": 3}), "/node").unwrap_err().to_string().contains("YAML file"));
        assert!(configured(json!({"config": "no/such.yaml"}), "/node").unwrap_err().to_string().contains("no/such.yaml"));
    }
}
