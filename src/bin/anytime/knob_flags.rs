//! Command-line flags that set a knob: the knob's declaration gives the help, the default and the check.

use std::convert::Infallible;

use anyhow::bail;
use anytime_scan_matcher::knobs::{KnobGroup, Value};

use crate::outcome::usage;

/// The value a flag was given: a number, a list, or else text.
#[allow(clippy::unnecessary_wraps)] // the form clap asks for
pub(crate) fn value(text: &str) -> Result<Value, Infallible> {
    Ok(serde_json::from_str(text).unwrap_or_else(|_| text.into()))
}

/// The help of a flag that sets a knob of `G`.
pub(crate) fn help<G: KnobGroup + Default>(name: &str) -> String {
    let table = G::default().table();
    table.iter().find(|knob| knob.name == name).map_or_else(String::new, |knob| {
        let default = format!("{} {}", knob.default, knob.unit);
        format!("{} [{}; default: {}]", knob.help.trim_end_matches('.'), knob.accepts, default.trim())
    })
}

/// Sets a knob, if its flag was given.
pub(crate) fn set(group: &mut dyn KnobGroup, name: &str, value: Option<&Value>) -> anyhow::Result<()> {
    match value.map(|value| group.set(name, value)) {
        None | Some(Some(Ok(()))) => Ok(()),
        Some(Some(Err(problem))) => Err(usage(format!("{name}: {problem}"))),
        Some(None) => bail!("there is no knob {name}"),
    }
}
