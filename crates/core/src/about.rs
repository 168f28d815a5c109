//! Words of the program about itself.

/// Returns the text about the program's intended use and its limits; the only copy is in `assets/text`.
pub fn intended_use() -> &'static str {
    include_str!("../../../assets/text/research_use.txt").trim()
}
