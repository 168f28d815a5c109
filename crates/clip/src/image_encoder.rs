//! Image encoders: from the masked part of a picture to a unit embedding.

use crate::picture_model::{PictureModel, Role};
use image::RgbImage;
use std::path::Path;
use surgtpgs_core::{Error, Result, num, segment::BitMask};

pub(crate) const ROLE: Role = Role {
    what: "an image encoder",
    hint: "An image encoder takes float images [batch,3,224,224] and gives float embeddings [batch,dim].",
    settings_file: "encoder.toml",
    keys: "size, mean, std and output",
    outputs: &["image_embeds", "image_features", "embeddings", "embedding"],
    ranks: &[2],
    size: [224; 2],
    // Colours of OpenAI's CLIP.
    colours: [[0.481_454_66, 0.457_827_5, 0.408_210_73], [0.268_629_54, 0.261_302_6, 0.275_777_1]],
};
/// Number of pictures encoded at once, if the model takes any number.
const BATCH: usize = 16;

/// A loaded image encoder.
pub struct ImageEncoder {
    model: PictureModel,
    dim: usize,
}

impl ImageEncoder {
    /// Opens a folder with one model, `.onnx` or `.ort`, and an optional `encoder.toml`, and checks it
    /// with a trial run. The keys of `encoder.toml` are `size`, `mean`, `std` (of colours 0–1; CLIP's
    /// unless given) and `output`.
    pub fn open(folder: &Path) -> Result<Self> {
        let mut encoder = Self { model: PictureModel::open(folder, &ROLE)?, dim: 0 };
        encoder.dim = encoder.try_out()?;
        Ok(encoder)
    }

    /// Length of an embedding.
    pub fn dim(&self) -> usize {
        self.dim
    }

    /// SHA-256 over model and settings, hexadecimal.
    pub fn sha256(&self) -> &str {
        &self.model.sha256
    }

    /// Unit embeddings of the parts that the masks show: all else black, cut out, padded to a square,
    /// scaled to the model's size (method §8).
    pub fn embed(&mut self, image: &RgbImage, masks: &[&BitMask]) -> Result<Vec<Vec<f32>>> {
        let mut rows = Vec::with_capacity(masks.len());
        for masks in masks.chunks(self.model.batch.unwrap_or(BATCH)) {
            let pictures: Vec<Vec<f32>> = masks.iter().map(|mask| self.picture(image, mask)).collect();
            rows.extend(self.run(&pictures)?);
        }
        rows.iter().map(|row| unit(row)).collect()
    }

    /// The masked cut-out as the model reads it, [3, size, size].
    fn picture(&self, image: &RgbImage, mask: &BitMask) -> Vec<f32> {
        let ([size, _], bounds) = (self.model.size, mask.bounds());
        let longer = bounds.width.max(bounds.height);
        // Inside the square around the box, all pixels outside of the mask are black.
        let left = bounds.x as isize - ((longer - bounds.width) / 2) as isize;
        let top = bounds.y as isize - ((longer - bounds.height) / 2) as isize;
        let colour = |column: usize, row: usize| {
            let (x, y) = (left + column as isize, top + row as isize);
            match (usize::try_from(x), usize::try_from(y)) {
                (Ok(x), Ok(y)) if mask.has(x, y) => image.get_pixel(x as u32, y as u32).0.map(f32::from),
                _ => [0.0; 3],
            }
        };
        let position = |i: usize| {
            let at = (i as f32 + 0.5) * longer as f32 / size as f32 - 0.5;
            let at = at.clamp(0.0, (longer - 1) as f32);
            (at as usize, (at as usize + 1).min(longer - 1), at.fract())
        };
        let mut values = vec![0.0; 3 * size * size];
        for y in 0..size {
            let (above, below, down) = position(y);
            for x in 0..size {
                let (before, after, along) = position(x);
                let corners = [
                    colour(before, above),
                    colour(after, above),
                    colour(before, below),
                    colour(after, below),
                ];
                for c in 0..3 {
                    let upper = corners[0][c] + along * (corners[1][c] - corners[0][c]);
                    let lower = corners[2][c] + along * (corners[3][c] - corners[2][c]);
                    values[(c * size + y) * size + x] = self.model.scaled(upper + down * (lower - upper), c);
                }
            }
        }
        values
    }

    /// Runs the model; returns one row per picture.
    fn run(&mut self, pictures: &[Vec<f32>]) -> Result<Vec<Vec<f32>>> {
        let (axes, values) = self.model.run(pictures)?;
        let [_, dim] = axes[..] else {
            let what = format!("The image encoder gives maps of the shape {axes:?}");
            return Err(Error::input_at(&self.model.path, what, ROLE.hint));
        };
        Ok(values.chunks_exact(dim).take(pictures.len()).map(<[f32]>::to_vec).collect())
    }

    /// Encodes two pictures that have nothing in common, and returns the length of an embedding.
    fn try_out(&mut self) -> Result<usize> {
        let [size, _] = self.model.size;
        let flat = |colour: [f32; 3]| colour.iter().flat_map(|v| vec![*v; size * size]).collect::<Vec<_>>();
        let mut rows = Vec::new();
        for picture in [flat([1.5, -1.0, -1.0]), flat([-1.0, 0.5, 1.5])] {
            rows.push(unit(&self.run(&[picture])?.concat())?);
        }
        if num::dot(&rows[0], &rows[1]) > 0.999_999 {
            let what = "The image encoder gives a red and a blue picture the same embedding";
            return Err(Error::input_at(
                &self.model.path,
                what,
                "Check mean, std and output in encoder.toml.",
            ));
        }
        Ok(rows[0].len())
    }
}

fn unit(row: &[f32]) -> Result<Vec<f32>> {
    num::normalised(row).ok_or_else(|| {
        Error::input(
            "The image encoder returned an embedding of zeros or not-a-number",
            "The model file may be damaged, or its precision too low; try a float32 export.",
        )
    })
}
