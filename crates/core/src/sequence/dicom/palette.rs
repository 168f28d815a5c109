//! Colours of pictures that store places in a palette (PS3.3, C.7.6.3.1.5 and C.7.6.3.1.6).

use crate::dicom::{
    Set,
    tag::{self, Tag},
};

/// A palette.
#[derive(Debug)]
pub(super) struct Palette {
    /// Value that stands for the first colour; smaller ones do too.
    first: u16,
    colours: Vec<[u8; 3]>,
}

impl Palette {
    /// Reads the palette of a file. The error says what is wrong.
    pub(super) fn of(set: &Set) -> Result<Self, String> {
        let red = channel(set, tag::RED_DESCRIPTOR, tag::RED_TABLE)?;
        let green = channel(set, tag::GREEN_DESCRIPTOR, tag::GREEN_TABLE)?;
        let blue = channel(set, tag::BLUE_DESCRIPTOR, tag::BLUE_TABLE)?;
        let first = set.shorts(tag::RED_DESCRIPTOR).get(1).copied().unwrap_or(0);
        let colours = red.into_iter().zip(green).zip(blue).map(|((r, g), b)| [r, g, b]).collect();
        Ok(Self { first, colours })
    }

    pub(super) fn colour(&self, value: u16) -> [u8; 3] {
        let place = usize::from(value.saturating_sub(self.first)).min(self.colours.len() - 1);
        self.colours[place]
    }
}

/// Returns the 8-bit values of one channel, at least one.
fn channel(set: &Set, descriptor: Tag, table: Tag) -> Result<Vec<u8>, String> {
    let wrong = || "its palette is damaged".to_owned();
    let [entries, _, bits] = set.shorts(descriptor).try_into().map_err(|_| wrong())?;
    let entries = if entries == 0 { 1 << 16 } else { usize::from(entries) };
    let bytes = set.bytes(table).ok_or_else(wrong)?;
    // Entries of 8 bits may be packed, or take 16 bits each.
    let values: Vec<u8> = if bytes.len() < 2 * entries {
        bytes.iter().copied().take(entries).collect()
    } else {
        let value = |pair: &[u8; 2]| if bits > 8 { pair[1] } else { pair[0] };
        bytes.as_chunks::<2>().0.iter().map(value).take(entries).collect()
    };
    if values.len() < entries { Err(wrong()) } else { Ok(values) }
}
