//! Image encoders: from what a mask shows to a unit embedding.

use crate::{
    model_file::{ModelFile, described, hex, shape},
    runtime::short,
    text_encoder::read_settings,
};
use image::RgbImage;
use ort::{
    session::{Session, SessionInputValue},
    value::{Outlet, Tensor, TensorElementType},
};
use sha2::{Digest, Sha256};
use std::path::Path;
use surgtpgs_core::{Error, Result, num, segment::BitMask};

/// Names under which exporters give the embedding, in order of preference.
const EMBEDDING_OUTPUTS: [&str; 4] = ["image_embeds", "image_features", "embeddings", "embedding"];
const HINT: &str =
    "An image encoder takes float images [batch,3,224,224] and gives float embeddings [batch,dim].";
/// Pictures encoded at once where the model takes any number.
const BATCH: usize = 16;

/// The contents of an image encoder's `encoder.toml`; everything is optional.
#[derive(Clone, Debug, PartialEq, serde::Deserialize)]
#[serde(deny_unknown_fields, default)]
struct ImageSettings {
    /// Pixels along each side of what the model reads, where the file leaves it open.
    size: usize,
    /// Mean and standard deviation of the colours it was trained on, 0–1.
    mean: [f32; 3],
    std: [f32; 3],
    /// The output that is the embedding, where there are several.
    output: Option<String>,
}

impl Default for ImageSettings {
    /// OpenAI's CLIP.
    fn default() -> Self {
        Self {
            size: 224,
            mean: [0.481_454_66, 0.457_827_5, 0.408_210_73],
            std: [0.268_629_54, 0.261_302_6, 0.275_777_1],
            output: None,
        }
    }
}

impl ImageSettings {
    fn parse(text: &str, path: &Path) -> Result<Self> {
        let hint = "Its keys are size, mean, std and output.";
        let settings: Self = toml::from_str(text).map_err(|e| {
            let cause = e.to_string().split_whitespace().collect::<Vec<_>>().join(" ");
            Error::input_at(
                path,
                format!("encoder.toml could not be read: {}", cause.trim_end_matches('.')),
                hint,
            )
        })?;
        let is_number = |v: &f32| v.is_finite();
        let spread = settings.std.iter().all(|v| is_number(v) && *v > 0.0);
        if settings.size == 0 || settings.size > 4096 || !spread || !settings.mean.iter().all(is_number) {
            let what =
                "encoder.toml has a size outside 1 to 4096, or a mean or std that is not a usable number";
            return Err(Error::input_at(path, what, hint));
        }
        Ok(settings)
    }
}

/// A loaded image encoder.
pub struct ImageEncoder {
    session: Session,
    settings: ImageSettings,
    input: String,
    output: String,
    /// Pictures at once: what the model takes, or [`BATCH`].
    batch: usize,
    has_fixed_batch: bool,
    dim: usize,
    sha256: String,
}

impl ImageEncoder {
    /// A folder with one model, `.onnx` or `.ort`, and optionally `encoder.toml` with `size`, `mean`, `std` (of colours
    /// 0–1; CLIP's unless given) and `output`. Everything is checked here, with a trial run.
    pub fn open(folder: &Path) -> Result<Self> {
        let hint = "A folder for an image encoder holds model.onnx.";
        let files = ModelFile::list(folder, "an image encoder", hint)?;
        let [file] = files.as_slice() else {
            let what = format!("The folder holds {} model files, an image encoder is one", files.len());
            return Err(Error::input_at(folder, what, hint));
        };
        let settings_path = folder.join("encoder.toml");
        let text = read_settings(&settings_path)?.unwrap_or_default();
        let mut settings = ImageSettings::parse(&text, &settings_path)?;
        let model = ModelFile::open(file)?;
        let (input, batch) = check_input(&model, &mut settings)?;
        let output = choose_output(&model, &settings)?;
        let mut hash = Sha256::new();
        hash.update(&model.sha256);
        hash.update(&text);
        let mut encoder = Self {
            session: model.session,
            settings,
            input,
            output,
            batch: batch.unwrap_or(BATCH),
            has_fixed_batch: batch.is_some(),
            dim: 0,
            sha256: hex(hash),
        };
        encoder.dim = encoder.try_out(&model.path)?;
        Ok(encoder)
    }

    /// Length of an embedding.
    pub fn dim(&self) -> usize {
        self.dim
    }

    /// SHA-256 over model and settings, hexadecimal.
    pub fn sha256(&self) -> &str {
        &self.sha256
    }

    /// Unit embeddings of what each mask shows: all else black, cut out, padded to a square, brought to the model's size
    /// (method §8).
    pub fn embed(&mut self, image: &RgbImage, masks: &[&BitMask]) -> Result<Vec<Vec<f32>>> {
        let mut rows = Vec::with_capacity(masks.len());
        for masks in masks.chunks(self.batch) {
            let pictures: Vec<Vec<f32>> = masks.iter().map(|mask| self.picture(image, mask)).collect();
            rows.extend(self.run(&pictures)?);
        }
        rows.iter().map(|row| unit(row)).collect()
    }

    /// The masked cut-out as the model reads it, [3, size, size].
    fn picture(&self, image: &RgbImage, mask: &BitMask) -> Vec<f32> {
        let (size, bounds) = (self.settings.size, mask.bounds());
        let longer = bounds.width.max(bounds.height);
        // Of the square around the box, what is not a pixel of the mask is black.
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
                    let value = (upper + down * (lower - upper)) / 255.0;
                    values[(c * size + y) * size + x] =
                        (value - self.settings.mean[c]) / self.settings.std[c];
                }
            }
        }
        values
    }

    /// One row per picture.
    fn run(&mut self, pictures: &[Vec<f32>]) -> Result<Vec<Vec<f32>>> {
        let failed = |cause: String| {
            Error::input(format!("The image encoder failed ({})", short(&cause)), "The model may be damaged.")
        };
        let size = self.settings.size;
        let num = if self.has_fixed_batch { self.batch } else { pictures.len() };
        let mut values = pictures.concat();
        values.resize(num * 3 * size * size, 0.0);
        let tensor = Tensor::from_array(([num, 3, size, size], values)).map_err(|e| failed(e.to_string()))?;
        let inputs = vec![(self.input.clone(), SessionInputValue::from(tensor))];
        let outputs = self.session.run(inputs).map_err(|e| failed(e.to_string()))?;
        let output = outputs.get(&self.output).ok_or_else(|| failed("the output is missing".into()))?;
        let (shape, values) = output.try_extract_tensor::<f32>().map_err(|e| failed(e.to_string()))?;
        match shape[..] {
            [n, dim] if n == num as i64 && dim > 0 => {
                Ok(values.chunks_exact(dim as usize).take(pictures.len()).map(<[f32]>::to_vec).collect())
            }
            _ => Err(failed(format!("output `{}` has the shape {shape:?} for {num} pictures", self.output))),
        }
    }

    /// Encodes two pictures that have nothing in common; gives the length of an embedding.
    fn try_out(&mut self, path: &Path) -> Result<usize> {
        let size = self.settings.size;
        let flat = |colour: [f32; 3]| colour.iter().flat_map(|v| vec![*v; size * size]).collect::<Vec<_>>();
        let mut rows = Vec::new();
        for picture in [flat([1.5, -1.0, -1.0]), flat([-1.0, 0.5, 1.5])] {
            rows.push(unit(&self.run(&[picture])?.concat())?);
        }
        if num::dot(&rows[0], &rows[1]) > 0.999_999 {
            let what = "The image encoder gives a red and a blue picture the same embedding";
            return Err(Error::input_at(path, what, "Check mean, std and output in encoder.toml."));
        }
        Ok(rows[0].len())
    }
}

/// The name of the input and the number of pictures it takes at once, where that is fixed; the size goes into `settings`.
fn check_input(model: &ModelFile, settings: &mut ImageSettings) -> Result<(String, Option<usize>)> {
    let inputs = model.session.inputs();
    let wrong = |hint: &str| {
        let what =
            format!("The model wants {}; an image encoder takes one batch of images", described(inputs));
        Err(Error::input_at(&model.path, what, hint))
    };
    let is_text = |input: &Outlet| {
        matches!(input.dtype().tensor_type(), Some(TensorElementType::Int64 | TensorElementType::Int32))
    };
    let [input] = inputs else {
        let mixed = inputs.iter().any(is_text) && inputs.iter().any(|i| shape(i).len() == 4);
        return wrong(match (mixed, inputs.iter().any(is_text)) {
            (true, _) => "Export the image half alone.",
            (false, true) => "You may have picked the text encoder.",
            _ => HINT,
        });
    };
    if is_text(input) {
        return wrong("You may have picked the text encoder.");
    }
    let [batch, 3 | -1, height, width] = shape(input)[..] else { return wrong(HINT) };
    if input.dtype().tensor_type() != Some(TensorElementType::Float32)
        || (height > 0 && width > 0 && height != width)
    {
        return wrong(HINT);
    }
    if let Ok(side @ 1..) = usize::try_from(height.max(width)) {
        settings.size = side;
    }
    Ok((input.name().to_owned(), usize::try_from(batch).ok().filter(|n| *n > 0)))
}

fn choose_output(model: &ModelFile, settings: &ImageSettings) -> Result<String> {
    let outputs = model.session.outputs();
    let wrong = |what: String, hint: &str| Err(Error::input_at(&model.path, what, hint));
    if let Some(name) = &settings.output {
        return match outputs.iter().any(|o| o.name() == name) {
            true => Ok(name.clone()),
            false => {
                let what = format!(
                    "encoder.toml asks for the output `{name}`; the model has {}",
                    described(outputs)
                );
                wrong(what, "Correct output in encoder.toml.")
            }
        };
    }
    let fits = |o: &&Outlet| {
        o.dtype().tensor_type() == Some(TensorElementType::Float32) && matches!(shape(o).len(), 0 | 2)
    };
    let named = EMBEDDING_OUTPUTS.iter().find_map(|name| outputs.iter().find(|o| o.name() == *name));
    match named.filter(fits).or_else(|| outputs.iter().find(fits)) {
        Some(output) => Ok(output.name().to_owned()),
        None => wrong(format!("The model gives {}", described(outputs)), HINT),
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
