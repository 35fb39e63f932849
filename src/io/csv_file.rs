//! CSV files of which each column is declared once, name and value together.

use std::io::{self, Write};

/// Name of a column, and its text in the row of a record.
pub type Column<R> = (&'static str, fn(&R) -> String);

/// Writes records as CSV; every row is complete in the file before the next one is made.
pub struct CsvFile<W: Write, R: 'static> {
    writer: csv::Writer<W>,
    columns: &'static [Column<R>],
}

impl<W: Write, R> CsvFile<W, R> {
    /// Writes the names of the columns.
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

    /// The sink, with all that was written.
    pub fn into_sink(self) -> io::Result<W> {
        self.writer.into_inner().map_err(csv::IntoInnerError::into_error)
    }
}

/// A span of a message in microseconds.
pub fn microseconds(span: crate::messages::Duration) -> String {
    format!("{:.3}", span.seconds() * 1e6)
}
