//! Command-line flags that set a parameter. Help, default and range come from the declaration of the parameter.

use std::convert::Infallible;

use anyhow::bail;
use anytime_scan_matcher::knobs::{KnobGroup, Value};

use crate::outcome::usage;

/// Parses the value of a flag: a number, a list, or else text.
#[allow(clippy::unnecessary_wraps)] // required by clap
pub(crate) fn value(text: &str) -> Result<Value, Infallible> {
    Ok(serde_json::from_str(text).unwrap_or_else(|_| text.into()))
}

/// The help text of a flag that sets a parameter of `G`.
pub(crate) fn help<G: KnobGroup + Default>(name: &str) -> String {
    let table = G::default().table();
    table.iter().find(|knob| knob.name == name).map_or_else(String::new, |knob| {
        let default = format!("{} {}", knob.default, knob.unit);
        format!("{} [{}; default: {}]", knob.help.trim_end_matches('.'), knob.accepts, default.trim())
    })
}

/// Sets a parameter if its flag was given.
pub(crate) fn set(group: &mut dyn KnobGroup, name: &str, value: Option<&Value>) -> anyhow::Result<()> {
    match value.map(|value| group.set(name, value)) {
        None | Some(Some(Ok(()))) => Ok(()),
        Some(Some(Err(problem))) => Err(usage(format!("{name}: {problem}"))),
        Some(None) => bail!("there is no parameter {name}"),
    }
}
