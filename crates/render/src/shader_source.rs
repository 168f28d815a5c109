//! The shaders of `/shaders`, embedded, with `#import` resolved. Constants are taken from core, so that
//! each constant is defined in one place.

use crate::layout::TERM_QUADS;
use std::fmt::Write;
use surgtpgs_core::{
    Error, Result, deform, gaussian,
    overlay::{self, OverlayStyle},
    raster::{self, sh},
    relevancy::Lattice,
    summary::SCORE_BINS,
    train,
};

/// Invocations per workgroup of the passes that run over rows.
pub const GROUP: u32 = 256;
/// Number of items that one workgroup scans.
pub const SCAN_BLOCK: u32 = 1024;
/// Invocations per workgroup of the sort: few enough that its counters fit into 16 KiB of workgroup memory.
pub const SORT_GROUP: u32 = 128;
/// Number of pairs that one workgroup sorts.
pub const SORT_BLOCK: u32 = 2048;
/// Number of splats that a tile's workgroup holds at once.
pub const RASTER_BATCH: u32 = 64;
/// Number of splats that a tile's workgroup replays at once; the least memory of a workgroup, 16 KiB,
/// allows 4.
pub const BACKWARD_BATCH: u32 = 4;
/// Number of Gaussians whose part of the network's gradient one workgroup sums up.
pub const NETWORK_BLOCK: u32 = 1024;
/// Edge of the output block of a layer that one workgroup computes.
pub const DENSE_TILE: u32 = 64;

/// Indices of the numbers in the trainer's status on the device.
pub mod status {
    /// Not 0 if a gradient of the current step is not finite.
    pub const BAD: u32 = 0;
    /// 1 after a step whose gradients may be used.
    pub const OK: u32 = 1;
    /// 1 once pairs did not fit; from then on nothing is changed.
    pub const OVERFLOWN: u32 = 2;
    /// Number of steps in the history.
    pub const DONE: u32 = 3;
    /// Largest number of pairs that a step wanted.
    pub const WANTED: u32 = 4;
    /// Number of updates so far of the parameters at rest.
    pub const COUNT_REST: u32 = 5;
    /// Number of updates so far of colour bands above 0.
    pub const COUNT_SH_REST: u32 = 6;
    /// Number of updates so far of features.
    pub const COUNT_FEATURES: u32 = 7;
    /// Number of updates so far of the feature network.
    pub const COUNT_NETWORK: u32 = 8;
    /// Number of updates so far of basis 0; those of the other bases follow.
    pub const COUNT_BASES: u32 = 9;
}

macro_rules! shaders {
    ($($name:literal),* $(,)?) => {
        // The shaders lie outside the crate's folder. The crate is never published, so that no package
        // lacks them.
        &[$(($name, include_str!(concat!("../../../shaders/", $name)))),*]
    };
}

/// Every shader file by its path in `/shaders`.
pub const FILES: &[(&str, &str)] = shaders![
    "backward.wgsl",
    "bin.wgsl",
    "chain.wgsl",
    "compose.wgsl",
    "deform.wgsl",
    "dense.wgsl",
    "densify.wgsl",
    "features_backward.wgsl",
    "gather.wgsl",
    "lattice.wgsl",
    "loss.wgsl",
    "network.wgsl",
    "overlay.wgsl",
    "pick.wgsl",
    "project.wgsl",
    "raster.wgsl",
    "regions.wgsl",
    "relevancy.wgsl",
    "scan.wgsl",
    "settle.wgsl",
    "sort.wgsl",
    "summary.wgsl",
    "update.wgsl",
    "shared/basis.wgsl",
    "shared/deform.wgsl",
    "shared/dispatch.wgsl",
    "shared/gaussian.wgsl",
    "shared/num.wgsl",
    "shared/random.wgsl",
    "shared/rotation.wgsl",
    "shared/sh.wgsl",
    "shared/slot.wgsl",
    "shared/sum.wgsl",
    "shared/view.wgsl",
];

/// Whole source of `file` for latent dimension D. Each `#import path` line is replaced by that file,
/// once; `#import constants` is replaced by `constants`.
pub fn assemble(file: &str, latent_dim: usize) -> Result<String> {
    let mut out = String::new();
    append(file, latent_dim, &mut Vec::new(), &mut out)?;
    Ok(out)
}

fn append<'a>(file: &'a str, latent_dim: usize, seen: &mut Vec<&'a str>, out: &mut String) -> Result<()> {
    if seen.contains(&file) {
        return Ok(());
    }
    seen.push(file);
    if file == "constants" {
        out.push_str(&constants(latent_dim));
        return Ok(());
    }
    let (_, source) = FILES.iter().find(|(name, _)| *name == file).ok_or_else(|| {
        Error::input(format!("no shader is called {file:?}"), "Add it to `shader_source::FILES`")
    })?;
    for line in source.lines() {
        match line.strip_prefix("#import ") {
            Some(import) => append(import.trim(), latent_dim, seen, out)?,
            None => {
                out.push_str(line);
                out.push('\n');
            }
        }
    }
    Ok(())
}

/// The constants as WGSL.
fn constants(latent_dim: usize) -> String {
    let integers = [
        ("GROUP", GROUP),
        ("SCAN_BLOCK", SCAN_BLOCK),
        ("SORT_GROUP", SORT_GROUP),
        ("SORT_BLOCK", SORT_BLOCK),
        ("RASTER_BATCH", RASTER_BATCH),
        ("DENSE_TILE", DENSE_TILE),
        ("BACKWARD_BATCH", BACKWARD_BATCH),
        ("NETWORK_BLOCK", NETWORK_BLOCK),
        ("STATUS_BAD", status::BAD),
        ("STATUS_OK", status::OK),
        ("STATUS_OVERFLOWN", status::OVERFLOWN),
        ("STATUS_DONE", status::DONE),
        ("STATUS_WANTED", status::WANTED),
        ("COUNT_REST", status::COUNT_REST),
        ("COUNT_SH_REST", status::COUNT_SH_REST),
        ("COUNT_FEATURES", status::COUNT_FEATURES),
        ("COUNT_NETWORK", status::COUNT_NETWORK),
        ("COUNT_BASES", status::COUNT_BASES),
        ("LATTICE_COARSE_BITS", Lattice::COARSE_BITS),
        ("LATTICE_BRICK_LEVELS", Lattice::BRICK_LEVELS),
        ("LATTICE_BRICK", Lattice::BRICK),
        ("LATTICE_EMPTY", Lattice::EMPTY),
        ("SCORE_BINS", SCORE_BINS as u32),
        ("TERM_QUADS", TERM_QUADS as u32),
        ("REGION_TERM", train::NUM_TERMS as u32 - 1),
        ("CONTOUR_WIDTH", overlay::CONTOUR_WIDTH),
        ("LATENT_DIM", latent_dim as u32),
        ("TILE", raster::TILE as u32),
        ("DEPTH_PLANE", raster::DEPTH_PLANE as u32),
        ("ALPHA_PLANE", raster::ALPHA_PLANE as u32),
        ("FEATURE_PLANE", raster::FEATURE_PLANE as u32),
        ("MEAN_CHANNEL", deform::MEAN_CHANNEL as u32),
        ("ROTATION_CHANNEL", deform::ROTATION_CHANNEL as u32),
        ("SCALE_CHANNEL", deform::SCALE_CHANNEL as u32),
        ("COLOUR_CHANNEL", deform::COLOUR_CHANNEL as u32),
        ("GATE_CHANNEL", deform::GATE_CHANNEL as u32),
        ("SHAPE_QUARTIC", deform::BasisShape::Quartic as u32),
        ("SHAPE_SPLINE", deform::BasisShape::Spline as u32),
    ];
    let numbers = [
        ("LATTICE_EXTENT", Lattice::EXTENT),
        ("LATTICE_FINE", Lattice::FINE as f32),
        ("LATTICE_FINE_PER_UNIT", Lattice::FINE_PER_UNIT),
        ("NEAR", raster::NEAR),
        ("DILATION", raster::DILATION),
        ("MIN_ALPHA", raster::MIN_ALPHA),
        ("MAX_ALPHA", raster::MAX_ALPHA),
        ("MIN_TRANSMITTANCE", raster::MIN_TRANSMITTANCE),
        ("MIN_EXTENT", raster::MIN_EXTENT),
        ("SH_C0", gaussian::SH_C0),
        ("SH_C1", sh::C1 as f32),
        ("HALO_DARKNESS", overlay::HALO_DARKNESS),
        ("HEAT_WHITENING", overlay::HEAT_WHITENING),
        ("LIVE_BASIS", deform::LIVE_BASIS),
        ("MIN_WIDTH", deform::MIN_WIDTH as f32),
        ("QUARTIC_EPSILON", deform::QUARTIC_EPSILON as f32),
        ("MAX_LOG_SCALE", deform::MAX_LOG_SCALE as f32),
        ("MAX_SCALE", deform::MAX_SCALE as f32),
        ("MIN_LOSS_ALPHA", train::MIN_DEPTH_ALPHA as f32),
        ("MIN_LOSS_DEPTH", train::MIN_DEPTH as f32),
        ("BETA1", train::BETA1),
        ("BETA2", train::BETA2),
        ("ADAM_EPSILON", train::EPSILON),
        ("LN_SPLIT", train::LN_SPLIT),
        ("SPLIT_DISTANCE", train::SPLIT_DISTANCE),
        ("CLONE_DISTANCE", train::CLONE_DISTANCE),
    ];
    let mut out = String::new();
    for (name, value) in integers {
        let _ = writeln!(out, "const {name}: u32 = {value}u;");
    }
    for (name, value) in numbers {
        // `{:?}` prints the shortest number that reads back as the same f32.
        let _ = writeln!(out, "const {name}: f32 = {value:?}f;");
    }
    for style in OverlayStyle::ALL {
        let _ = writeln!(out, "const STYLE_{}: u32 = {}u;", style.name().to_uppercase(), style as u32);
    }
    for (name, values) in [("SH_C2", sh::C2.as_slice()), ("SH_C3", &sh::C3)] {
        let values: Vec<String> = values.iter().map(|v| format!("{:?}f", *v as f32)).collect();
        let _ = writeln!(out, "const {name} = array<f32, {}>({});", values.len(), values.join(", "));
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_import_is_resolved_once() {
        let source = assemble("project.wgsl", 3).unwrap();
        assert!(!source.contains("#import"));
        assert_eq!(source.matches("fn is_finite").count(), 1);
        assert!(source.contains("const LATENT_DIM: u32 = 3u;"));
        assert!(source.contains("const MIN_ALPHA: f32 = 0.003921569f;"));
    }

    #[test]
    fn an_unknown_shader_is_refused_by_name() {
        assert!(assemble("nothing.wgsl", 0).unwrap_err().to_string().contains("nothing.wgsl"));
    }
}
