//! Places of labelled pictures that no name covers, as a class of their own. Without one, what lies beside a
//! structure looks like nothing else than this structure.

use super::{NO_REGION, RegionMap};
use crate::{
    grid::Mask,
    mask::Bits,
    sequence::{Class, NO_LABEL},
};

/// Name of what no other name covers.
pub const BACKGROUND: &str = "background";
/// Least share of the labelled pictures without a name for which there is a background: completely
/// labelled pictures have gaps, too.
const LEAST_SHARE: f64 = 0.05;
/// Number of columns of a picture for each pixel of half the width of a gap: narrower places between names
/// are not known.
const COLUMNS_PER_GAP_PX: usize = 160;

/// Returns `true` for the name of a background: "black background", for example.
pub fn is_background(name: &str) -> bool {
    name.split([' ', '-', '_']).any(|word| word == BACKGROUND)
}

/// Returns the class of the background.
pub(super) fn background_class() -> Class {
    Class { id: NO_LABEL, name: BACKGROUND.to_owned(), colour: [0; 3] }
}

/// Returns `true` if `unnamed` pixels beside `named` ones are more than gaps.
pub(super) fn is_more_than_gaps(unnamed: u64, named: u64) -> bool {
    unnamed as f64 >= LEAST_SHARE * (unnamed + named) as f64
}

/// Gives kept pixels without a name to the background, whose row is `row`, but for narrow gaps. A map without
/// any name stays as it is: nobody labelled it.
pub(super) fn fill_background(map: &mut RegionMap, keep: &Mask, row: u16) {
    if map.data.iter().all(|region| *region == NO_REGION) {
        return;
    }
    let mut unnamed = Bits::of_mask(&map.map(|region| *region == NO_REGION));
    let steps = (map.width / COLUMNS_PER_GAP_PX).max(1);
    for _ in 0..steps {
        unnamed = unnamed.eroded();
    }
    for _ in 0..steps {
        unnamed = unnamed.dilated();
    }
    let wide = unnamed.to_mask();
    for ((region, is_wide), is_kept) in map.data.iter_mut().zip(&wide.data).zip(&keep.data) {
        if *is_wide && *is_kept {
            *region = row;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wide_places_without_a_name_are_background_and_gaps_are_not() {
        // A name on the left and one on the right, with a gap, and nothing below. Some of it is not kept.
        let region = |i: usize| match (i % 20, i / 20) {
            (x, y) if y >= 8 || (x == 10 && y < 7) => NO_REGION,
            (0..10, _) => 0,
            _ => 1,
        };
        let mut map = RegionMap::from_vec(20, 16, (0..320).map(region).collect());
        let before = map.clone();
        let keep = Mask::from_vec(20, 16, (0..320).map(|i| i < 300).collect());
        fill_background(&mut map, &keep, 2);
        for (i, (region, before)) in map.data.iter().zip(&before.data).enumerate() {
            let is_background = (160..300).contains(&i);
            assert_eq!(*region, if is_background { 2 } else { *before }, "{i}");
        }
        let mut nothing = RegionMap::filled(20, 16, NO_REGION);
        fill_background(&mut nothing, &keep, 2);
        assert!(nothing.data.iter().all(|region| *region == NO_REGION));
        assert!(is_background("black background") && is_background("background-tissue"));
        assert!(!is_background("abdominal wall") && is_background(BACKGROUND));
        assert!(is_more_than_gaps(10, 100) && !is_more_than_gaps(1, 100));
    }
}
