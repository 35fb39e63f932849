//! Parameters that are changed while the node runs: a few take effect at once, changes of the others are ignored with a warning.

use std::collections::BTreeMap;
use std::time::Duration;

use rosrust::api::Master;

use super::{NodeError, params};
use crate::anytime::contract::Contract;
use crate::config::Config;
use crate::knobs::Value;

/// Makes the change that a configuration asks for.
type ChangeTo = fn(&Config, &Contract) -> Change;

/// The parameters that can be changed while the node runs, and what to do on a change.
const LIVE: &[(&str, ChangeTo)] = &[
    ("contract.time_budget", |_, contract| Limit::TimeBudget(contract.time_budget).into()),
    ("contract.translation_error_bound", |_, contract| Limit::TranslationErrorBound(contract.translation_error_bound).into()),
    ("contract.rotation_error_bound", |_, contract| Limit::RotationErrorBound(contract.rotation_error_bound).into()),
    ("matching.max_iterations", |config, _| Change::Matching(MatchingChange::MaxIterations(config.matching.max_iterations))),
    ("publish_tf", |config, _| transform(&config.frames.base_frame, config.frames.publish_tf)),
    ("publish_map_tf", |config, _| transform(&config.frames.odom_frame, config.frames.publish_map_tf)),
];

fn transform(child: &str, on: bool) -> Change {
    Change::PublishTransform { child: child.into(), on }
}

/// A change that takes effect at once.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Change {
    Matching(MatchingChange),
    /// Whether to publish the transform to `child`.
    PublishTransform {
        child: String,
        on: bool,
    },
}

/// A change for the matching thread, in force from the next scan on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum MatchingChange {
    Limit(Limit),
    MaxIterations(u32),
}

/// A new value for one limit of the contract. The other limits keep their current values, whether from parameters or from a
/// topic.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Limit {
    TimeBudget(Option<Duration>),
    TranslationErrorBound(Option<f64>),
    RotationErrorBound(Option<f64>),
}

impl From<Limit> for Change {
    fn from(limit: Limit) -> Self {
        Self::Matching(MatchingChange::Limit(limit))
    }
}

impl Limit {
    /// Returns the contract with this limit.
    pub(super) fn applied_to(self, contract: Contract) -> Contract {
        match self {
            Self::TimeBudget(time_budget) => Contract { time_budget, ..contract },
            Self::TranslationErrorBound(translation_error_bound) => Contract { translation_error_bound, ..contract },
            Self::RotationErrorBound(rotation_error_bound) => Contract { rotation_error_bound, ..contract },
        }
    }
}

/// Polls the private parameters of the node for changes.
///
/// A deleted parameter keeps its value: a restarted master has no parameters at all.
pub(super) struct ParameterWatch<'a> {
    master: &'a Master,
    node: String,
    seen: BTreeMap<String, Value>,
    config: Config,
}

impl<'a> ParameterWatch<'a> {
    /// `config` is the configuration that the node has read from its parameters and runs with.
    pub(super) fn new(master: &'a Master, node: &str, config: &Config) -> Result<Self, NodeError> {
        let seen = leaves(&params::private_parameters(master, node)?);
        Ok(Self { master, node: node.into(), seen, config: config.clone() })
    }

    /// Returns the changes since the last poll: the name and value of each parameter, and the change or the reason why it is
    /// ignored. If the master does not answer, there are no changes.
    pub(super) fn poll(&mut self) -> Vec<(String, Result<Change, String>)> {
        match params::private_parameters(self.master, &self.node) {
            Ok(tree) => self.compare(leaves(&tree)),
            Err(_) => Vec::new(),
        }
    }

    fn compare(&mut self, found: BTreeMap<String, Value>) -> Vec<(String, Result<Change, String>)> {
        let mut changes = Vec::new();
        for (path, value) in found {
            if self.seen.get(&path) != Some(&value) {
                changes.extend(self.change(&path, &value).map(|change| (format!("{path} = {value}"), change)));
                self.seen.insert(path, value);
            }
        }
        changes
    }

    /// Returns `None` if the value is the old one in another notation.
    fn change(&mut self, path: &str, value: &Value) -> Option<Result<Change, String>> {
        let mut config = self.config.clone();
        let source = format!("parameters of {}", self.node);
        if let Err(error) = config.set(path, value, &source) {
            return Some(Err(error.to_string()));
        }
        if config == self.config {
            return None;
        }
        if let Err(error) = config.check_frames(&source) {
            return Some(Err(error.to_string()));
        }
        let Some((_, change)) = LIVE.iter().find(|(live, _)| *live == path) else {
            let live: Vec<&str> = LIVE.iter().map(|(path, _)| *path).collect();
            return Some(Err(format!(
                "it takes effect after a restart of the node; only these take effect at once: {}",
                live.join(", ")
            )));
        };
        let change = match Contract::try_from(&config.contract) {
            Ok(contract) => change(&config, &contract),
            Err(error) => return Some(Err(error.to_string())),
        };
        self.config = config;
        Some(Ok(change))
    }
}

/// The values of a parameter tree by their dotted paths.
fn leaves(tree: &Value) -> BTreeMap<String, Value> {
    let mut found = BTreeMap::new();
    let mut left = vec![(String::new(), tree)];
    while let Some((prefix, tree)) = left.pop() {
        match tree {
            Value::Object(entries) => {
                let path = |name: &String| if prefix.is_empty() { name.clone() } else { format!("{prefix}.{name}") };
                left.extend(entries.iter().map(|(name, value)| (path(name), value)));
            }
            Value::Null => {}
            value => {
                found.insert(prefix, value.clone());
            }
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn watch<'a>(master: &'a Master, tree: &Value) -> ParameterWatch<'a> {
        let mut config = Config::default();
        config.set_tree(tree, "test").unwrap();
        ParameterWatch { master, node: "/node".into(), seen: leaves(tree), config }
    }

    #[test]
    fn some_changes_take_effect_and_others_are_ignored() {
        let master = Master::new("http://localhost:1", "/node", "").unwrap();
        let mut watch = watch(&master, &json!({"contract": {"time_budget": "5ms"}, "matching": {"solver": "linearized"}}));
        let mut poll = |tree: Value| watch.compare(leaves(&tree));
        assert_eq!(poll(json!({"contract": {"time_budget": "5ms"}})), []);
        assert_eq!(poll(json!({"contract": {"time_budget": 0.005}})), [], "the same value in another notation");
        let changes = poll(json!({"contract": {"time_budget": 0.007}}));
        let limit = Limit::TimeBudget(Some(Duration::from_millis(7)));
        assert_eq!(changes, [("contract.time_budget = 0.007".into(), Ok(Change::Matching(MatchingChange::Limit(limit))))]);
        let by_topic = Contract { translation_error_bound: Some(0.01), ..Contract::default() };
        assert_eq!(limit.applied_to(by_topic), Contract { time_budget: Some(Duration::from_millis(7)), ..by_topic });
        let changes = poll(json!({"publish_tf": false, "publish_map_tf": false, "matching": {"max_iterations": 3}}));
        let changes: Vec<Change> = changes.into_iter().map(|(_, change)| change.unwrap()).collect();
        let silent = |child: &str| Change::PublishTransform { child: child.into(), on: false };
        assert_eq!(changes, [Change::Matching(MatchingChange::MaxIterations(3)), silent("odom"), silent("base_link")]);
        for (tree, remedy) in [
            (json!({"matching": {"solver": "point_to_line"}}), "after a restart"),
            (json!({"matching": {"max_iterations": 0}}), "expected 1 to 1000"),
            (json!({"matching": {"max_iteration": 4}}), "did you mean"),
            (json!({"config": "other.yaml"}), "there is no parameter 'config'"),
        ] {
            let [(_, Err(problem))] = &poll(tree.clone())[..] else { panic!("{tree}") };
            assert!(problem.contains(remedy), "{problem}");
            assert_eq!(poll(tree), [], "it is reported once");
        }
        assert_eq!(poll(Value::Null), [], "a restarted master");
    }
}
