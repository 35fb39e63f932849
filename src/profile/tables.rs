//! The look-up table and its comparison with contracts, as text and JSON.

use std::fmt::Write as _;

use serde_json::{Value, json};

use super::comparison::{Comparison, MethodResult};
use super::results::{Results, VariantCost};
use crate::text_table::TextTable;

/// Columns of the look-up table.
pub(super) const LOOK_UP_HEADER: [&str; 5] = ["variant", "a [us]", "b [us/iteration]", "c [ns/ray]", "R²"];
/// Columns of the comparison.
pub(super) const COMPARISON_HEADER: [&str; 10] = [
    "variant",
    "delta",
    "table: iterations",
    "late [%]",
    "p99 [us]",
    "error [mm]",
    "contract: iterations",
    "late [%]",
    "p99 [us]",
    "error [mm]",
];
/// Explains the look-up table.
pub(super) const LOOK_UP_DESCRIPTION: &str =
    "delay = a + b * iterations + c * rays (summed over the iterations), least-squares fit over all answers";
/// Explains the comparison.
pub(super) const COMPARISON_DESCRIPTION: &str = "delta: the time limit. table: max_iterations is set to the number of iterations that fit into \
    delta according to the look-up table. contract: the time budget is delta, and the matcher decides by its learned costs; the iterations \
    shown are those that fit at the contract's confidence. late: answers later than delta. error: mean position error";

/// Rows of the look-up table.
pub(super) fn look_up_rows(results: &Results) -> impl Iterator<Item = Vec<String>> {
    results.costs.iter().filter_map(|VariantCost { variant, look_up, .. }| {
        let table = (*look_up)?;
        let (b, c) = (table.per_iteration_us, 1e3 * table.per_ray_us);
        let numbers = [(table.setup_us, 1), (b, 2), (c, 2), (table.r_squared, 3)].map(|(x, digits)| format!("{x:.digits$}"));
        Some([variant.to_string()].into_iter().chain(numbers).collect())
    })
}

/// Rows of the comparison.
pub(super) fn comparison_rows(results: &Results) -> impl Iterator<Item = Vec<String>> {
    results.comparisons.iter().map(|Comparison { variant, delta, table, contract }| {
        let cells = |result: &MethodResult| {
            [
                result.iterations.to_string(),
                format!("{:.2}", 100.0 * result.late),
                format!("{:.1}", result.p99_us),
                format!("{:.2}", 1e3 * result.position_mean_m),
            ]
        };
        let by_table = table.as_ref().map_or_else(|| ["0", "-", "-", "-"].map(str::to_owned), cells);
        [variant.to_string(), format!("{delta:?}")].into_iter().chain(by_table).chain(cells(contract)).collect()
    })
}

impl Results {
    /// The look-up table and, if there is one, the comparison with contracts. `width`: width of the terminal in characters.
    pub fn to_text(&self, width: Option<usize>) -> String {
        let look_up = TextTable::new(&LOOK_UP_HEADER, look_up_rows(self), 1).render(width);
        let mut text = format!("{LOOK_UP_DESCRIPTION}:\n{look_up}");
        if !self.comparisons.is_empty() {
            let comparison = TextTable::new(&COMPARISON_HEADER, comparison_rows(self), 2).render(width);
            let _ = write!(text, "\n{COMPARISON_DESCRIPTION}:\n{comparison}");
        }
        text
    }

    /// The same as JSON: `look_up_tables` and `comparisons`.
    pub fn tables_to_json(&self) -> (Value, Value) {
        let look_up = |VariantCost { variant, look_up, .. }: &VariantCost| {
            let table = (*look_up)?;
            let (a, b, c) = (table.setup_us, table.per_iteration_us, table.per_ray_us);
            Some(json!({"variant": variant.to_string(), "a_us": a, "b_us": b, "c_us": c, "r_squared": table.r_squared}))
        };
        let result = |result: &MethodResult| {
            json!({
                "iterations": result.iterations,
                "late": result.late,
                "p99_delay_us": result.p99_us,
                "position_mean_m": result.position_mean_m,
            })
        };
        let comparison = |comparison: &Comparison| {
            json!({
                "variant": comparison.variant.to_string(),
                "delta_s": comparison.delta.as_secs_f64(),
                "by_table": comparison.table.as_ref().map(result),
                "by_contract": result(&comparison.contract),
            })
        };
        (self.costs.iter().filter_map(look_up).collect(), self.comparisons.iter().map(comparison).collect())
    }
}
