//! The `surgtpgs` program.
fn main() {}
