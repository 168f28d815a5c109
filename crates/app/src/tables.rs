//! Tables as CSV.

use serde::Serialize;
use surgtpgs_core::{Error, Result};

/// Writes one line per row, under the names of its fields.
pub(crate) fn csv<T: Serialize>(rows: &[T]) -> Result<Vec<u8>> {
    written(csv::Writer::from_writer(Vec::new()), rows)
}

/// Writes one line per row under the names of columns, for rows that hold lists or have other names.
pub(crate) fn csv_under<T: Serialize>(columns: &[impl AsRef<[u8]>], rows: &[T]) -> Result<Vec<u8>> {
    let mut writer = csv::WriterBuilder::new().has_headers(false).from_writer(Vec::new());
    writer.write_record(columns).map_err(failed)?;
    written(writer, rows)
}

fn written<T: Serialize>(mut writer: csv::Writer<Vec<u8>>, rows: &[T]) -> Result<Vec<u8>> {
    rows.iter().try_for_each(|row| writer.serialize(row)).map_err(failed)?;
    writer.into_inner().map_err(failed)
}

fn failed(reason: impl std::fmt::Display) -> Error {
    Error::input(format!("the table could not be written: {reason}"), "")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_are_quoted_and_lists_are_spread_over_columns() {
        let rows = [("all, and \"more\"", vec![1.5, 2e-7], None::<f64>)];
        let bytes = csv_under(&["way", "a_ms", "b_ms", "error"], &rows).unwrap();
        let text = String::from_utf8(bytes).unwrap();
        assert_eq!(text, "way,a_ms,b_ms,error\n\"all, and \"\"more\"\"\",1.5,2e-7,\n");
    }
}
