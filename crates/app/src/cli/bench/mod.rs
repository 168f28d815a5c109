//! `surgtpgs bench`: run time beside quality or error, as CSV and SVG.

mod codec;
mod frame;
mod half_features;
mod masks;
mod plot;
mod rows;
mod shown;
mod step;
mod stress;
mod train;

use super::Exit;
use crate::{
    args::{BenchArgs, BenchVerb},
    jobs::Material,
    outputs,
};
use surgtpgs_core::{
    Result,
    camera::Camera,
    deform::deform,
    files::{Claim, Earlier, Inputs, OutputFolder},
    raster::{
        Images, Packed,
        bin::bin,
        forward::raster,
        project::{Splat, project_all},
        reference::ReferenceInput,
    },
    scene::Scene,
    sequence::Sequence,
};

pub(super) fn run(args: &BenchArgs) -> Result<Exit> {
    let mut verb = args.verb.clone();
    let inputs = inputs(&verb)?;
    let output = match verb.output_mut() {
        Some(place) => {
            // An unfinished benchmark is kept, because its rows took long, too.
            let unfinished = Earlier::Keep;
            let claim = Claim { unfinished, ..Claim::new(outputs::BENCHMARK, &inputs, args.force) };
            let output = OutputFolder::claim(place, claim)?;
            output.path().clone_into(place);
            Some(output)
        }
        None => None,
    };
    let exit = measure(&verb)?;
    output.map_or(Ok(()), OutputFolder::finish)?;
    Ok(exit)
}

/// Returns the files and folders that the benchmark reads.
fn inputs(verb: &BenchVerb) -> Result<Inputs> {
    Ok(match verb {
        BenchVerb::Train(args) => {
            outputs::inputs_of_material(&args.sequence, &Material::open(&args.sequence)?)
        }
        BenchVerb::Frame(args) => {
            let scene = &args.scene.scene;
            let recording = Scene::load(scene)?.provenance.sequence_path;
            Inputs::none().with("the scene", scene).with("the scene's recording", &recording)
        }
        BenchVerb::Masks(args) => Inputs::none()
            .with_recording(&Sequence::open(&args.sequence)?)
            .with("the model", &args.masks_model),
        BenchVerb::Codec(args) => Inputs::none().with("the embeddings", &args.embeddings),
        BenchVerb::Step(_) | BenchVerb::Stress(_) => Inputs::none(),
    })
}

fn measure(verb: &BenchVerb) -> Result<Exit> {
    match verb {
        BenchVerb::Train(args) => train::run(args),
        BenchVerb::Step(args) => step::run(args),
        BenchVerb::Frame(args) => frame::run(args),
        BenchVerb::Stress(args) => stress::run(args),
        BenchVerb::Masks(args) => masks::run(args),
        BenchVerb::Codec(args) => codec::run(args),
    }
}

/// Factor by which the image is reduced on each side for the comparison with the f64 twin.
const REDUCTION: u32 = 8;

/// A frame small enough for the f64 twin.
struct Reduced {
    splats: Vec<Splat<f32>>,
    features: Vec<f32>,
    latent_dim: usize,
    packed: Packed,
    images: Images,
}

fn reduced(scene: &Scene, camera: &Camera, time: f32) -> Reduced {
    let camera = camera.resized((camera.width / REDUCTION).max(1), (camera.height / REDUCTION).max(1));
    let (width, height) = (camera.width as usize, camera.height as usize);
    let deformed = deform(&scene.gaussians, &scene.deformation, time, true);
    let splats = project_all(&scene.gaussians, &deformed, &camera);
    let latent_dim = scene.gaussians.latent_dim;
    let packed = Packed::new(&splats, &deformed.features, latent_dim);
    let images = raster(&packed, &bin(&splats, width, height), width, height);
    Reduced { splats, features: deformed.features, latent_dim, packed, images }
}

impl Reduced {
    /// Calls `ask` with the f64 twin of the same splats.
    fn with_twin<T>(&self, ask: impl FnOnce(&ReferenceInput<'_, f64>) -> T) -> T {
        let wide: Vec<Splat<f64>> = self.splats.iter().map(Splat::widened).collect();
        let features: Vec<f64> = self.features.iter().map(|v| f64::from(*v)).collect();
        let Images { width, height, .. } = self.images;
        let (latent_dim, splats) = (self.latent_dim, &wide[..]);
        ask(&ReferenceInput { splats, features: &features, latent_dim, width, height })
    }

    /// Returns the largest difference of a colour, opacity or feature; depth is left out, since it
    /// has another scale.
    fn image_error(&self) -> f64 {
        let pixels = self.images.width * self.images.height;
        let expected = self.with_twin(|twin| twin.forward());
        let differences = self.images.planes.iter().zip(&expected).enumerate();
        differences
            .filter(|(i, _)| !(3 * pixels..4 * pixels).contains(i))
            .map(|(_, (a, b))| (f64::from(*a) - b).abs())
            .fold(0.0, f64::max)
    }
}

/// Returns the largest error of a frame's images against f64.
fn reference_error(scene: &Scene, camera: &Camera, time: f32) -> f64 {
    reduced(scene, camera, time).image_error()
}
