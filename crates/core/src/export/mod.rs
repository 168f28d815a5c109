//! Masked frames as files other programs read, each export with its `provenance.json`.
