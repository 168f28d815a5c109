//! Scores of prompts by decoding every point on the GPU (`shaders/dense.wgsl`, `shaders/relevancy.wgsl`).

use crate::{
    buffers::{DeviceVec, max_bytes, uniform},
    device::Gpu,
    kernel::{Kernel, Pass},
    shader::{GROUP, Shader, shader, shader_struct},
};
use surgtpgs_core::{
    Result,
    codec::{Codec, Linear},
    relevancy::{Exact, Points, Query, Relevancy, RelevancySettings},
};

/// Shaders of these passes.
pub(crate) const SHADERS: &[Shader] = &[DenseWgsl::SHADER, ScoreWgsl::SHADER];
/// Edge of the output block of a layer that one workgroup computes.
const DENSE_TILE: u32 = 64;

shader! {
    DenseWgsl = "dense.wgsl";
    const DENSE_TILE = DENSE_TILE;
    var<uniform> params: DenseParams;
    /// [rows][num_in]
    var<read> inputs: [f32];
    /// [num_out][num_in]
    var<read> weights: [f32];
    var<read> biases: [f32];
    /// [num_rows][num_out]
    var<write> outputs: [f32];
}

shader! {
    ScoreWgsl = "relevancy.wgsl";
    var<uniform> params: ScoreParams;
    /// [num_rows][embedding_dim], not normalised
    var<read> embeddings: [f32];
    /// [num_rows][num_texts]: embedding . text
    var<read> products: [f32];
    var<write> scores: [f32];
}

shader_struct! {
    /// One layer of the decoder.
    pub(crate) struct DenseParams {
        /// Number of points.
        num_rows: u32,
        /// Number of inputs.
        num_in: u32,
        /// Number of outputs.
        num_out: u32,
        /// Row of the input that is row 0 of the output.
        first_row: u32,
        /// 1 if a ReLU follows.
        has_relu: u32,
        /// Padding to a multiple of 16 bytes.
        padding: u32,
        /// Padding to a multiple of 16 bytes.
        padding_2: [u32; 2],
    }
}

shader_struct! {
    /// Scoring of one query.
    pub(crate) struct ScoreParams {
        /// Number of points.
        num_rows: u32,
        /// Number of values of an embedding.
        embedding_dim: u32,
        /// Number of texts of all queries.
        num_texts: u32,
        /// Index of the first text of the query: what the prompt means, then what it is compared with.
        first_text: u32,
        /// Number of texts that the prompt means, at least one.
        num_meant: u32,
        /// Number of texts that it is compared with.
        num_negatives: u32,
        /// Index of the first score.
        first_score: u32,
        /// Sharpness.
        temperature: f32,
        /// Largest margin.
        largest_margin: f32,
        /// Padding to a multiple of 16 bytes.
        padding: u32,
        /// Padding to a multiple of 16 bytes.
        padding_2: [u32; 2],
    }
}

/// The exact rung on the GPU; twin of [`Exact`].
pub struct GpuExact {
    gpu: Gpu,
    dense: Kernel,
    score: Kernel,
    layers: Vec<Layer>,
    /// Inputs and outputs of a layer, which swap after each layer.
    activations: [DeviceVec<f32>; 2],
    products: DeviceVec<f32>,
    twin: Exact,
}

/// One linear layer on the device.
struct Layer {
    weight: DeviceVec<f32>,
    bias: DeviceVec<f32>,
    num_in: usize,
    num_out: usize,
}

impl Layer {
    fn new(gpu: &Gpu, linear: &Linear) -> Result<Self> {
        let (num_out, num_in) = linear.weight.dim();
        let weight: Vec<f32> = linear.weight.iter().copied().collect();
        Ok(Self {
            weight: DeviceVec::from_slice(gpu, "decoder weights", &weight)?,
            bias: DeviceVec::from_slice(gpu, "decoder biases", &linear.bias.to_vec())?,
            num_in,
            num_out,
        })
    }
}

/// Rows of the products of one query: what it means, then what it is compared with.
struct Texts {
    first: usize,
    num_meant: usize,
    num_negatives: usize,
    largest_margin: f32,
}

/// Returns `true` if the query fits the codec and means anything.
fn can_be_found(query: &Query, codec: &Codec) -> bool {
    !query.meant.is_empty() && query.check(codec).is_ok()
}

/// Largest number of points that one dispatch decodes.
const POINTS_AT_ONCE: usize = 16_384;

impl GpuExact {
    /// Uploads the decoder of a scene's codec.
    pub fn new(gpu: &Gpu, codec: Codec) -> Result<Self> {
        codec.validate()?;
        gpu.guarded(|| {
            Ok(Self {
                gpu: gpu.clone(),
                dense: Kernel::new(gpu, &DenseWgsl::SHADER, "dense", 0)?,
                score: Kernel::new(gpu, &ScoreWgsl::SHADER, "score", 0)?,
                layers: codec.decoder.iter().map(|l| Layer::new(gpu, l)).collect::<Result<_>>()?,
                activations: [DeviceVec::new(gpu, "activations"), DeviceVec::new(gpu, "activations")],
                products: DeviceVec::new(gpu, "cosines"),
                twin: Exact::new(codec.clone()),
            })
        })
    }

    /// Scores every point (0–1) for each query; see [`Relevancy::score_points`] for points that score 0.
    pub fn try_score_points(
        &mut self,
        points: &Points<'_>,
        queries: &[Query],
        settings: &RelevancySettings,
    ) -> Result<Vec<Vec<f32>>> {
        let mut scores = vec![vec![0.0; points.len()]; queries.len()];
        let asked: Vec<usize> =
            (0..queries.len()).filter(|&q| can_be_found(&queries[q], &self.twin.codec)).collect();
        if points.latent_dim() != self.twin.codec.latent_dim() || asked.is_empty() {
            return Ok(scores);
        }
        let mut latents = Vec::with_capacity(points.len() * points.latent_dim());
        let live: Vec<usize> = (0..points.len()).filter(|&i| points.push_latent(i, &mut latents)).collect();
        let gpu = self.gpu.clone();
        let chosen: Vec<&Query> = asked.iter().map(|&q| &queries[q]).collect();
        let found =
            gpu.guarded(|| self.score_latents(&latents, live.len(), &chosen, settings.temperature))?;
        for (own, &q) in found.chunks(live.len().max(1)).zip(&asked) {
            for (&i, &score) in live.iter().zip(own) {
                scores[q][i] = score;
            }
        }
        Ok(scores)
    }

    /// Scores of `latents` [n][D] for each query, [queries][n].
    fn score_latents(
        &mut self,
        latents: &[f32],
        n: usize,
        queries: &[&Query],
        temperature: f32,
    ) -> Result<Vec<f32>> {
        let gpu = self.gpu.clone();
        let mut flat = Vec::new();
        let mut texts = Vec::new();
        let dim = self.twin.codec.embedding_dim();
        for query in queries {
            let (first, num_meant) = (flat.len() / dim, query.meant.len());
            query.texts().for_each(|text| flat.extend_from_slice(text));
            let num_negatives = flat.len() / dim - first - num_meant;
            let largest_margin = query.largest_margin(temperature);
            texts.push(Texts { first, num_meant, num_negatives, largest_margin });
        }
        let num_texts = flat.len() / dim;
        let texts_layer = Layer {
            weight: DeviceVec::from_slice(&gpu, "prompts", &flat)?,
            bias: DeviceVec::from_slice(&gpu, "prompts", &vec![0.0; num_texts])?,
            num_in: dim,
            num_out: num_texts,
        };
        let inputs = DeviceVec::from_slice(&gpu, "features", latents)?;
        let mut scores = DeviceVec::new(&gpu, "scores");
        scores.resize(&gpu, n * queries.len())?;
        let at_once = self.prepare(n, num_texts)?;
        let mut encoder = gpu.device().create_command_encoder(&Default::default());
        for first in (0..n).step_by(at_once) {
            let rows = at_once.min(n - first);
            let pass = &mut Pass::begin(&mut encoder);
            let decoded = self.encode_decoder(pass, &inputs, first, rows);
            self.encode_layer(pass, &texts_layer, decoded, &self.products, [0, rows], false);
            for (q, text) in texts.iter().enumerate() {
                let params = ScoreParams {
                    num_rows: rows as u32,
                    embedding_dim: dim as u32,
                    num_texts: num_texts as u32,
                    first_text: text.first as u32,
                    num_meant: text.num_meant as u32,
                    num_negatives: text.num_negatives as u32,
                    first_score: (q * n + first) as u32,
                    temperature,
                    largest_margin: text.largest_margin,
                    ..Default::default()
                };
                let params = uniform(&gpu, &params);
                let bindings = [
                    ScoreWgsl::params(&params),
                    ScoreWgsl::embeddings(decoded),
                    ScoreWgsl::products(&self.products),
                    ScoreWgsl::scores(&scores),
                ];
                self.score.dispatch(&gpu, pass, &bindings, (rows as u32).div_ceil(GROUP));
            }
        }
        gpu.submit(encoder);
        scores.read(&gpu, n * queries.len())
    }

    /// Makes room; returns the number of points that fit at once.
    fn prepare(&mut self, n: usize, num_texts: usize) -> Result<usize> {
        let widest = self.layers.iter().map(|l| l.num_out).max().unwrap_or(1).max(num_texts);
        let limit = max_bytes(&self.gpu) as usize / (widest * size_of::<f32>());
        let at_once = POINTS_AT_ONCE.min(limit).min(n).max(1);
        for array in &mut self.activations {
            array.resize(&self.gpu, at_once * widest)?;
        }
        self.products.resize(&self.gpu, at_once * num_texts)?;
        Ok(at_once)
    }

    /// Adds the decoder for `rows` latents from row `first` on; returns the output for the embeddings.
    fn encode_decoder(
        &self,
        pass: &mut Pass<'_>,
        inputs: &DeviceVec<f32>,
        first: usize,
        rows: usize,
    ) -> &DeviceVec<f32> {
        let last = self.layers.len() - 1;
        for (i, layer) in self.layers.iter().enumerate() {
            let out = &self.activations[i % 2];
            let (from, first) = if i == 0 { (inputs, first) } else { (&self.activations[(i + 1) % 2], 0) };
            self.encode_layer(pass, layer, from, out, [first, rows], i < last);
        }
        &self.activations[last % 2]
    }

    fn encode_layer(
        &self,
        pass: &mut Pass<'_>,
        layer: &Layer,
        from: &DeviceVec<f32>,
        to: &DeviceVec<f32>,
        [first_row, num_rows]: [usize; 2],
        has_relu: bool,
    ) {
        let params = DenseParams {
            num_rows: num_rows as u32,
            num_in: layer.num_in as u32,
            num_out: layer.num_out as u32,
            first_row: first_row as u32,
            has_relu: u32::from(has_relu),
            ..Default::default()
        };
        let params = uniform(&self.gpu, &params);
        let bindings = [
            DenseWgsl::params(&params),
            DenseWgsl::inputs(from),
            DenseWgsl::weights(&layer.weight),
            DenseWgsl::biases(&layer.bias),
            DenseWgsl::outputs(to),
        ];
        let groups = [layer.num_out, num_rows].map(|n| (n as u32).div_ceil(DENSE_TILE));
        self.dense.dispatch_2d(&self.gpu, pass, &bindings, groups);
    }
}

impl Relevancy for GpuExact {
    fn name(&self) -> &'static str {
        "exact (GPU)"
    }

    /// Scores on the GPU. If the GPU fails, the CPU twin computes the same scores.
    fn score_points(
        &mut self,
        points: &Points<'_>,
        queries: &[Query],
        settings: &RelevancySettings,
    ) -> Vec<Vec<f32>> {
        match self.try_score_points(points, queries, settings) {
            Ok(scores) => scores,
            Err(_) => self.twin.score_points(points, queries, settings),
        }
    }
}
