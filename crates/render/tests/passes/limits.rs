//! An adapter with the least that WebGPU promises, and with less memory per binding than a scene needs.

use crate::{
    densify::trained,
    fixture::{Recipe, gpu},
    train::Step,
};
use surgtpgs_core::{
    Remedy,
    raster::project::Sampling,
    train::{Densify, LossWeights, Model, TrainBackend},
};
use surgtpgs_render::{Gpu, GpuBackend};

/// Takes a step, densifies, and takes a step with the new set.
fn train(gpu: Gpu, step: &Step) -> surgtpgs_core::Result<Model> {
    let mut backend = GpuBackend::new(gpu)?;
    backend.set_pair_capacity(64)?;
    let (mut model, context) = (step.model.clone(), step.context());
    let how = Densify::new(&step.settings, 4000, 0.05, 100);
    let clock = &mut Default::default();
    backend.step(&mut model, step.plan.clone(), &context, clock)?;
    backend.densify(&mut model, &how, &context)?;
    backend.step(&mut model, step.plan.clone(), &context, clock)?;
    backend.finish(&mut model, &context)?;
    Ok(model)
}

fn large_step(is_shared: bool) -> Step {
    let recipe = Recipe { num_gaussians: 3000, is_shared, ..Recipe::default() };
    let mut step = Step::new(recipe, Sampling { step: 2, first: [0, 1] }, LossWeights::default());
    step.model = trained(recipe);
    step.settings.densify.growth = 0.3;
    step
}

#[test]
fn what_one_binding_cannot_hold_is_cut_and_the_bytes_are_the_same() {
    let Some(gpu) = gpu() else { return };
    for is_shared in [true, false] {
        let step = large_step(is_shared);
        let bytes = size_of_val(&*step.model.deformation.weights);
        let limit = 700 << 10;
        assert!(bytes > 2 * limit, "nothing is cut: {bytes} bytes");
        let small = Gpu::open_small(limit as u64).unwrap();
        let (whole, cut) = (train(gpu.clone(), &step).unwrap(), train(small, &step).unwrap());
        assert!(whole.gaussians.len() > step.model.gaussians.len());
        assert!(whole == cut, "shared: {is_shared}");
    }
}

#[test]
fn what_cannot_be_cut_is_refused_with_what_to_lower() {
    if gpu().is_none() {
        return;
    }
    let small = Gpu::open_small(64 << 10).unwrap();
    let error = train(small, &large_step(true)).unwrap_err();
    assert_eq!(error.remedy(), Some(Remedy::UseCpu));
    let message = error.to_string();
    for part in ["the GPU holds at most", "smaller scene or picture"] {
        assert!(message.contains(part), "{message}");
    }
}
