//! Mirrors of the structs of training.

use super::ShaderStruct;
use bytemuck::{Pod, Zeroable};
use surgtpgs_core::{raster::project::SplatGradient, train::LossTerms};

shader_struct! {
    /// Gradients of what the raster pass reads of a splat (`shared/gaussian.wgsl`).
    pub struct SplatGradientRow {
        /// Per px.
        centre: [f32; 2],
        /// Of z.
        depth: f32,
        /// Of opacity.
        opacity: f32,
        /// (xx, xy, yy), xy counted once.
        conic: [f32; 3],
        /// Length of the centre's gradient in the unit of the statistics; -1 where the splat is culled.
        pull: f32,
        /// Of the colour.
        colour: [f32; 3],
        /// To a multiple of 16 bytes.
        padding: f32,
    }
}

shader_struct! {
    /// Weights of the loss (`loss.wgsl`).
    pub struct Loss {
        /// Columns and rows.
        size: [u32; 2],
        /// 1 where depth is compared.
        has_depth: u32,
        /// 1 where features are compared.
        has_regions: u32,
        /// 1 for depth as the released code has it.
        raw_depth: u32,
        /// 1 for total variation outside the mask too.
        unmasked_variation: u32,
        /// Rows of the table of features.
        num_rows: u32,
        /// Scene units.
        typical_depth: f32,
        /// Weight of |difference| of one number of colour.
        colour_difference: f32,
        /// Weight of |difference| of neighbours.
        colour_variation: f32,
        /// As for colour.
        depth_difference: f32,
        /// As for colour.
        depth_variation: f32,
        /// As for colour.
        feature_difference: f32,
        /// As for colour.
        feature_variation: f32,
        /// To a multiple of 16 bytes.
        padding: [u32; 2],
    }
}

shader_struct! {
    /// Sizes of region smoothness (`regions.wgsl`).
    pub struct Regions {
        /// Of a plane.
        num_pixels: u32,
        /// Blocks of listed pixels.
        num_blocks: u32,
        /// Large regions.
        num_regions: u32,
        /// 1 for one mean over all latent numbers.
        is_pooled: u32,
        /// Weight of a region.
        smoothness: f32,
        /// To a multiple of 16 bytes.
        padding: u32,
        /// To a multiple of 16 bytes.
        padding_2: [u32; 2],
    }
}

shader_struct! {
    /// Some listed pixels of one region (`regions.wgsl`).
    pub struct RegionBlock {
        /// Which.
        region: u32,
        /// First of the listed pixels.
        first: u32,
        /// Their end.
        end: u32,
        /// To a multiple of 16 bytes.
        padding: u32,
    }
}

shader_struct! {
    /// A large region (`regions.wgsl`).
    pub struct Region {
        /// First of its blocks.
        first: u32,
        /// Their end.
        end: u32,
        /// Supervised pixels.
        num_pixels: u32,
        /// To a multiple of 16 bytes.
        padding: u32,
    }
}

shader_struct! {
    /// How slots become gradients (`gather.wgsl`).
    pub struct Gather {
        /// What the pull at a centre is multiplied by.
        pull_scale: [f32; 2],
        /// 0 where the gradient of depth moves no centres.
        depth_moves_centres: u32,
        /// To a multiple of 16 bytes.
        padding: u32,
    }
}

shader_struct! {
    /// What is learned of a colour (`chain.wgsl`).
    pub struct Chain {
        /// Bands above 0 that are learned already.
        learned_bands: u32,
        /// To a multiple of 16 bytes.
        padding: u32,
        /// To a multiple of 16 bytes.
        padding_2: [u32; 2],
    }
}

shader_struct! {
    /// The sum over all Gaussians (`network.wgsl`).
    pub struct Network {
        /// N.
        num_gaussians: u32,
        /// Blocks of them.
        num_blocks: u32,
        /// t.
        time: f32,
        /// To a multiple of 16 bytes.
        padding: u32,
    }
}

shader_struct! {
    /// How a step is judged (`settle.wgsl`).
    pub struct Settle {
        /// Workgroups of the loss.
        num_sums: u32,
        /// Large regions.
        num_regions: u32,
        /// Weight of a region.
        smoothness: f32,
        /// Pairs that there is room for.
        capacity: u32,
        /// First live basis.
        first_basis: u32,
        /// End of the live bases.
        last_basis: u32,
        /// 1 where the feature network learns.
        updates_network: u32,
        /// 1 where parameters are updated at all.
        updates: u32,
    }
}

shader_struct! {
    /// What a step came to (`settle.wgsl`).
    pub struct Settled {
        /// Terms of the loss, weighted.
        colour: f32,
        /// Of depth.
        depth: f32,
        /// Of all total variation.
        variation: f32,
        /// Of features.
        features: f32,
        /// Of region smoothness.
        region: f32,
        /// 1 where the step was dropped.
        is_dropped: u32,
        /// To a multiple of 8 bytes.
        padding: [u32; 2],
    }
}

shader_struct! {
    /// One group of parameters to be updated (`update.wgsl`).
    pub struct Update {
        /// Numbers.
        len: u32,
        /// Where they are among the parameters.
        first: u32,
        /// Number k has learning rate `rate · rates[k mod width]`.
        width: u32,
        /// Index of the group's counter in the status.
        count: u32,
        /// Learning rate.
        rate: f32,
        /// What gradients are multiplied by.
        gain: f32,
        /// Where their moments are.
        first_moment: u32,
        /// First Gaussian of a part.
        first_row: u32,
        /// First channel of the features' gate.
        gate_channel: u32,
        /// [`surgtpgs_core::deform::BasisShape`] of each Gaussian's own as a number.
        shape: u32,
        /// t.
        time: f32,
        /// To a multiple of 16 bytes.
        padding: u32,
    }
}

shader_struct! {
    /// One densification (`densify.wgsl`).
    pub struct Densify {
        /// N.
        num_gaussians: u32,
        /// Of these.
        num_kept: u32,
        /// Of these are parted.
        num_children: u32,
        /// 1 where both halves are placed at random and start afresh.
        split_only: u32,
        /// Lower ones are removed.
        min_opacity_logit: f32,
        /// Those less pulled are not parted.
        min_pull: f32,
        /// Larger ones are split.
        split_log_scale: f32,
        /// To a multiple of 8 bytes.
        padding: u32,
        /// What random numbers follow from.
        seed: [u32; 2],
        /// To a multiple of 8 bytes.
        padding_2: [u32; 2],
    }
}

shader_struct! {
    /// An array that follows the change of the set (`densify.wgsl`).
    pub struct CopyRows {
        /// Planes of so many rows each.
        num_planes: u32,
        /// Here.
        num_rows: u32,
        /// Numbers of a row.
        width: u32,
        /// First row that is here.
        first_row: u32,
        /// Rows of the old array that are here.
        old_num_rows: u32,
        /// First of them.
        old_first_row: u32,
        /// 1 for moments.
        clears_fresh: u32,
        /// To a multiple of 16 bytes.
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

impl From<&Settled> for LossTerms<f32> {
    fn from(s: &Settled) -> Self {
        Self {
            colour: s.colour,
            depth: s.depth,
            total_variation: s.variation,
            features: s.features,
            region: s.region,
        }
    }
}
