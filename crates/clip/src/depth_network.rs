//! Depth from single pictures, by a network that gives disparity or depth.

use crate::picture_model::{PictureModel, Role};
use image::RgbImage;
use std::path::Path;
use surgtpgs_core::{Error, Result, grid::Grid, sequence::DepthKind};

const ROLE: Role = Role {
    what: "a depth network",
    hint: "A depth network takes float images [1,3,rows,columns] and gives disparity or depth [1,1,rows,columns].",
    settings_file: "depth.toml",
    keys: "kind, range, size, mean, std and output",
    outputs: &["disp", "disp_0", "disparity", "depth", "predicted_depth"],
    ranks: &[3, 4],
    // Input size of EndoDAC.
    size: [256, 320],
    colours: [[0.0; 3], [1.0; 3]],
};
/// Nearest and farthest depth of networks that end in a sigmoid (Monodepth2 and its descendants, EndoDAC
/// among them).
const SIGMOID_RANGE: [f32; 2] = [0.1, 150.0];

/// A loaded depth network.
pub struct DepthNetwork {
    model: PictureModel,
    kind: DepthKind,
    /// Nearest and farthest depth that its values 0–1 stand for.
    range: Option<[f32; 2]>,
}

impl DepthNetwork {
    /// Opens a model file, or a folder with one, and checks it with a trial run.
    ///
    /// The optional file `depth.toml` beside the model has the keys `kind` ("depth" or "disparity";
    /// needed if the output's name does not say), `range` ([nearest, farthest] of a disparity 0–1;
    /// EndoDAC's unless given), `size`, `mean`, `std` and `output`.
    pub fn open(path: &Path) -> Result<Self> {
        let model = PictureModel::open(path, &ROLE)?;
        let named = model.output().to_lowercase().starts_with("disp").then_some(DepthKind::Disparity);
        let Some(kind) = model.settings.kind.or(named) else {
            let what = format!("Whether `{}` is depth or disparity cannot be seen", model.output());
            let hint = "Write kind = \"depth\" or kind = \"disparity\" into depth.toml beside the model.";
            return Err(Error::input_at(&model.path, what, hint));
        };
        let range = model.settings.range;
        let mut network = Self { model, kind, range };
        network.try_out()?;
        Ok(network)
    }

    /// Kind of values that [`Self::estimate`] returns.
    pub fn kind(&self) -> DepthKind {
        self.kind
    }

    /// SHA-256 over model and settings, hexadecimal.
    pub fn sha256(&self) -> &str {
        &self.model.sha256
    }

    /// Estimates depth or disparity of a picture, in a unit and at a size of the network's own. Some values
    /// may not be finite.
    pub fn estimate(&mut self, image: &RgbImage) -> Result<Grid<f32>> {
        let picture = self.model.whole(image);
        let output = self.model.run_unchecked(&[picture])?;
        let map = self.as_map(output)?;
        Ok(match self.range {
            Some([near, far]) if self.kind == DepthKind::Disparity => {
                map.map(|v| 1.0 / far + (1.0 / near - 1.0 / far) * v)
            }
            _ => map,
        })
    }

    fn as_map(&self, (axes, values): (Vec<usize>, Vec<f32>)) -> Result<Grid<f32>> {
        match axes[..] {
            [_, height, width] | [_, 1, height, width] if height * width > 1 => {
                Ok(Grid::from_vec(width, height, values.into_iter().take(width * height).collect()))
            }
            _ => {
                let what = format!("The depth network gives the shape {axes:?}");
                Err(Error::input_at(&self.model.path, what, ROLE.hint))
            }
        }
    }

    /// Runs the network on a made-up picture; the values show if it ends in a sigmoid.
    fn try_out(&mut self) -> Result<()> {
        let output = self.model.run(&[self.model.trial()])?;
        let map = self.as_map(output)?;
        let is_sigmoid = map.data.iter().all(|v| (0.0..=1.0).contains(v));
        if self.kind == DepthKind::Disparity && is_sigmoid && self.range.is_none() {
            self.range = Some(SIGMOID_RANGE);
        }
        Ok(())
    }
}
