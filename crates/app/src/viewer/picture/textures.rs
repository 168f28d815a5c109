//! The picture on the screen, as textures. Only changed images are sent to the graphics card.

use crate::viewer::{
    picture::request::{Pane, Picture},
    state::view_mode::Layer,
};
use egui::{ColorImage, Context, TextureHandle, TextureId, TextureOptions};
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

struct Texture {
    handle: TextureHandle,
    image: Arc<ColorImage>,
}

impl Shown {
    pub(crate) fn new(picture: Picture, ctx: &Context) -> Self {
        let mut shown = Self {
            picture,
            original: Default::default(),
            reconstruction: Default::default(),
            layer: None,
            difference: None,
        };
        shown.upload(ctx);
        shown
    }

    /// Shows another picture. All its parts change together, so that no part of another frame remains.
    pub(crate) fn update(&mut self, picture: Picture, ctx: &Context) {
        self.picture = picture;
        self.upload(ctx);
    }

    /// Returns the shown layer and its texture.
    pub(crate) fn layer(&self) -> Option<(Layer, TextureId)> {
        let layer = self.picture.layer.as_ref()?.layer;
        self.layer.as_ref().map(|t| (layer, t.handle.id()))
    }

    pub(crate) fn difference(&self) -> Option<TextureId> {
        self.difference.as_ref().map(|t| t.handle.id())
    }

    fn upload(&mut self, ctx: &Context) {
        upload(&mut self.difference, self.picture.difference.as_ref().map(|d| &d.image), ctx);
        self.original.upload(self.picture.original.as_ref(), ctx);
        self.reconstruction.upload(self.picture.reconstruction.as_ref(), ctx);
        upload(&mut self.layer, self.picture.layer.as_ref().map(|l| &l.image), ctx);
    }
}

impl PaneTextures {
    /// Returns the picture with everything found, if there is one and it is wanted, else the bare picture.
    pub(crate) fn id(&self, with_marks: bool) -> Option<TextureId> {
        let marked = if with_marks { self.marked.as_ref() } else { None };
        marked.or(self.bare.as_ref()).map(|t| t.handle.id())
    }

    fn upload(&mut self, pane: Option<&Pane>, ctx: &Context) {
        upload(&mut self.bare, pane.map(|p| &p.bare), ctx);
        upload(&mut self.marked, pane.and_then(|p| p.marked.as_ref()), ctx);
    }
}

fn upload(texture: &mut Option<Texture>, image: Option<&Arc<ColorImage>>, ctx: &Context) {
    match (texture.as_mut(), image) {
        (_, None) => *texture = None,
        (Some(texture), Some(image)) if Arc::ptr_eq(&texture.image, image) => {}
        (Some(texture), Some(image)) => {
            texture.handle.set(image.clone(), TextureOptions::LINEAR);
            texture.image = image.clone();
        }
        (None, Some(image)) => {
            let handle = ctx.load_texture("picture", image.clone(), TextureOptions::LINEAR);
            *texture = Some(Texture { handle, image: image.clone() });
        }
    }
}
