//! Results of a study, for tables, plots and the profile file.

use super::comparison::Comparison;
use super::cost::{IterationCost, Level};
use super::knob::Knob;
use super::look_up::LookUpTable;
use super::run::Run;
use super::search_time::SearchTime;
use super::summary::CaseSummary;
use super::variant::Variant;
use crate::anytime::mode::ConditionRanges;
use crate::evaluation::trajectory::Trajectory;
use crate::io::profile_file::{Budget, ExpectedError, Profile, Provenance, VariantProfile};
use crate::matching::classic::correspondence::CorrespondenceKind;
use crate::matching::solver::SolverKind;

/// Definition of the errors, for readers of the files of a study.
pub const ERROR_DEFINITION: &str = "absolute trajectory error as of `anytime evaluate`: of each pose against the ground truth interpolated \
    to its stamp, after least-squares rigid alignment of the whole trajectory to the ground truth; it includes the drift of the whole drive";

/// Delay of one variant by iterations, and the models fitted to it.
#[derive(Clone, Debug)]
pub struct VariantCost {
    /// The variant.
    pub variant: Variant,
    /// Median delays by number of iterations.
    pub levels: Vec<Level>,
    /// Cost model fitted to the levels.
    pub model: Option<IterationCost>,
    /// Look-up table fitted to the delays of all answers.
    pub look_up: Option<LookUpTable>,
}

/// Results of a study.
pub struct Results {
    /// Summaries of the cases, sorted by variant, knob and value.
    pub cases: Vec<CaseSummary>,
    /// The first run of each case.
    pub first_runs: Vec<Run>,
    /// Costs of each variant.
    pub costs: Vec<VariantCost>,
    /// Comparisons of the look-up table with contracts.
    pub comparisons: Vec<Comparison>,
    /// Times of the correspondence searches.
    pub search_times: Vec<SearchTime>,
    /// The ground truth.
    pub truth: Trajectory,
    /// Data and settings that the results come from.
    pub provenance: Provenance,
}

impl Results {
    /// Indices of the cases that represent the study where a plot cannot show all: those of one variant and one knob.
    pub fn representative_cases(&self) -> Vec<usize> {
        representative_cases(self.cases.iter().map(|summary| (summary.case.variant, summary.case.knob)))
    }

    /// The variants, in the order of the cases.
    pub fn variants(&self) -> Vec<Variant> {
        self.costs.iter().map(|cost| cost.variant).collect()
    }

    /// The knobs that were varied.
    pub fn knobs(&self) -> Vec<Knob> {
        Knob::ALL.iter().copied().filter(|knob| self.cases.iter().any(|summary| summary.case.knob == *knob)).collect()
    }

    /// The cases of a variant that vary a knob.
    pub fn cases_of(&self, variant: Variant, knob: Knob) -> Vec<&CaseSummary> {
        self.cases.iter().filter(|summary| summary.case.variant == variant && summary.case.knob == knob).collect()
    }

    /// The performance profile: by time budget if that was varied, otherwise by the first varied knob of the list below.
    pub fn profile(&self) -> Profile {
        let variants = self.costs.iter().filter_map(|cost| {
            let knobs = [Knob::TimeBudget, Knob::MaxIterations, Knob::Beams, Knob::KeyframeDistance, Knob::Particles];
            let knob = *knobs.iter().find(|&&knob| !self.cases_of(cost.variant, knob).is_empty())?;
            let expected = variant_profile(&self.cases_of(cost.variant, knob), cost.model, self.conditions(cost.variant, knob))?;
            Some((cost.variant.to_string(), expected))
        });
        Profile { provenance: self.provenance.clone(), variants: variants.collect() }
    }

    /// Ranges of the conditions of a variant's answers while a knob was varied.
    fn conditions(&self, variant: Variant, knob: Knob) -> ConditionRanges {
        let is_wanted = |summary: &CaseSummary| summary.case.variant == variant && summary.case.knob == knob;
        let runs = self.cases.iter().zip(&self.first_runs).filter(|(summary, _)| is_wanted(summary)).map(|(_, run)| run);
        ConditionRanges::of(runs.flat_map(|run| run.scans.iter().filter_map(|scan| scan.conditions)))
    }
}

/// Indices of the cases of the default variant's first knob; of the first variant if the default one is not included.
pub(super) fn representative_cases(cases: impl Iterator<Item = (Variant, Knob)>) -> Vec<usize> {
    let cases: Vec<_> = cases.collect();
    let default = Variant::Matcher { search: CorrespondenceKind::Projective, solver: SolverKind::PointToLine };
    let Some(&chosen) = cases.iter().find(|case| case.0 == default).or(cases.first()) else { return Vec::new() };
    (0..cases.len()).filter(|&i| cases[i] == chosen).collect()
}

/// Performance profile of a variant from the cases that vary one knob; `None` if there are none.
fn variant_profile(cases: &[&CaseSummary], cost: Option<IterationCost>, conditions: ConditionRanges) -> Option<VariantProfile> {
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
