//! CSV files whose columns are each declared once, name and value together.

use std::io::{self, Write};

/// Name of a column, and the function that formats its value for a record.
pub type Column<R> = (&'static str, fn(&R) -> String);

/// Writes records as CSV. Each row is flushed at once, so that the file only ever has complete rows.
pub struct CsvFile<W: Write, R: 'static> {
    writer: csv::Writer<W>,
    columns: &'static [Column<R>],
}

impl<W: Write, R> CsvFile<W, R> {
    /// Begins a file and writes its header line.
    pub fn new(sink: W, columns: &'static [Column<R>]) -> csv::Result<Self> {
        let mut file = Self { writer: csv::Writer::from_writer(sink), columns };
        file.writer.write_record(columns.iter().map(|(name, _)| name))?;
        file.writer.flush()?;
        Ok(file)
    }

    /// Writes the row of a record.
    pub fn write(&mut self, record: &R) -> csv::Result<()> {
        self.writer.write_record(self.columns.iter().map(|(_, text)| text(record)))?;
        Ok(self.writer.flush()?)
    }

    /// Returns the sink after all rows were written to it.
    pub fn into_sink(self) -> io::Result<W> {
        self.writer.into_inner().map_err(csv::IntoInnerError::into_error)
    }
}

/// Formats a duration in microseconds.
pub fn microseconds(span: crate::messages::Duration) -> String {
    format!("{:.3}", span.seconds() * 1e6)
}
