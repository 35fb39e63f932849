//! Report of the trajectory errors, as text and as JSON.

use std::fmt;

use serde_json::{Value, json};

use super::association::{AssociationError, associate};
use super::ate::{Ate, ate};
use super::relations::{Relation, RelationErrors, SHORT_S, relation_errors};
use super::rpe::rpe;
use super::statistics::PoseErrors;
use super::trajectory::Trajectory;
use crate::text_table::TextTable;

/// Parameters of a comparison.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Comparison {
    /// Maximum time difference of associated poses, s.
    pub max_dt: f64,
    /// Path length over which drift is measured (RPE), m.
    pub rpe_distance: f64,
}

impl Default for Comparison {
    fn default() -> Self {
        Self { max_dt: 0.1, rpe_distance: 1.0 }
    }
}

/// Results of a comparison.
#[derive(Clone, Debug, PartialEq)]
pub struct Report {
    comparison: Comparison,
    /// Number of estimated poses.
    pub poses: usize,
    /// Number of estimated poses with a true pose.
    pub matched: usize,
    /// Absolute trajectory error; `None` without truth.
    pub ate: Option<Ate>,
    /// Relative pose error over [`Comparison::rpe_distance`]; `None` without truth, or if the true path is shorter.
    pub rpe: Option<PoseErrors>,
    /// Errors of the relations; `None` without relations.
    pub relations: Option<RelationErrors>,
    /// Warnings about the input that limit the validity of the errors.
    pub warnings: Vec<String>,
}

impl Report {
    /// Compares `estimate` with the truth and the relations, if given.
    pub fn new(
        estimate: &Trajectory,
        truth: Option<&Trajectory>,
        relations: Option<&[Relation]>,
        comparison: Comparison,
    ) -> Result<Self, AssociationError> {
        let Comparison { max_dt, rpe_distance } = comparison;
        let matched = truth.map(|truth| associate(estimate, truth, max_dt)).transpose()?.unwrap_or_default();
        let mut report = Self {
            comparison,
            poses: estimate.poses().len(),
            matched: matched.len(),
            ate: ate(&matched),
            rpe: rpe(&matched, rpe_distance),
            relations: relations.and_then(|relations| relation_errors(estimate, relations, max_dt)),
            warnings: Vec::new(),
        };
        report.warnings = report.input_warnings(estimate);
        Ok(report)
    }

    fn input_warnings(&self, estimate: &Trajectory) -> Vec<String> {
        let Comparison { max_dt, rpe_distance } = self.comparison;
        let mut warnings = Vec::new();
        let mut warn = |applies: bool, text: String| {
            if applies {
                warnings.push(text);
            }
        };
        let (steps_back, duplicates) = (estimate.steps_back(), estimate.duplicates());
        warn(steps_back > 0, format!("{steps_back} stamps of the trajectory go back in time: its poses were sorted"));
        warn(duplicates > 0, format!("{duplicates} poses repeat a stamp: the first pose of each stamp was used"));
        if self.ate.is_some() {
            let unmatched = self.poses - self.matched;
            warn(unmatched > 0, format!("{unmatched} of {} poses have no true pose within {max_dt} s", self.poses));
            warn(self.rpe.is_none(), format!("the true path is shorter than {rpe_distance} m: no RPE"));
        }
        if let Some(relations) = &self.relations {
            let far = relations.beyond_max_dt;
            let count = relations.all.count;
            warn(far > 0, format!("{far} of {count} relations are more than {max_dt} s from any pose: the nearest was used"));
        }
        warnings
    }

    /// The report as one JSON object; missing values are `null`.
    pub fn to_json(&self) -> Value {
        let distance = self.comparison.rpe_distance;
        let relations = self.relations.map(|r| {
            json!({
                "relations": r.all.count, "stamps_beyond_max_dt": r.beyond_max_dt,
                "trans_m": r.all.trans_m, "rot_deg": r.all.rot_deg, "short": r.short, "long": r.long,
            })
        });
        json!({
            "poses": self.poses,
            "matched": self.matched,
            "ate_rmse_m": self.ate.map(|ate| ate.errors.trans_m.rmse),
            "ate_rmse_deg": self.ate.map(|ate| ate.errors.rot_deg.rmse),
            (format!("rpe_{distance}m_rmse_m")): self.rpe.map(|rpe| rpe.trans_m.rmse),
            (format!("rpe_{distance}m_rmse_deg")): self.rpe.map(|rpe| rpe.rot_deg.rmse),
            "ate": self.ate.map(|ate| ate.errors),
            "rpe": self.rpe,
            "relations": relations,
            "warnings": self.warnings,
        })
    }

    fn rows(&self) -> Vec<(String, PoseErrors)> {
        let mut rows = Vec::new();
        let mut add = |name: String, errors: Option<PoseErrors>| rows.extend(errors.map(|errors| (name, errors)));
        add("ATE".into(), self.ate.map(|ate| ate.errors));
        add(format!("RPE per {} m", self.comparison.rpe_distance), self.rpe);
        add("relations".into(), self.relations.map(|r| r.all));
        add(format!("relations up to {SHORT_S} s"), self.relations.and_then(|r| r.short));
        add(format!("relations over {SHORT_S} s"), self.relations.and_then(|r| r.long));
        rows
    }
}

/// The table, then the warnings.
impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.to_text(None))
    }
}

impl Report {
    /// The text for a terminal with `width` columns; `None`: unlimited width.
    pub fn to_text(&self, width: Option<usize>) -> String {
        let mut rows = Vec::new();
        for (name, errors) in self.rows() {
            for (unit, s) in [("m", errors.trans_m), ("deg", errors.rot_deg)] {
                let figures = [s.rmse, s.mean, s.std, s.median, s.max].map(|figure| format!("{figure:.4}"));
                rows.push([name.clone(), unit.into(), errors.count.to_string()].into_iter().chain(figures).collect());
            }
        }
        let header = ["error", "unit", "n", "rmse", "mean", "std", "median", "max"];
        let table = TextTable::new(&header, rows.into_iter(), 2).render(width);
        let warnings = self.warnings.iter().map(|warning| format!("\nwarning: {warning}"));
        [table].into_iter().chain(warnings).collect()
    }
}
