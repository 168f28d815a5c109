//! Tables as CSV.

use surgtpgs_core::{Error, Result};

/// Writes one line per row, under the names of its fields.
pub(crate) fn csv<T: serde::Serialize>(rows: &[T]) -> Result<Vec<u8>> {
    let fail = |e: &dyn std::fmt::Display| Error::input(format!("the table could not be written: {e}"), "");
    let mut writer = csv::Writer::from_writer(Vec::new());
    rows.iter().try_for_each(|row| writer.serialize(row)).map_err(|e| fail(&e))?;
    writer.into_inner().map_err(|e| fail(&e))
}
