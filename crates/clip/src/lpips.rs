//! Perceptual distance of two pictures, by a network.

use crate::{
    model_file::{ModelFile, described},
    network::Network,
    tensor::{Element, Input, NOT_FINITE, floats},
};
use image::RgbImage;
use std::path::{Path, PathBuf};
use surgtpgs_core::{Error, Result};

const HINT: &str = "LPIPS takes two float images [1,3,height,width] of -1 to 1 and gives one number; export it with free height and width.";

/// Side of the pictures for the trial run of a model that takes any size: enough for five halvings.
const TRIED_SIDE: u32 = 64;

/// LPIPS (Zhang et al. 2018), or any other network from two pictures to their distance.
pub struct Lpips {
    network: Network,
    path: PathBuf,
    inputs: [String; 2],
    output: String,
    /// Rows and columns, if the model takes only these.
    size: [Option<u32>; 2],
}

impl Lpips {
    /// Opens an `.onnx` or `.ort` file. A trial run checks that a picture has no distance from itself.
    pub fn open(path: &Path) -> Result<Self> {
        let model = ModelFile::open(path)?;
        let (inputs, outputs) = (model.network.inputs(), model.network.outputs());
        let wrong = || {
            let what = format!("The model takes {} and gives {}", described(inputs), described(outputs));
            Error::input_at(path, what, HINT)
        };
        let ([one, other], [output]) = (inputs, outputs) else { return Err(wrong()) };
        let ([1 | -1, 3 | -1, height, width], true) = (&one.shape[..], one.shape == other.shape) else {
            return Err(wrong());
        };
        if ![one, other, output].iter().all(|o| o.element == Element::F32) {
            return Err(wrong());
        }
        let size = [height, width].map(|n| u32::try_from(*n).ok().filter(|n| *n > 0));
        let (inputs, output) = ([one.name.clone(), other.name.clone()], output.name.clone());
        let mut lpips = Self { network: model.network, path: model.path, inputs, output, size };
        lpips.try_out()?;
        Ok(lpips)
    }

    /// Distance of two pictures of one size; 0 if they are equal.
    pub fn distance(&mut self, one: &RgbImage, other: &RgbImage) -> Result<f64> {
        let (width, height) = one.dimensions();
        if other.dimensions() != (width, height) {
            let what = format!(
                "the pictures differ in size: {width}×{height} and {}×{}",
                other.width(),
                other.height()
            );
            return Err(Error::input(what, "Compare a scene with its own recording."));
        }
        if let [Some(rows), Some(columns)] = self.size
            && (columns, rows) != (width, height)
        {
            let what = format!(
                "The LPIPS model takes pictures of {columns}×{rows} alone, the frames are {width}×{height}"
            );
            return Err(Error::input(what, HINT));
        }
        let failed = |cause: String| {
            Error::input_at(
                &self.path,
                format!("The LPIPS model failed ({cause})"),
                "The model may be damaged.",
            )
        };
        let input = |picture| Input::F32(vec![1, 3, height as usize, width as usize], planes(picture));
        let [first, second] = &self.inputs;
        let inputs = vec![(first.as_str(), input(one)), (second.as_str(), input(other))];
        let outputs = self.network.run(inputs).map_err(failed)?;
        match floats(&outputs, &self.output).map_err(failed)? {
            (_, [distance]) if distance.is_finite() => Ok(f64::from(*distance)),
            (_, [_]) => Err(Error::input_at(&self.path, "The LPIPS model returned not-a-number", NOT_FINITE)),
            (axes, _) => Err(failed(format!("the output has the shape {axes:?}, not one number"))),
        }
    }

    fn try_out(&mut self) -> Result<()> {
        let [rows, columns] = self.size.map(|n| n.unwrap_or(TRIED_SIDE));
        let picture = |phase: u32| {
            RgbImage::from_fn(columns, rows, |x, y| {
                image::Rgb([(x * 3 + phase) as u8, (y * 5) as u8, phase as u8])
            })
        };
        let same = self.distance(&picture(0), &picture(0))?;
        let apart = self.distance(&picture(0), &picture(90))?;
        if same.abs() < 1e-4 && apart > same.abs() {
            return Ok(());
        }
        let what = format!(
            "The model gives a picture the distance {same:.4} from itself, and {apart:.4} from another"
        );
        Err(Error::input_at(&self.path, what, "LPIPS gives 0 and more than that; this is another model."))
    }
}

/// A picture as [3, height, width], colours from -1 to 1.
fn planes(picture: &RgbImage) -> Vec<f32> {
    let plane = |channel: usize| picture.pixels().map(move |p| f32::from(p.0[channel]) / 127.5 - 1.0);
    (0..3).flat_map(plane).collect()
}
