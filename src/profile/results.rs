//! What a study has found, for tables, pictures and the profile.

use super::comparison::Comparison;
use super::cost::{IterationCost, Level};
use super::knob::Knob;
use super::look_up::LookUpTable;
use super::run::Run;
use super::search_time::SearchTime;
use super::summary::CaseSummary;
use super::variant::Variant;
use crate::anytime::mode::Ranges;
use crate::evaluation::trajectory::Trajectory;
use crate::io::profile_file::{Budget, ExpectedError, Profile, Provenance, VariantProfile};
use crate::matching::classic::correspondence::Correspondence;
use crate::matching::solver::SolverKind;

/// What the errors of a study are, for those who read its files.
pub const ERROR_MEANS: &str = "of each pose against the truth interpolated to its stamp, after the one rigid motion that lays the \
    whole trajectory onto the truth with the least squared distance of the positions (absolute trajectory error, as `anytime evaluate` \
    has it); it holds the drift of the whole drive";

/// Delay against iterations of one variant.
#[derive(Clone, Debug)]
pub struct VariantCost {
    /// The variant.
    pub variant: Variant,
    /// Median delays.
    pub levels: Vec<Level>,
    /// The line through them.
    pub model: Option<IterationCost>,
    /// The plane through all delays.
    pub look_up: Option<LookUpTable>,
}

/// What a study has found.
pub struct Results {
    /// By variant, knob and value.
    pub cases: Vec<CaseSummary>,
    /// The first run of each case.
    pub first_runs: Vec<Run>,
    /// Of each variant.
    pub costs: Vec<VariantCost>,
    /// The look-up table beside contracts.
    pub comparisons: Vec<Comparison>,
    /// Of each kind of search.
    pub search_times: Vec<SearchTime>,
    /// The truth.
    pub truth: Trajectory,
    /// Where the figures come from.
    pub provenance: Provenance,
}

impl Results {
    /// The cases, of one variant and for one turn of a knob each, that stand for the study where a picture cannot show all.
    pub fn showcase(&self) -> Vec<usize> {
        showcase(self.cases.iter().map(|summary| (summary.case.variant, summary.case.knob)))
    }

    /// The variants, in the order of the cases.
    pub fn variants(&self) -> Vec<Variant> {
        self.costs.iter().map(|cost| cost.variant).collect()
    }

    /// The knobs that were turned.
    pub fn knobs(&self) -> Vec<Knob> {
        Knob::ALL.iter().copied().filter(|knob| self.cases.iter().any(|summary| summary.case.knob == *knob)).collect()
    }

    /// The cases of a variant that turn a knob.
    pub fn of(&self, variant: Variant, knob: Knob) -> Vec<&CaseSummary> {
        self.cases.iter().filter(|summary| summary.case.variant == variant && summary.case.knob == knob).collect()
    }

    /// The profile: delays by time budget if that was turned, else by the next best knob.
    pub fn profile(&self) -> Profile {
        let variants = self.costs.iter().filter_map(|cost| {
            let knobs = [Knob::TimeBudget, Knob::MaxIterations, Knob::Beams, Knob::KeyframeDistance, Knob::Particles];
            let knob = *knobs.iter().find(|&&knob| !self.of(cost.variant, knob).is_empty())?;
            let expected = expectations(&self.of(cost.variant, knob), cost.model, self.conditions(cost.variant, knob))?;
            Some((cost.variant.to_string(), expected))
        });
        Profile { provenance: self.provenance.clone(), variants: variants.collect() }
    }

    /// The conditions of the answers of a variant while a knob was turned.
    fn conditions(&self, variant: Variant, knob: Knob) -> Ranges {
        let is_wanted = |summary: &CaseSummary| summary.case.variant == variant && summary.case.knob == knob;
        let runs = self.cases.iter().zip(&self.first_runs).filter(|(summary, _)| is_wanted(summary)).map(|(_, run)| run);
        Ranges::of(runs.flat_map(|run| run.scans.iter().filter_map(|scan| scan.conditions)))
    }
}

/// The cases of the first knob of the default variant, or of the first variant where the default one is not among them.
pub(super) fn showcase(cases: impl Iterator<Item = (Variant, Knob)>) -> Vec<usize> {
    let cases: Vec<_> = cases.collect();
    let default = Variant::Matcher { search: Correspondence::Projective, solver: SolverKind::PointToLine };
    let Some(&chosen) = cases.iter().find(|case| case.0 == default).or(cases.first()) else { return Vec::new() };
    (0..cases.len()).filter(|&i| cases[i] == chosen).collect()
}

/// What to expect of a variant, by the cases that turn one knob; `None` without any.
fn expectations(cases: &[&CaseSummary], cost: Option<IterationCost>, conditions: Ranges) -> Option<VariantProfile> {
    let knob = cases.first()?.case.knob;
    let budget = |summary: &&CaseSummary| {
        let (position, orientation) = (summary.figures.position, summary.figures.orientation);
        let error = ExpectedError {
            position_mean_m: position.mean,
            position_p95_m: position.p95,
            orientation_mean_rad: orientation.mean,
            orientation_p95_rad: orientation.p95,
        };
        let delta_s = match knob {
            Knob::TimeBudget if summary.case.value > 0.0 => summary.case.value,
            _ => summary.figures.delay.p99 * 1e-6,
        };
        Budget { delta_s, error }
    };
    let cost = cost.map(|cost| (cost.setup_us, cost.per_ray_us));
    Some(VariantProfile::new(knob.name(), cost, conditions, cases.iter().map(budget).collect()))
}
