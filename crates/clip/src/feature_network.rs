//! Dense feature maps: a network that gives an embedding for every place of a picture.

use crate::{
    image_encoder,
    picture_model::{PictureModel, Role},
};
use image::RgbImage;
use std::path::Path;
use surgtpgs_core::{Error, Result, segment::DenseMap};

const ROLE: Role = Role {
    what: "a network for feature maps",
    hint: "A network for feature maps takes float images [1,3,384,384] and gives float maps [1,dim,rows,columns].",
    outputs: &["features", "feature_map", "dense_features", "image_features"],
    ranks: &[4],
    size: [384; 2],
    ..image_encoder::ROLE
};

/// A loaded network for feature maps.
pub struct FeatureNetwork {
    model: PictureModel,
    dim: usize,
}

impl FeatureNetwork {
    /// Opens a folder with one model and an optional `encoder.toml`, as [`crate::ImageEncoder`] does, and
    /// checks it with a trial run.
    pub fn open(folder: &Path) -> Result<Self> {
        let mut network = Self { model: PictureModel::open(folder, &ROLE)?, dim: 0 };
        network.dim = network.run(network.model.trial())?.dim;
        Ok(network)
    }

    /// Length of an embedding.
    pub fn dim(&self) -> usize {
        self.dim
    }

    /// SHA-256 over model and settings, hexadecimal.
    pub fn sha256(&self) -> &str {
        &self.model.sha256
    }

    /// Embeddings of a picture's places, with rows and columns as in the network's output.
    pub fn map(&mut self, image: &RgbImage) -> Result<DenseMap> {
        let picture = self.model.whole(image);
        self.run(picture)
    }

    fn run(&mut self, picture: Vec<f32>) -> Result<DenseMap> {
        let (axes, values) = self.model.run(&[picture])?;
        let [_, dim, height, width] = axes[..] else {
            let what = format!("The network gives the shape {axes:?}");
            return Err(Error::input_at(&self.model.path, what, ROLE.hint));
        };
        Ok(DenseMap::of_planes(width, height, dim, &values))
    }
}
