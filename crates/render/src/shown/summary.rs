//! From scores to a histogram, the largest score, and the found pixels of each column and row
//! (`shaders/summary.wgsl`).

use super::overlay::PromptRow;
use crate::{
    buffers::{DeviceVec, uniform},
    device::Gpu,
    kernel::{Kernel, Pass},
    shader::{GROUP, shader, shader_struct},
};
use surgtpgs_core::{
    Result,
    summary::{SCORE_BINS, Summary},
};

shader! {
    pub(super) Wgsl = "summary.wgsl";
    const SCORE_BINS = SCORE_BINS as u32;
    var<uniform> params: SummaryParams;
    var<read> prompts: [PromptRow];
    /// [prompts][rows][columns]
    var<read> scores: [f32];
    /// [prompts]: SCORE_BINS of the histogram, the bits of the largest score, the number of found pixels of
    /// each column, of each row.
    var<atomic> summaries: [u32];
}

shader_struct! {
    /// Summary of scores.
    pub(crate) struct SummaryParams {
        /// Columns and rows.
        size: [u32; 2],
        /// Number of prompts.
        num_prompts: u32,
        /// Padding to a multiple of 16 bytes.
        padding: u32,
    }
}

#[derive(Debug)]
pub(crate) struct SummaryPass {
    kernel: Kernel,
    size: [u32; 2],
    /// Output, [prompts][bins, largest score, columns, rows].
    pub summaries: DeviceVec<u32>,
}

impl SummaryPass {
    pub(crate) fn new(gpu: &Gpu) -> Result<Self> {
        Ok(Self {
            kernel: Kernel::new(gpu, &Wgsl::SHADER, "summarise", 0)?,
            size: [0; 2],
            summaries: DeviceVec::new(gpu, "summaries"),
        })
    }

    /// Makes room for pictures of columns × rows.
    pub(crate) fn prepare(&mut self, gpu: &Gpu, size: [u32; 2], num_prompts: usize) -> Result<()> {
        self.size = size;
        self.summaries.resize(gpu, num_prompts * length(size))
    }

    /// Adds the pass; the summaries are zeros before it.
    pub(crate) fn encode(
        &self,
        gpu: &Gpu,
        pass: &mut Pass<'_>,
        prompts: &DeviceVec<PromptRow>,
        scores: &DeviceVec<f32>,
    ) {
        let num_prompts = prompts.len() as u32;
        let params = uniform(gpu, &SummaryParams { size: self.size, num_prompts, padding: 0 });
        let bindings = [
            Wgsl::params(&params),
            Wgsl::prompts(prompts),
            Wgsl::scores(scores),
            Wgsl::summaries(&self.summaries),
        ];
        self.kernel.dispatch(gpu, pass, &bindings, (self.size[0] * self.size[1]).div_ceil(GROUP));
    }

    /// Converts the numbers to the form of core.
    pub(crate) fn parse(&self, numbers: &[u32]) -> Vec<Summary> {
        let columns = self.size[0] as usize;
        let one = |numbers: &[u32]| {
            let (histogram, rest) = numbers.split_at(SCORE_BINS);
            Summary {
                histogram: std::array::from_fn(|i| histogram[i]),
                max_score: f32::from_bits(rest[0]),
                columns: rest[1..=columns].to_vec(),
                rows: rest[1 + columns..].to_vec(),
            }
        };
        numbers.chunks_exact(length(self.size)).map(one).collect()
    }
}

fn length([columns, rows]: [u32; 2]) -> usize {
    SCORE_BINS + 1 + (columns + rows) as usize
}
