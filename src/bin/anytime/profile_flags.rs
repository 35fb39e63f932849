//! Arguments of `anytime profile`.

use std::path::PathBuf;
use std::time::Duration;

use anytime_scan_matcher::anytime::contract::Contract;
use anytime_scan_matcher::knobs::KnobValue;
use anytime_scan_matcher::profile::knob::Knob;
use anytime_scan_matcher::profile::plan::Sweep;
use anytime_scan_matcher::profile::variant::Variant;
use clap::Args;

use crate::input_flags::InputFlags;
use crate::outcome::usage;
use crate::simulation_flags::SimulationFlags;

/// Measure delay and error of every variant over the values of its knobs: tables, plots, a report, and a profile for planners
///
/// Errors are computed as by `anytime evaluate`: after alignment of the whole trajectory to the ground truth.
#[derive(Args)]
pub(crate) struct Arguments {
    /// The bag (or use --world)
    #[arg(required_unless_present = "world", conflicts_with_all = ["world", "SimulationFlags"])]
    pub(crate) bag: Option<PathBuf>,
    /// Simulate a drive first and record it in DIR/drive.bag: corridor, room, or the YAML file of a map
    #[arg(long)]
    pub(crate) world: Option<String>,
    /// The output folder
    #[arg(long, value_name = "DIR")]
    pub(crate) out: PathBuf,
    #[arg(long, value_parser = |text: &str| Knob::from_value(&text.into()), help = knob_help())]
    knob: Vec<Knob>,
    /// The values of the knob, such as 1,2,4,8 or 1ms,5ms [default: depends on the knob]
    #[arg(long, value_delimiter = ',', requires = "knob")]
    values: Vec<String>,
    /// Profile this variant, such as `jump_table+point_to_line` or `particle_filter`; may be repeated [default: every search with
    /// every solver]
    #[arg(long, value_name = "SEARCH+SOLVER")]
    variant: Vec<Variant>,
    /// Also profile the particle filter, on this map, a YAML file of `map_server`; the ground truth must be in the frame of the
    /// map
    #[arg(long, value_name = "M.yaml")]
    pub(crate) map: Option<PathBuf>,
    /// Compare the look-up table with a contract at this time limit, such as 500us; several may be given, separated by commas
    #[arg(long, value_name = "TIME", value_delimiter = ',', value_parser = delta, allow_hyphen_values = true)]
    pub(crate) delta: Vec<Duration>,
    /// Number of runs per case, interleaved with those of all other cases
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..))]
    pub(crate) rounds: u32,
    /// Seed of the order of the runs within the rounds, and of the simulated drive
    #[arg(long, default_value_t = 1)]
    pub(crate) seed: u32,
    /// Print one JSON object
    #[arg(long)]
    pub(crate) json: bool,
    #[command(flatten)]
    pub(crate) input: InputFlags,
    #[command(flatten)]
    pub(crate) simulation: SimulationFlags,
}

fn delta(text: &str) -> Result<Duration, String> {
    let seconds = Knob::TimeBudget.parse(text)?;
    let contract = Contract::new(seconds, 0.0, 0.0).map_err(|problem| problem.to_string())?;
    contract.time_budget.ok_or_else(|| "expected a time above 0, such as 500us".into())
}

fn knob_help() -> String {
    format!("Vary this knob: {}; may be repeated [default: every knob, one after the other]", Knob::kind())
}

impl Arguments {
    pub(crate) fn variants(&self) -> anyhow::Result<Vec<Variant>> {
        let mut variants = if self.variant.is_empty() { Variant::matchers() } else { self.variant.clone() };
        match (variants.contains(&Variant::Filter), &self.map) {
            (true, None) => return Err(usage("the particle filter needs a map: use --map M.yaml")),
            (false, Some(_)) => variants.push(Variant::Filter),
            _ => {}
        }
        for &knob in &self.knob {
            let is_used = variants.iter().any(|&variant| knob.applies_to(variant));
            if !is_used {
                let name = knob.name();
                let problem = format!(
                    "--knob {name}: no profiled variant has this knob (to profile the particle filter, use --map M.yaml)"
                );
                return Err(usage(problem));
            }
        }
        Ok(variants)
    }

    pub(crate) fn sweeps(&self) -> anyhow::Result<Vec<Sweep>> {
        if let ([knob], false) = (self.knob.as_slice(), self.values.is_empty()) {
            let values = self.values.iter().map(|text| knob.parse(text.trim())).collect::<Result<Vec<_>, _>>();
            let values = values.map_err(|problem| usage(format!("--values: {problem}")))?;
            return Ok(vec![Sweep { knob: *knob, values: Some(values) }]);
        }
        if !self.values.is_empty() {
            return Err(usage("--values needs exactly one --knob: give --knob once, or omit --values"));
        }
        let knobs = if self.knob.is_empty() { Knob::ALL } else { &self.knob };
        Ok(knobs.iter().map(|&knob| Sweep { knob, values: None }).collect())
    }
}
