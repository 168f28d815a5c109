//! The common part of all models that read one picture: settings, checks of inputs and outputs, and a run.

use crate::{
    model_file::{ModelFile, described, hex},
    network::Network,
    settings::read_settings,
    tensor::{Element, Input, NOT_FINITE, Outlet, floats},
};
use image::{RgbImage, imageops};
use sha2::{Digest, Sha256};
use std::path::{Path, PathBuf};
use surgtpgs_core::{Error, Result, sequence::DepthKind};

/// A kind of model that reads one picture.
pub(crate) struct Role {
    /// Name of the kind, with its article.
    pub what: &'static str,
    /// One sentence about its inputs and outputs.
    pub hint: &'static str,
    /// Name of its settings file, which lies beside the model, and the keys in it.
    pub settings_file: &'static str,
    pub keys: &'static str,
    /// Names that exporters give to its output, in order of preference, and the numbers of axes it may have.
    pub outputs: &'static [&'static str],
    pub ranks: &'static [usize],
    /// Rows and columns, if neither the model file nor the settings say.
    pub size: [usize; 2],
    /// Mean and standard deviation of colours 0–1, unless the settings say otherwise.
    pub colours: [[f32; 3]; 2],
}

/// Settings of a model that reads one picture; everything is optional.
#[derive(Clone, Debug, Default, PartialEq, serde::Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct PictureSettings {
    /// Size of the model's input, if the model file leaves it open: pixels along each side, or rows and
    /// columns.
    size: Option<Size>,
    /// Mean and standard deviation of the colours it was trained on, 0–1.
    mean: Option<[f32; 3]>,
    std: Option<[f32; 3]>,
    /// Name of the output that is read, if there are several.
    output: Option<String>,
    /// Meaning of a depth network's values.
    pub kind: Option<DepthKind>,
    /// Nearest and farthest depth of a network whose values are 0–1.
    pub range: Option<[f32; 2]>,
}

#[derive(Clone, Copy, Debug, PartialEq, serde::Deserialize)]
#[serde(untagged)]
enum Size {
    Side(usize),
    RowsColumns([usize; 2]),
}

impl PictureSettings {
    fn parse(text: &str, role: &Role, path: &Path) -> Result<Self> {
        let file = role.settings_file;
        let wrong = |what: String| Error::input_at(path, what, format!("Its keys are {}.", role.keys));
        let settings: Self = toml::from_str(text).map_err(|e| {
            let cause = e.to_string().split_whitespace().collect::<Vec<_>>().join(" ");
            wrong(format!("{file} could not be read: {}", cause.trim_end_matches('.')))
        })?;
        let numbers = settings.mean.iter().chain(&settings.std).flatten();
        let spread = settings.std.iter().flatten().all(|v| *v > 0.0);
        let range = settings.range.is_none_or(|[near, far]| near > 0.0 && far > near && far.is_finite());
        let sides = settings.size.map_or([1; 2], Size::rows_columns);
        if !sides.iter().all(|n| (1..=4096).contains(n)) || !spread || !numbers.clone().all(|v| v.is_finite())
        {
            let what = "has a size outside 1 to 4096, or a mean or std that is not a usable number";
            return Err(wrong(format!("{file} {what}")));
        }
        if !range {
            return Err(wrong(format!(
                "{file} has a range that is not [nearest, farthest] with 0 < nearest"
            )));
        }
        Ok(settings)
    }
}

impl Size {
    fn rows_columns(self) -> [usize; 2] {
        match self {
            Self::Side(side) => [side; 2],
            Self::RowsColumns(both) => both,
        }
    }
}

/// A loaded model whose only input is a picture.
pub(crate) struct PictureModel {
    network: Network,
    input: String,
    output: String,
    what: &'static str,
    pub settings: PictureSettings,
    pub path: PathBuf,
    /// Rows and columns.
    pub size: [usize; 2],
    /// Number of pictures at once, if it is fixed.
    pub batch: Option<usize>,
    colours: [[f32; 3]; 2],
    /// SHA-256 over model and settings, hexadecimal.
    pub sha256: String,
}

impl PictureModel {
    /// Opens a model file, `.onnx` or `.ort`, or a folder with one and an optional settings file.
    pub(crate) fn open(path: &Path, role: &Role) -> Result<Self> {
        let file = match path.is_file() {
            true => path.to_owned(),
            false => the_model(path, role)?,
        };
        let settings_path = file.with_file_name(role.settings_file);
        let text = read_settings(&settings_path)?.unwrap_or_default();
        let settings = PictureSettings::parse(&text, role, &settings_path)?;
        let model = ModelFile::open(&file)?;
        let (input, batch, size) = check_input(&model, &settings, role)?;
        let output = choose_output(&model, &settings, role)?;
        let mut hash = Sha256::new();
        hash.update(&model.sha256);
        hash.update(&text);
        let colours = [settings.mean.unwrap_or(role.colours[0]), settings.std.unwrap_or(role.colours[1])];
        let (network, path, what) = (model.network, model.path, role.what);
        Ok(Self { network, input, output, what, settings, path, size, batch, colours, sha256: hex(hash) })
    }

    /// Name of the output that is read.
    pub(crate) fn output(&self) -> &str {
        &self.output
    }

    /// A channel's colour value 0–255, normalised for the model.
    pub(crate) fn scaled(&self, value: f32, channel: usize) -> f32 {
        (value / 255.0 - self.colours[0][channel]) / self.colours[1][channel]
    }

    /// A whole picture in the form that the model reads, [3, rows, columns].
    pub(crate) fn whole(&self, image: &RgbImage) -> Vec<f32> {
        let [rows, columns] = self.size.map(|n| n as u32);
        // The triangle filter averages when it shrinks a picture, so that nothing flickers.
        let small = imageops::resize(image, columns, rows, imageops::FilterType::Triangle);
        let plane =
            |c: usize| small.pixels().map(move |p| self.scaled(f32::from(p[c]), c)).collect::<Vec<_>>();
        (0..3).flat_map(plane).collect()
    }

    /// A made-up picture for a trial run, in the form that the model reads: from black to white.
    pub(crate) fn trial(&self) -> Vec<f32> {
        let [rows, columns] = self.size;
        let shade = |i: usize| {
            ((i % columns) as f32 / columns as f32 + (i / columns % rows) as f32 / rows as f32) / 2.0
        };
        (0..3 * rows * columns).map(shade).collect()
    }

    /// Runs the model as [`Self::run_unchecked`] does. Fails if the pictures' values are not finite.
    pub(crate) fn run(&mut self, pictures: &[Vec<f32>]) -> Result<(Vec<usize>, Vec<f32>)> {
        let (axes, values) = self.run_unchecked(pictures)?;
        // Rows that only fill the batch are not checked.
        if !values[..values.len() / axes[0] * pictures.len()].iter().all(|v| v.is_finite()) {
            let what = format!("The {} returned not-a-number", self.name());
            return Err(Error::input_at(&self.path, what, NOT_FINITE));
        }
        Ok((axes, values))
    }

    /// Runs the model on `pictures`, [n, …], and returns all axes and values of the output, of which there
    /// are some; the first axis is that of the pictures.
    pub(crate) fn run_unchecked(&mut self, pictures: &[Vec<f32>]) -> Result<(Vec<usize>, Vec<f32>)> {
        let name = self.name();
        let failed = |cause: String| {
            Error::input_at(&self.path, format!("The {name} failed ({cause})"), "The model may be damaged.")
        };
        let [rows, columns] = self.size;
        let num = self.batch.unwrap_or(pictures.len());
        let mut values = pictures.concat();
        values.resize(num * 3 * rows * columns, 0.0);
        let input = Input::F32(vec![num, 3, rows, columns], values);
        let outputs = self.network.run(vec![(&self.input, input)]).map_err(failed)?;
        let (axes, values) = floats(&outputs, &self.output).map_err(failed)?;
        if values.is_empty() || axes.first() != Some(&num) {
            let cause = format!("output `{}` has the shape {axes:?} for {num} pictures", self.output);
            return Err(failed(cause));
        }
        Ok((axes, values.to_vec()))
    }

    /// Name of the kind of model, without its article.
    fn name(&self) -> &'static str {
        self.what.trim_start_matches("an ").trim_start_matches("a ")
    }
}

fn the_model(folder: &Path, role: &Role) -> Result<PathBuf> {
    let files = ModelFile::list(folder, role.what, role.hint)?;
    match files.as_slice() {
        [file] => Ok(file.clone()),
        _ => {
            let what = format!("The folder should hold one model file, {}, not {}", role.what, files.len());
            Err(Error::input_at(folder, what, role.hint))
        }
    }
}

/// Checks the input. Returns its name, the number of pictures at once if it is fixed, and its rows and
/// columns.
fn check_input(
    model: &ModelFile,
    settings: &PictureSettings,
    role: &Role,
) -> Result<(String, Option<usize>, [usize; 2])> {
    let inputs = model.network.inputs();
    let wrong = |hint: &str| {
        let what = format!("The model wants {}; {} takes one batch of images", described(inputs), role.what);
        Err(Error::input_at(&model.path, what, hint))
    };
    let pictures = inputs.iter().filter(|i| i.shape.len() == 4).count();
    let [input] = inputs else {
        return wrong(match (pictures, inputs.iter().any(Outlet::is_integer)) {
            (1.., true) => "Export the image half alone.",
            (_, true) => "You may have picked the text encoder.",
            (2, _) => STEREO,
            _ => role.hint,
        });
    };
    if input.is_integer() {
        return wrong("You may have picked the text encoder.");
    }
    let (batch, height, width) = match input.shape[..] {
        [batch, 3 | -1, height, width] => (batch, height, width),
        [_, 6, _, _] => return wrong(STEREO),
        _ => return wrong(role.hint),
    };
    let is_square = role.size[0] == role.size[1];
    if input.element != Element::F32 || (is_square && height > 0 && width > 0 && height != width) {
        return wrong(role.hint);
    }
    let [rows, columns] = settings.size.map_or(role.size, Size::rows_columns);
    let fixed = |n: i64| usize::try_from(n).ok().filter(|n| *n > 0);
    let size = match is_square {
        true => [fixed(height.max(width)).unwrap_or(rows); 2],
        false => [fixed(height).unwrap_or(rows), fixed(width).unwrap_or(columns)],
    };
    Ok((input.name.clone(), fixed(batch), size))
}

/// Hint for models that need two views of a scene.
const STEREO: &str = "Networks for stereo pairs are unsupported: make depth with the program the network belongs to, and put \
                      it beside the frames (`depth/`, named like them), or give a network for single pictures.";

fn choose_output(model: &ModelFile, settings: &PictureSettings, role: &Role) -> Result<String> {
    let outputs = model.network.outputs();
    let wrong = |what: String, hint: &str| Err(Error::input_at(&model.path, what, hint));
    if let Some(name) = &settings.output {
        return match outputs.iter().any(|o| o.name == *name) {
            true => Ok(name.clone()),
            false => {
                let file = role.settings_file;
                let what =
                    format!("{file} asks for the output `{name}`; the model has {}", described(outputs));
                wrong(what, &format!("Correct output in {file}."))
            }
        };
    }
    let fits = |o: &&Outlet| {
        let axes = o.shape.len();
        o.element == Element::F32 && (axes == 0 || role.ranks.contains(&axes))
    };
    let named = role.outputs.iter().find_map(|name| outputs.iter().find(|o| o.name == *name));
    match named.filter(fits).or_else(|| outputs.iter().find(fits)) {
        Some(output) => Ok(output.name.clone()),
        None => wrong(format!("The model gives {}", described(outputs)), role.hint),
    }
}
