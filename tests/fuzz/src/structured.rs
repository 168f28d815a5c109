//! Files that are whole except for the parts that the bytes choose. Random changes to a file hardly ever make
//! such damage, since checksums, lengths and deflated parts must fit it.

use crate::{
    Target,
    recordings::{SIZE, png, replaced},
    scenes,
};
use flate2::{Compression, Crc, write::ZlibEncoder};
use image::{GrayImage, Luma};
use safetensors::{Dtype, SafeTensors, tensor::TensorView};
use std::{io::Write, sync::OnceLock};

pub(crate) const TARGETS: [Target; 3] = [
    Target { name: "npy_header", run: npy_header, seeds },
    Target { name: "png_chunks", run: png_chunks, seeds },
    Target { name: "quantised_scene", run: quantised_scene, seeds },
];

/// Sizes that readers get wrong.
const SIZES: [u64; 12] = [0, 1, 2, 6, 8, 17, 255, 65_536, 1 << 30, 1_000_000_000, u32::MAX as u64, u64::MAX];

/// Decisions taken from bytes one after the other; where no bytes are left, the first choice of all.
struct Choices<'a>(&'a [u8]);

impl Choices<'_> {
    fn below(&mut self, n: usize) -> usize {
        let Some((first, rest)) = self.0.split_first() else { return 0 };
        self.0 = rest;
        usize::from(*first) % n
    }

    fn one_of<T: Copy>(&mut self, all: &[T]) -> T {
        all[self.below(all.len())]
    }
}

fn seeds() -> Vec<Vec<u8>> {
    let spread = |step: usize| (0..48).map(|i| (i * step % 251) as u8).collect();
    vec![Vec::new(), vec![0; 32], spread(1), spread(7), spread(97)]
}

/// Reads an array as depth or as poses, with any shape, type and nesting in its header.
fn npy_header(bytes: &[u8]) {
    let mut choices = Choices(bytes);
    let file = choices.one_of(&["depth/0.npy", "poses_bounds.npy"]);
    let descr = choices.one_of(&[
        "'<f4'",
        "'<f8'",
        "'|u1'",
        "'>i2'",
        "'<f2'",
        "'<c8'",
        "'|O'",
        "'",
        "[('a', '<f4')]",
        "None",
    ]);
    let nesting = choices.one_of(&[0, 0, 0, 1, 30, 20_000]);
    let axes: Vec<String> = (0..choices.below(5)).map(|_| choices.one_of(&SIZES).to_string()).collect();
    let shape = choices.one_of(&["(6, 8)", "(2, 17)", "(1, 6, 8)", "()", "("]);
    let shape = if axes.is_empty() { shape.to_owned() } else { format!("({},)", axes.join(", ")) };
    let order = choices.one_of(&["False", "True", "0"]);
    let text = format!(
        "{{'descr': {}{descr}{}, 'fortran_order': {order}, 'shape': {shape}}}\n",
        "[".repeat(nesting),
        "]".repeat(nesting)
    );
    let data = choices.one_of(&[6 * 8 * 4, 2 * 17 * 8, 0, 1, 6 * 8]);
    let length = (text.len() as u16).to_le_bytes();
    replaced(file, &[b"\x93NUMPY\x01\x00", &length[..], text.as_bytes(), &vec![1; data]].concat());
}

/// Reads a PNG as frame, mask, labels or depth, with any sizes and with chunks of any kind before its pixels;
/// the checksums are right.
fn png_chunks(bytes: &[u8]) {
    let mut choices = Choices(bytes);
    let file = choices.one_of(&["images/0.png", "masks/0.png", "labels/0.png", "depth/0.png"]);
    let whole = png(GrayImage::from_pixel(SIZE.0, SIZE.1, Luma([1])));
    // 8 bytes of signature, then IHDR: length, kind, 13 bytes, checksum.
    let mut header = whole[16..29].to_vec();
    if choices.below(2) == 1 {
        let (width, height) = (choices.one_of(&SIZES) as u32, choices.one_of(&SIZES) as u32);
        header[..4].copy_from_slice(&width.to_be_bytes());
        header[4..8].copy_from_slice(&height.to_be_bytes());
    }
    header[8] = choices.one_of(&[8, 8, 1, 2, 4, 16, 3]);
    header[9] = choices.one_of(&[0, 0, 2, 3, 4, 6, 5]);
    header[12] = choices.one_of(&[0, 0, 0, 1, 2]);
    let mut file_bytes = whole[..8].to_vec();
    chunk(&mut file_bytes, b"IHDR", &header);
    for _ in 0..choices.below(4) {
        let kind = choices.one_of(&[
            b"iCCP", b"zTXt", b"iTXt", b"tEXt", b"eXIf", b"PLTE", b"tRNS", b"acTL", b"sBIT", b"abCd",
        ]);
        let start = choices.one_of(&[
            &b"a\0\0"[..],
            b"a\0\x01\0\0\0",
            b"",
            b"II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0\x06\0\0\0",
        ]);
        let content = if choices.below(2) == 1 {
            vec![0; choices.one_of(&[0, 3, 768, 1 << 16])]
        } else {
            deflated_zeros(&mut choices).to_vec()
        };
        chunk(&mut file_bytes, kind, &[start, &content].concat());
    }
    file_bytes.extend(&whole[33..]);
    replaced(file, &file_bytes);
}

fn chunk(file: &mut Vec<u8>, kind: &[u8; 4], content: &[u8]) {
    file.extend((content.len() as u32).to_be_bytes());
    let start = file.len();
    file.extend(kind);
    file.extend(content);
    let mut sum = Crc::new();
    sum.update(&file[start..]);
    file.extend(sum.sum().to_be_bytes());
}

/// Lengths of the zeros that are deflated.
const ZEROS: [usize; 7] = [60, 12, 0, 768, 1 << 16, 4 << 20, 64 << 20];

/// Returns deflated zeros, as many as are chosen.
fn deflated_zeros(choices: &mut Choices<'_>) -> &'static [u8] {
    static ALL: OnceLock<[Vec<u8>; ZEROS.len()]> = OnceLock::new();
    let all = ALL.get_or_init(|| ZEROS.map(|len| deflated(&vec![0; len])));
    &all[choices.below(ZEROS.len())]
}

fn deflated(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = ZlibEncoder::new(Vec::new(), Compression::fast());
    let written = encoder.write_all(bytes).and_then(|()| encoder.finish());
    assert!(written.is_ok(), "writing to memory does not fail");
    written.unwrap_or_default()
}

/// Reads a quantised scene, with any shapes, and deflated parts of any length, in up to three of its tensors.
fn quantised_scene(bytes: &[u8]) {
    let mut choices = Choices(bytes);
    let whole = scenes::quantised();
    let (Ok((_, metadata)), Ok(file)) = (SafeTensors::read_metadata(whole), SafeTensors::deserialize(whole))
    else {
        panic!("the scene to be broken cannot be read")
    };
    let mut tensors: Vec<(String, Dtype, Vec<usize>, Vec<u8>)> = file
        .iter()
        .map(|(name, view)| (name.to_owned(), view.dtype(), view.shape().to_vec(), view.data().to_vec()))
        .collect();
    tensors.sort_by(|a, b| a.0.cmp(&b.0));
    let names: Vec<String> =
        tensors.iter().filter_map(|t| t.0.strip_suffix(".shape").map(str::to_owned)).collect();
    for _ in 0..choices.below(4) {
        let name = names[choices.below(names.len())].as_str();
        let zeros = deflated_zeros(&mut choices);
        let (at, size) = (choices.below(3), choices.one_of(&SIZES) as u32);
        for (found, _, shape, data) in &mut tensors {
            if found == name && choices.below(2) == 1 {
                *data = zeros.to_vec();
                *shape = vec![data.len()];
            } else if found.strip_suffix(".shape") == Some(name) {
                let places = data.len() / 4;
                let at = 4 * at.min(places.saturating_sub(1));
                data[at..at + 4].copy_from_slice(&size.to_le_bytes());
            }
        }
    }
    let views = tensors.iter().filter_map(|(name, dtype, shape, data)| {
        TensorView::new(*dtype, shape.clone(), data).ok().map(|view| (name.as_str(), view))
    });
    let broken = safetensors::serialize(views, metadata.metadata().clone());
    assert!(broken.is_ok(), "the broken scene cannot be written");
    scenes::load("scene.safetensors", &broken.unwrap_or_default());
}
