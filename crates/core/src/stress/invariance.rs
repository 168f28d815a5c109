//! Changes to a scene that must not change its picture, or only in a known way.

use super::{DIM, Difference, N, camera, difference, ordinary};
use crate::{
    camera::Camera,
    deform::Deformation,
    gaussian::Gaussians,
    raster::{DEPTH_PLANE, Images},
    scene::{Scene, Similarity},
};
use glam::{Quat, Vec3};

/// A scene before and after a change, and the expected second picture, given the first.
pub struct Invariance {
    /// Kind of the change.
    pub family: &'static str,
    /// The scene and its camera before.
    pub before: (Scene, Camera),
    /// The scene and its camera after.
    pub after: (Scene, Camera),
    /// Time at which both are rendered.
    pub time: f32,
    /// Computes the expected second picture from the first.
    expected: fn(&Images) -> Vec<f64>,
    /// Scales the second picture to the size of the first.
    found: fn(&Images) -> Images,
}

impl Invariance {
    /// Difference of the second picture from the expected one.
    pub fn difference(&self, before: &Images, after: &Images) -> Difference {
        difference(&(self.found)(after), &(self.expected)(before))
    }
}

/// All invariances, at several times.
pub fn invariances() -> Vec<Invariance> {
    let mut all = Vec::new();
    for time in [0.05, 0.5, 0.95] {
        let mut add = |family, scene: &Scene, expected, found, change: &dyn Fn(&mut Scene, &mut Camera)| {
            let before = (scene.clone(), camera(64, 48));
            let mut after = before.clone();
            change(&mut after.0, &mut after.1);
            all.push(Invariance { family, before, after, time, expected, found });
        };
        let scene = ordinary(N);
        add("another order of the Gaussians", &scene, same, Images::clone, &|scene, _| reorder(scene));
        let moved = |by: Similarity| {
            move |scene: &mut Scene, view: &mut Camera| {
                (*scene, *view) = (scene.clone().moved(&by), by.moved_camera(view));
            }
        };
        let unmoved = Similarity::IDENTITY;
        let elsewhere = moved(Similarity { shift: Vec3::new(10.0, -20.0, 30.0), ..unmoved });
        add("the world elsewhere", &scene, same, Images::clone, &elsewhere);
        let turned = Quat::from_scaled_axis(Vec3::new(0.5, -1.5, 1.0));
        let turned = moved(Similarity { rotation: turned, ..unmoved });
        add("the world turned", &sided(), same, Images::clone, &turned);
        let enlarged = moved(Similarity { scale: ENLARGED, ..unmoved });
        add("the world enlarged", &scene, deeper, Images::clone, &enlarged);
        add("one more Gaussian, invisible", &scene, same, Images::clone, &|scene, _| {
            append(scene, [0.0, 0.0, 3.0], -30.0);
        });
        add("one more Gaussian, behind the camera", &scene, same, Images::clone, &|scene, _| {
            append(scene, [0.0, 0.0, -3.0], 5.0);
        });
        let mut large = ordinary(N);
        large.gaussians.log_scales.iter_mut().flatten().for_each(|s| *s += 1.5);
        add("twice the resolution", &large, same, halved, &|_, view| *view = camera(128, 96));
    }
    all
}

const ENLARGED: f32 = 7.0;

fn same(before: &Images) -> Vec<f64> {
    before.planes.iter().map(|v| f64::from(*v)).collect()
}

fn deeper(before: &Images) -> Vec<f64> {
    let pixels = before.width * before.height;
    let mut planes = same(before);
    planes[DEPTH_PLANE * pixels..][..pixels].iter_mut().for_each(|z| *z *= f64::from(ENLARGED));
    planes
}

/// Mean of each 2 × 2 pixels.
fn halved(images: &Images) -> Images {
    let (width, height) = (images.width / 2, images.height / 2);
    let planes = images.planes.chunks(images.width * images.height).flat_map(|plane| {
        (0..width * height).map(move |i| {
            let at = 2 * (i / width) * (2 * width) + 2 * (i % width);
            0.25 * (plane[at] + plane[at + 1] + plane[at + 2 * width] + plane[at + 2 * width + 1])
        })
    });
    Images { width, height, planes: planes.collect() }
}

/// Returns an ordinary scene whose colours depend on the side that they are seen from.
fn sided() -> Scene {
    let mut scene = ordinary(N);
    scene.gaussians.sh_degree = 1;
    scene.gaussians.sh_rest = (0..9 * N).map(|i| 0.3 * (i as f32).sin()).collect();
    scene
}

fn reorder(scene: &mut Scene) {
    // 67 and N have no common factor, so that each place is taken once.
    let order: Vec<usize> = (0..N).map(|i| i * 67 % N).collect();
    let Deformation { num_bases, stride, .. } = *scene.deformation;
    let rows: Vec<&[f32]> = scene.deformation.weights.chunks(stride).collect();
    let weights = (0..num_bases).flat_map(|b| order.iter().map(move |i| b * N + i)).flat_map(|row| rows[row]);
    scene.deformation.weights = weights.copied().collect();
    let g = &scene.gaussians;
    *scene.gaussians = Gaussians {
        means: order.iter().map(|&i| g.means[i]).collect(),
        rotations: order.iter().map(|&i| g.rotations[i]).collect(),
        log_scales: order.iter().map(|&i| g.log_scales[i]).collect(),
        opacity_logits: order.iter().map(|&i| g.opacity_logits[i]).collect(),
        colours: order.iter().map(|&i| g.colours[i]).collect(),
        features: order.iter().flat_map(|&i| g.features[i * DIM..][..DIM].to_vec()).collect(),
        ..(**g).clone()
    };
}

fn append(scene: &mut Scene, mean: [f32; 3], opacity_logit: f32) {
    let g = &mut scene.gaussians;
    g.means.push(mean);
    g.rotations.push([1.0, 0.0, 0.0, 0.0]);
    g.log_scales.push([0.0; 3]);
    g.opacity_logits.push(opacity_logit);
    g.colours.push([1.0; 3]);
    g.features.extend([1.0; DIM]);
    let Deformation { num_bases, stride, weights, .. } = &mut *scene.deformation;
    for b in (1..=*num_bases).rev() {
        let end = b * N * *stride;
        weights.splice(end..end, std::iter::repeat_n(0.0, *stride));
    }
}

#[cfg(test)]
mod tests {
    use super::{super::MAX_BEYOND, *};
    use crate::raster::{CpuRenderer, Renderer};

    fn found(case: &Invariance) -> Difference {
        let render = |(scene, camera): &(Scene, Camera)| {
            CpuRenderer::default().render(scene, camera, case.time, true).unwrap()
        };
        case.difference(&render(&case.before), &render(&case.after))
    }

    #[test]
    fn pictures_change_as_they_must_and_no_more() {
        for case in invariances() {
            let found = found(&case);
            let (largest, beyond) = match case.family {
                "another order of the Gaussians"
                | "one more Gaussian, invisible"
                | "one more Gaussian, behind the camera" => (0.0, 0.0),
                // Point samples are compared with means over a pixel, and a blur is a third of a pixel:
                // no exact law holds.
                "twice the resolution" => (f64::INFINITY, 0.5),
                _ => (1e-3, MAX_BEYOND),
            };
            let holds = found.not_finite == 0 && found.largest <= largest && found.beyond <= beyond;
            assert!(holds, "{} at {}: {found:?}", case.family, case.time);
        }
    }

    #[test]
    fn a_change_that_shows_is_noticed() {
        let mut case = invariances().remove(0);
        case.after.0.gaussians.colours.iter_mut().for_each(|c| c[0] += 0.1);
        assert!(found(&case).beyond > 0.01);
    }
}
