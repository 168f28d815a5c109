//! Mirrors of the structs of training.

use super::ShaderStruct;
use bytemuck::{Pod, Zeroable};
use surgtpgs_core::{
    raster::project::SplatGradient,
    train::{LossTerms, NUM_TERMS, TermScales},
};

/// Number of groups of four terms of the loss that are sums over pixels: all but the last term.
pub(crate) const TERM_QUADS: usize = (NUM_TERMS - 1).div_ceil(4);

shader_struct! {
    /// Gradients with respect to the values of a splat that the raster pass reads (`shared/gaussian.wgsl`).
    pub struct SplatGradientRow {
        /// ∂L/∂centre, per px.
        centre: [f32; 2],
        /// ∂L/∂depth.
        depth: f32,
        /// ∂L/∂opacity.
        opacity: f32,
        /// ∂L/∂conic for (xx, xy, yy), xy counted once.
        conic: [f32; 3],
        /// Length of the centre's gradient in the unit of the statistics; -1 if the splat is culled.
        pull: f32,
        /// ∂L/∂colour.
        colour: [f32; 3],
        /// Padding to a multiple of 16 bytes.
        padding: f32,
    }
}

shader_struct! {
    /// Weights of the loss (`loss.wgsl`).
    pub struct Loss {
        /// Columns and rows.
        size: [u32; 2],
        /// 1 if depth is compared.
        has_depth: u32,
        /// 1 if features are compared.
        has_regions: u32,
        /// 1 for depth as in the released code.
        raw_depth: u32,
        /// 1 for total variation of colour and features outside the mask too.
        unmasked_variation: u32,
        /// Number of rows of the table of features.
        num_rows: u32,
        /// Typical depth, scene units.
        typical_depth: f32,
        /// Weight of |difference| to the wanted value, per value of colour.
        colour_difference: f32,
        /// Weight of |difference| of neighbours, per value of colour.
        colour_variation: f32,
        /// Weight of |difference| to the wanted value, for depth.
        depth_difference: f32,
        /// Weight of |difference| of neighbours, for depth.
        depth_variation: f32,
        /// Weight of |difference| to the wanted value, for features.
        feature_difference: f32,
        /// Weight of |difference| of neighbours, for features.
        feature_variation: f32,
        /// Padding to a multiple of 16 bytes.
        padding: [u32; 2],
    }
}

shader_struct! {
    /// Sizes of region smoothness (`regions.wgsl`).
    pub struct Regions {
        /// Number of pixels of a plane.
        num_pixels: u32,
        /// Number of blocks of listed pixels.
        num_blocks: u32,
        /// Number of large regions.
        num_regions: u32,
        /// 1 for one mean over all latent numbers.
        is_pooled: u32,
        /// Weight of a region.
        smoothness: f32,
        /// Padding to a multiple of 16 bytes.
        padding: u32,
        /// Padding to a multiple of 16 bytes.
        padding_2: [u32; 2],
    }
}

shader_struct! {
    /// A block of the listed pixels of one region (`regions.wgsl`).
    pub struct RegionBlock {
        /// Index of the region.
        region: u32,
        /// First of the listed pixels.
        first: u32,
        /// End of the listed pixels.
        end: u32,
        /// Padding to a multiple of 16 bytes.
        padding: u32,
    }
}

shader_struct! {
    /// A large region (`regions.wgsl`).
    pub struct Region {
        /// First of its blocks.
        first: u32,
        /// End of its blocks.
        end: u32,
        /// Number of supervised pixels.
        num_pixels: u32,
        /// Padding to a multiple of 16 bytes.
        padding: u32,
    }
}

shader_struct! {
    /// Settings for summing slots into gradients (`gather.wgsl`).
    pub struct Gather {
        /// Factors of the pull at a centre.
        pull_scale: [f32; 2],
        /// 0 if the gradient of depth does not move centres.
        depth_moves_centres: u32,
        /// Padding to a multiple of 16 bytes.
        padding: u32,
    }
}

shader_struct! {
    /// Settings for the learning of colours (`chain.wgsl`).
    pub struct Chain {
        /// Number of bands above 0 that are already learned.
        learned_bands: u32,
        /// Padding to a multiple of 16 bytes.
        padding: u32,
        /// Padding to a multiple of 16 bytes.
        padding_2: [u32; 2],
    }
}

shader_struct! {
    /// Sum of the network's gradient over all Gaussians (`network.wgsl`).
    pub struct Network {
        /// Number of Gaussians, N.
        num_gaussians: u32,
        /// Number of blocks of Gaussians.
        num_blocks: u32,
        /// Time t.
        time: f32,
        /// Padding to a multiple of 16 bytes.
        padding: u32,
    }
}

shader_struct! {
    /// Settings for the judgement of a step (`settle.wgsl`).
    pub struct Settle {
        /// Number of workgroups of the loss.
        num_sums: u32,
        /// Number of large regions.
        num_regions: u32,
        /// Weight of a region.
        smoothness: f32,
        /// Number of pairs that there is room for.
        capacity: u32,
        /// First live basis.
        first_basis: u32,
        /// End of the live bases.
        last_basis: u32,
        /// 1 if the feature network learns.
        updates_network: u32,
        /// 1 if any parameters are updated.
        updates: u32,
    }
}

shader_struct! {
    /// Result of a step (`settle.wgsl`).
    pub struct Settled {
        /// Terms of the loss, weighted, in the order of [`LossTerms`]; then zeros.
        terms: [[f32; 4]; 2],
        /// 1 if the step was dropped.
        is_dropped: u32,
        /// Padding to a multiple of 16 bytes.
        padding: u32,
        /// Padding to a multiple of 16 bytes.
        padding_2: [u32; 2],
    }
}

shader_struct! {
    /// One group of parameters to be updated (`update.wgsl`).
    pub struct Update {
        /// Number of values.
        len: u32,
        /// Index of the first of them among the parameters.
        first: u32,
        /// Period of the learning rates: value k has the rate `rate · rates[k mod width]`.
        width: u32,
        /// Index of the group's counter in the status.
        count: u32,
        /// Learning rate.
        rate: f32,
        /// Factor of the gradients.
        gain: f32,
        /// Index of the first of their moments.
        first_moment: u32,
        /// First Gaussian of a part.
        first_row: u32,
        /// First channel of the features' gate.
        gate_channel: u32,
        /// [`surgtpgs_core::deform::BasisShape`] of bases that are not shared, as a number.
        shape: u32,
        /// Time t.
        time: f32,
        /// Padding to a multiple of 16 bytes.
        padding: u32,
    }
}

shader_struct! {
    /// One densification (`densify.wgsl`).
    pub struct Densify {
        /// Number of Gaussians, N.
        num_gaussians: u32,
        /// Number of Gaussians that are kept.
        num_kept: u32,
        /// Number of kept Gaussians that are divided into two.
        num_children: u32,
        /// 1 to place both halves at random, with fresh moments.
        split_only: u32,
        /// Smallest logit of opacity; Gaussians with a lower one are removed.
        min_opacity_logit: f32,
        /// Smallest pull of a Gaussian that is divided.
        min_pull: f32,
        /// Log-scale above which a Gaussian is split.
        split_log_scale: f32,
        /// Padding to a multiple of 8 bytes.
        padding: u32,
        /// Seed of the random numbers.
        seed: [u32; 2],
        /// Padding to a multiple of 8 bytes.
        padding_2: [u32; 2],
    }
}

shader_struct! {
    /// An array that is rebuilt for the new set of Gaussians (`densify.wgsl`).
    pub struct CopyRows {
        /// Number of planes, each of the same number of rows.
        num_planes: u32,
        /// Number of rows of the new array in this part.
        num_rows: u32,
        /// Number of values of a row.
        width: u32,
        /// First row of the new array in this part.
        first_row: u32,
        /// Number of rows of the old array in this part.
        old_num_rows: u32,
        /// First row of the old array in this part.
        old_first_row: u32,
        /// 1 for moments, whose fresh rows become 0.
        clears_fresh: u32,
        /// Padding to a multiple of 16 bytes.
        padding: u32,
    }
}

impl From<&SplatGradientRow> for SplatGradient<f32> {
    fn from(row: &SplatGradientRow) -> Self {
        Self {
            centre: row.centre,
            conic: row.conic,
            depth: row.depth,
            opacity: row.opacity,
            colour: row.colour,
        }
    }
}

impl Loss {
    /// The weights of the terms, everything else 0. A frame without supervised pixels has no term of colour.
    pub(crate) fn weighted(scales: &TermScales<f32>, is_supervised: bool) -> Self {
        let counts = |v: f32| if is_supervised { v } else { 0.0 };
        Self {
            colour_difference: counts(scales.colour.difference),
            colour_variation: counts(scales.colour.variation),
            depth_difference: scales.depth.difference,
            depth_variation: scales.depth.variation,
            feature_difference: scales.features.difference,
            feature_variation: scales.features.variation,
            ..Self::default()
        }
    }
}

impl From<&Settled> for LossTerms<f32> {
    fn from(s: &Settled) -> Self {
        const { assert!(NUM_TERMS <= 8) };
        Self::of(std::array::from_fn(|k| s.terms.as_flattened()[k]))
    }
}
