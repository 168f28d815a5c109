//! From a request to textures on the screen: decode or render, score, find, draw.

pub(crate) mod areas;
pub(crate) mod copy;
pub(crate) mod difference;
mod draw;
mod findings;
pub(crate) mod found;
pub(crate) mod layer_colours;
pub(crate) mod marks;
pub(crate) mod meshes;
pub(crate) mod notes;
#[cfg(test)]
mod on_adapter;
pub(crate) mod open;
mod pipeline;
#[cfg(test)]
mod pipeline_tests;
mod rendered;
pub(crate) mod request;
pub(crate) mod texture;
pub(crate) mod textures;
pub(crate) mod thumbnails;
pub(crate) mod timed;
mod worker;
