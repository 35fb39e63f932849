//! Text tables for the terminal: a table that is too wide is rendered as a list.

use comfy_table::{CellAlignment, Table, presets};

/// A table with a header.
pub(crate) struct TextTable {
    header: Vec<&'static str>,
    rows: Vec<Vec<String>>,
    /// Columns from this index on are right-aligned.
    first_right_aligned: usize,
}

impl TextTable {
    /// Creates a table; all rows must have the length of the header.
    pub(crate) fn new(header: &[&'static str], rows: impl Iterator<Item = Vec<String>>, first_right_aligned: usize) -> Self {
        Self { header: header.to_vec(), rows: rows.collect(), first_right_aligned }
    }

    /// Renders the table, or, if that is wider than `width` characters, a list of the rows with one line per cell. `None`: no
    /// limit.
    pub(crate) fn render(&self, width: Option<usize>) -> String {
        let table = self.table();
        let is_too_wide = |width| table.lines().any(|line| line.chars().count() > width);
        if width.is_some_and(is_too_wide) { self.list() } else { table }
    }

    fn table(&self) -> String {
        let mut table = Table::new();
        table.load_style(presets::UTF8_BORDERS_ONLY).set_header(self.header.clone()).add_rows(self.rows.clone());
        for column in table.column_iter_mut().skip(self.first_right_aligned) {
            column.set_cell_alignment(CellAlignment::Right);
        }
        table.to_string()
    }

    fn list(&self) -> String {
        let longest_name = self.header.iter().map(|name| name.chars().count()).max().unwrap_or(0);
        let cell = |(name, cell): (&&str, &String)| format!("  {name:longest_name$}  {cell}");
        let row = |row: &Vec<String>| {
            let title = format!("{}: {}", self.header.first().unwrap_or(&""), row.first().map_or("", String::as_str));
            let cells = self.header.iter().zip(row).skip(1).map(cell);
            [title].into_iter().chain(cells).collect::<Vec<_>>().join("\n")
        };
        self.rows.iter().map(row).collect::<Vec<_>>().join("\n")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_that_is_too_wide_becomes_a_list() {
        let row = vec!["/scan".to_owned(), "sensor_msgs/LaserScan".into(), "400".into()];
        let table = TextTable::new(&["topic", "type", "messages"], [row].into_iter(), 2);
        assert_eq!(table.render(None), table.render(Some(80)));
        assert!(table.render(None).contains("│"));
        assert_eq!(table.render(Some(30)), "topic: /scan\n  type      sensor_msgs/LaserScan\n  messages  400");
    }
}
