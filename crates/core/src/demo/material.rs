//! Materials of the parts: colour, relief and gloss as functions of the position at rest, so that texture
//! moves with the tissue. Colours are linear light, the display's value squared.

use super::noise::{noise, smoothstep};
use super::shape::ScenePart;
use glam::Vec3;

/// The surface at one point.
#[derive(Clone, Copy, Debug)]
pub(super) struct Material {
    /// Diffuse colour, linear.
    pub(super) albedo: Vec3,
    /// Slope of relief too fine for the mesh, as a gradient.
    pub(super) relief: Vec3,
    /// Strength of the wet highlight.
    pub(super) gloss: f32,
    /// `true` if it mirrors like metal.
    pub(super) metal: bool,
}

/// Returns the material of `part` at `rest`; `open` is the vertex value of the anatomy, low in furrows.
pub(super) fn material(part: ScenePart, rest: Vec3, open: f32, seed: u32) -> Material {
    match part {
        ScenePart::Wall => wall(rest, seed + 20),
        ScenePart::Liver => liver(rest, seed + 30),
        ScenePart::Gallbladder => gallbladder(rest, seed + 40),
        ScenePart::Omentum => fat(rest, open, Vec3::new(0.85, 0.54, 0.12), seed + 50),
        ScenePart::Ligament => fat(rest, open, Vec3::new(0.78, 0.34, 0.075), seed + 60),
        ScenePart::Shaft | ScenePart::UpperJaw | ScenePart::LowerJaw => metal(part, rest),
    }
}

/// Returns the strength of vessels, 0–1. They have the half-width `width` and follow the zero lines of a
/// noise of feature size `size`, stretched along `course` (unit). They fade in and out.
fn vessels(p: Vec3, course: Vec3, size: f32, width: f32, seed: u32) -> f32 {
    let p = p - 0.5 * p.dot(course) * course;
    let present = smoothstep(-0.25, 0.1, noise(p, 1.5 * size, seed + 2).value);
    if present == 0.0 {
        return 0.0;
    }
    let bend = noise(p, 0.6 * size, seed);
    let line = noise(p + 0.05 * size * size * bend.gradient, size, seed + 1);
    let slope = line.gradient.length().max(0.1 / size);
    // In flat parts of the noise the lines would curl into rings and spread into blots.
    let straight = smoothstep(0.4, 0.9, slope * size);
    present * straight * smoothstep(width, 0.25 * width, line.value.abs() / slope)
}

fn tint(colour: Vec3, target: Vec3, share: f32) -> Vec3 {
    colour + (target - colour) * share
}

fn wall(p: Vec3, seed: u32) -> Material {
    /// Direction of its vessels, up to the right.
    const COURSE: Vec3 = Vec3::new(0.6, -0.8, 0.0);
    let (broad, fine) = (noise(p, 22.0, seed), noise(p, 3.2, seed + 1));
    // Muscle is visible as faint parallel bands.
    let fibres = noise(p * Vec3::new(0.45, 1.0, 0.8), 4.5, seed + 2);
    let pink = tint(Vec3::new(0.70, 0.30, 0.27), Vec3::new(0.82, 0.53, 0.48), 0.5 + 1.2 * broad.value);
    let flesh = pink * (1.0 + 0.16 * fine.value + 0.22 * fibres.value);
    let large = vessels(p, COURSE, 19.0, 0.6, seed + 3);
    let small = vessels(p, COURSE, 8.0, 0.32, seed + 6);
    let albedo =
        tint(tint(flesh, Vec3::new(0.33, 0.06, 0.09), 0.5 * small), Vec3::new(0.24, 0.05, 0.11), 0.7 * large);
    Material { albedo, relief: 0.3 * fine.gradient + 0.9 * fibres.gradient, gloss: 0.3, metal: false }
}

fn liver(p: Vec3, seed: u32) -> Material {
    let (broad, mottle, grain) = (noise(p, 17.0, seed), noise(p, 4.2, seed + 1), noise(p, 1.7, seed + 2));
    let red = tint(Vec3::new(0.175, 0.026, 0.022), Vec3::new(0.26, 0.055, 0.042), 0.5 + broad.value);
    let albedo = red * (1.0 + 0.45 * mottle.value + 0.36 * grain.value);
    // Thin pale lines of the capsule.
    let albedo = tint(albedo, Vec3::new(0.36, 0.16, 0.14), 0.28 * vessels(p, Vec3::X, 12.0, 0.35, seed + 3));
    Material { albedo, relief: 0.75 * mottle.gradient + 0.05 * grain.gradient, gloss: 0.7, metal: false }
}

fn gallbladder(p: Vec3, seed: u32) -> Material {
    let (broad, fine) = (noise(p, 12.0, seed), noise(p, 2.6, seed + 1));
    let sac = tint(Vec3::new(0.29, 0.31, 0.17), Vec3::new(0.54, 0.50, 0.32), 0.5 + 1.1 * broad.value);
    let sac = sac * (1.0 + 0.14 * fine.value);
    let large = vessels(p, Vec3::X, 8.0, 0.33, seed + 2);
    let small = vessels(p, Vec3::X, 4.0, 0.2, seed + 5);
    let albedo =
        tint(tint(sac, Vec3::new(0.36, 0.12, 0.10), 0.45 * small), Vec3::new(0.30, 0.06, 0.06), 0.7 * large);
    Material { albedo, relief: 0.2 * fine.gradient + 1.6 * broad.gradient, gloss: 0.9, metal: false }
}

fn fat(p: Vec3, open: f32, yellow: Vec3, seed: u32) -> Material {
    let (broad, fine) = (noise(p, 14.0, seed), noise(p, 2.4, seed + 1));
    let colour = yellow * (Vec3::ONE + broad.value * Vec3::new(0.15, 0.35, 0.7)) * (1.0 + 0.13 * fine.value);
    // Furrows are deeper in colour and redder; thin vessels run over the cushions.
    let furrow = smoothstep(1.0, 0.5, open);
    let colour = tint(colour, yellow * Vec3::new(0.85, 0.62, 0.5), 0.8 * furrow);
    let albedo = tint(colour, Vec3::new(0.42, 0.07, 0.04), 0.6 * vessels(p, Vec3::X, 11.0, 0.27, seed + 2));
    Material { albedo, relief: 0.3 * fine.gradient + 1.5 * broad.gradient, gloss: 0.6, metal: false }
}

fn metal(part: ScenePart, p: Vec3) -> Material {
    // The window in the jaws and the gap at the collar are dark.
    let slot = match part {
        ScenePart::Shaft => smoothstep(0.5, 0.15, (p.z + 28.4).abs()),
        _ => smoothstep(0.75, 0.5, p.x.abs()) * smoothstep(-11.5, -11.0, p.z) * smoothstep(-4.0, -4.5, p.z),
    };
    let albedo = Vec3::new(0.34, 0.35, 0.37) * (1.0 - 0.8 * slot);
    Material { albedo, relief: Vec3::ZERO, gloss: 1.0 - 0.8 * slot, metal: true }
}
