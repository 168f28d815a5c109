//! The picture on the screen, as textures. Only changed images are sent to the graphics card.

use crate::viewer::{
    picture::{
        request::{Pane, Picture},
        texture::Texture,
    },
    state::view_mode::Layer,
};
use egui::ColorImage;
use std::sync::Arc;

/// The newest finished picture.
pub(crate) struct Shown {
    pub(crate) picture: Picture,
    pub(crate) original: PaneTextures,
    pub(crate) reconstruction: PaneTextures,
    layer: Option<Texture>,
    difference: Option<Texture>,
}

/// Textures of a picture without and with everything found.
#[derive(Default)]
pub(crate) struct PaneTextures {
    bare: Option<Texture>,
    marked: Option<Texture>,
}

impl Shown {
    pub(crate) fn new(picture: Picture) -> Self {
        let mut shown = Self {
            picture,
            original: Default::default(),
            reconstruction: Default::default(),
            layer: None,
            difference: None,
        };
        shown.upload();
        shown
    }

    /// Shows another picture. All its parts change together, so that no part of another frame remains.
    pub(crate) fn update(&mut self, picture: Picture) {
        self.picture = picture;
        self.upload();
    }

    /// Returns the shown layer and its texture.
    pub(crate) fn layer(&self) -> Option<(Layer, &Texture)> {
        let layer = self.picture.layer.as_ref()?.layer;
        self.layer.as_ref().map(|texture| (layer, texture))
    }

    pub(crate) fn difference(&self) -> Option<&Texture> {
        self.difference.as_ref()
    }

    fn upload(&mut self) {
        upload(&mut self.difference, self.picture.difference.as_ref().map(|d| &d.image));
        self.original.upload(self.picture.original.as_ref());
        self.reconstruction.upload(self.picture.reconstruction.as_ref());
        upload(&mut self.layer, self.picture.layer.as_ref().map(|l| &l.image));
    }
}

impl PaneTextures {
    /// Returns the picture with everything found, if there is one and it is wanted, else the bare picture.
    pub(crate) fn texture(&self, with_marks: bool) -> Option<&Texture> {
        let marked = if with_marks { self.marked.as_ref() } else { None };
        marked.or(self.bare.as_ref())
    }

    fn upload(&mut self, pane: Option<&Pane>) {
        upload(&mut self.bare, pane.map(|p| &p.bare));
        upload(&mut self.marked, pane.and_then(|p| p.marked.as_ref()));
    }
}

fn upload(texture: &mut Option<Texture>, image: Option<&Arc<ColorImage>>) {
    let is_same = |image| texture.as_ref().is_some_and(|texture| texture.is_of(image));
    if !image.is_some_and(is_same) {
        *texture = image.map(|image| Texture::new(image.clone()));
    }
}
