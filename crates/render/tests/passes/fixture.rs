//! Scenes, cameras, prompts and the adapter that the tests run on.

use glam::{Affine3A, EulerRot, Quat, Vec3};
use ndarray::{Array1, Array2};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::sync::LazyLock;
use surgtpgs_core::{
    camera::Camera,
    codec::{Codec, Linear},
    deform::{BasisShape, Deformation, GATE_SLOPE},
    gaussian::Gaussians,
    relevancy::{Query, Rivals},
    scene::Scene,
};
use surgtpgs_render::{AdapterChoice, Gpu, Unavailable};

/// Opens the adapter and prints its name. Without one it says so and returns `None`; under `CI=true` that
/// is a failure.
pub(crate) fn gpu() -> Option<Gpu> {
    static GPU: LazyLock<Result<Gpu, Unavailable>> = LazyLock::new(|| Gpu::open(AdapterChoice::Any));
    match &*GPU {
        Ok(gpu) => {
            eprintln!("adapter: {}", gpu.name());
            Some(gpu.clone())
        }
        Err(reason) => {
            assert!(std::env::var("CI").as_deref() != Ok("true"), "CI needs a graphics adapter: {reason}");
            eprintln!("SKIPPED, nothing was compared: {reason}");
            None
        }
    }
}

/// Ingredients of a test scene.
#[derive(Clone, Copy)]
pub(crate) struct Recipe {
    pub num_gaussians: usize,
    pub latent_dim: usize,
    pub sh_degree: usize,
    pub shape: BasisShape,
    /// `true` if all Gaussians share the basis functions.
    pub is_shared: bool,
}

impl Default for Recipe {
    fn default() -> Self {
        Self {
            num_gaussians: 1500,
            latent_dim: 3,
            sh_degree: 0,
            shape: BasisShape::Gaussian,
            is_shared: true,
        }
    }
}

/// A seeded scene in front of the camera with every oddity: needles, pancakes, Gaussians behind and
/// beside the camera, equal depths, quaternions without direction, hardly visible and opaque ones.
pub(crate) fn scene(recipe: Recipe) -> Scene {
    let Recipe { num_gaussians: n, latent_dim, sh_degree, .. } = recipe;
    let rng = &mut ChaCha8Rng::seed_from_u64(7);
    let mut gaussians = Gaussians { sh_degree, latent_dim, ..Default::default() };
    for i in 0..n {
        let z = match i % 40 {
            0 => -2.0,   // behind the camera
            1 => 0.2,    // close to the camera
            2..6 => 3.0, // ties in depth
            _ => rng.random_range(1.5..6.0),
        };
        let spread = if i % 17 == 0 { 3.0 } else { 0.6 };
        gaussians.means.push([
            z * rng.random_range(-spread..spread),
            z * rng.random_range(-spread..spread),
            z,
        ]);
        let rotation =
            if i % 50 == 7 { [0.0; 4] } else { std::array::from_fn(|_| rng.random_range(-1.0..1.0)) };
        gaussians.rotations.push(rotation);
        let size: f32 = rng.random_range(-4.5..-2.5);
        gaussians.log_scales.push(match i % 9 {
            0 => [size + 3.0, size - 4.0, size - 4.0],
            1 => [size + 1.5, size + 1.5, size - 6.0],
            _ => [size, size + 0.4, size - 0.3],
        });
        gaussians.opacity_logits.push(match i % 11 {
            0 => 8.0,
            1 => -5.6,
            _ => rng.random_range(-3.0..3.0),
        });
        gaussians.colours.push(std::array::from_fn(|_| rng.random_range(-2.0..2.0)));
    }
    gaussians.sh_rest = numbers(rng, n * gaussians.sh_bands() * 3, 0.4);
    gaussians.features = numbers(rng, n * latent_dim, 1.0);
    let deformation = deformation(rng, recipe);
    Scene::seen_by(camera(64, 48), gaussians, deformation)
}

fn deformation(rng: &mut ChaCha8Rng, recipe: Recipe) -> Deformation {
    const NUM_BASES: usize = 9;
    let Recipe { num_gaussians: n, latent_dim, .. } = recipe;
    let mut deformation = Deformation::at_rest(n, latent_dim, NUM_BASES, 0.06, GATE_SLOPE);
    deformation.shape = recipe.shape;
    deformation.weights = numbers(rng, deformation.weights.len(), 0.1);
    deformation.feature_weight = numbers(rng, latent_dim * (latent_dim + 1), 0.7);
    deformation.feature_bias = numbers(rng, latent_dim, 0.3);
    if !recipe.is_shared {
        let block = n * deformation.stride;
        let spread = |rng: &mut ChaCha8Rng, values: &[f32], by: f32| -> Vec<f32> {
            (0..NUM_BASES * block).map(|i| values[i / block] + rng.random_range(-by..by)).collect()
        };
        deformation.centres = spread(rng, &deformation.centres, 0.05);
        deformation.widths = spread(rng, &deformation.widths, 0.08);
    }
    deformation
}

/// Seeded random numbers within ± `size`.
pub(crate) fn numbers(rng: &mut ChaCha8Rng, len: usize, size: f32) -> Vec<f32> {
    (0..len).map(|_| rng.random_range(-size..size)).collect()
}

/// A still camera at the origin.
pub(crate) fn camera(width: u32, height: u32) -> Camera {
    Camera::with_field_of_view(width, height, 60.0)
}

/// A camera that has moved: turned and shifted, with the principal point off the middle and pixels that
/// are not square.
pub(crate) fn moved_camera(width: u32, height: u32) -> Camera {
    let mut camera = camera(width, height);
    let turn = Quat::from_euler(EulerRot::XYZ, 0.1, -0.2, 0.3);
    camera.camera_from_world = Affine3A::from_rotation_translation(turn, Vec3::new(0.3, -0.2, 0.4));
    camera.cx += 3.7;
    camera.fy *= 1.1;
    camera
}

/// Number of values of an embedding.
const EMBEDDING_DIM: usize = 70;

/// A codec with a decoder of odd widths.
pub(crate) fn codec() -> Codec {
    let rng = &mut ChaCha8Rng::seed_from_u64(3);
    let mut layers = |widths: &[usize]| -> Vec<Linear> {
        let layer = |pair: &[usize]| {
            let size = (3.0 / pair[0] as f32).sqrt();
            Linear {
                weight: Array2::from_shape_vec((pair[1], pair[0]), numbers(rng, pair[0] * pair[1], size))
                    .unwrap(),
                bias: Array1::from(numbers(rng, pair[1], 0.2)),
            }
        };
        widths.windows(2).map(layer).collect()
    };
    Codec { encoder: layers(&[EMBEDDING_DIM, 20, 3]), decoder: layers(&[3, 17, 130, 64, EMBEDDING_DIM]) }
}

pub(crate) fn query(prompt: &str, num_negatives: usize) -> Query {
    let rng = &mut ChaCha8Rng::seed_from_u64(prompt.len() as u64);
    let mut text = || surgtpgs_core::num::normalised(&numbers(rng, EMBEDDING_DIM, 1.0)).unwrap();
    let query = Query::new(prompt, text());
    query.but_not((0..num_negatives).map(|i| (format!("negative {i}"), text())).collect())
}

/// A prompt that means two texts, is not certain, and competes with rivals of which one is an ally.
pub(crate) fn uncertain() -> Query {
    let rng = &mut ChaCha8Rng::seed_from_u64(40);
    let mut text = || surgtpgs_core::num::normalised(&numbers(rng, EMBEDDING_DIM, 1.0)).unwrap();
    let meant = vec![text(), text()];
    let texts: Vec<Vec<f32>> = (0..9).map(|_| text()).collect();
    let rivals = Rivals::new(texts.iter().map(|text| ("rival", text.as_slice())));
    Query { meant, certainty: 0.4, ..query("tool", 1) }.among(&rivals, vec![3])
}
