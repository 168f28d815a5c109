//! Draws one moment of the scene: a depth-buffered triangle raster, shaded per sample under a lamp
//! beside the lens.

use super::material::{Material, material};
use super::noise::smoothstep;
use super::shape::{Anatomy, ScenePart};
use glam::{Vec2, Vec3};
use image::{Rgb, RgbImage};
use rayon::prelude::*;

/// Number of rows of samples that one task draws.
const BAND: usize = 24;
/// Smallest distance from the eye that is drawn, in millimetres.
const NEAR_MM: f32 = 5.0;
/// Position of the lamp, in camera axes, in millimetres. It is beside the lens, so that shadows are visible.
const LAMP: Vec3 = Vec3::new(-8.0, -9.0, 0.0);

/// The vertices of an anatomy at one moment, seen from one eye.
pub(super) struct EyeView<'a> {
    anatomy: &'a Anatomy,
    /// Vertices relative to the eye, in camera axes.
    points: &'a [Vec3],
    /// Vertices on the sample grid: column, row, 1/z.
    screen: Vec<Vec3>,
    width: usize,
    height: usize,
    /// Triangles that touch each band, in their original order.
    bands: Vec<Vec<u32>>,
}

/// The triangle that a sample sees, and its 1/z (0: nothing).
#[derive(Clone, Copy, Debug)]
pub(super) struct Hit {
    pub(super) triangle: u32,
    pub(super) inverse_z: f32,
}

impl<'a> EyeView<'a> {
    /// Projects `points` with `focal` and `centre` in samples onto `width × height` samples.
    pub(super) fn new(
        anatomy: &'a Anatomy,
        points: &'a [Vec3],
        (width, height): (usize, usize),
        focal: f32,
        centre: Vec2,
    ) -> Self {
        let project = |p: &Vec3| (focal * p.truncate() / p.z + centre).extend(1.0 / p.z);
        let screen = points.iter().map(project).collect();
        let mut view =
            Self { anatomy, points, screen, width, height, bands: vec![Vec::new(); height.div_ceil(BAND)] };
        view.sort_into_bands();
        view
    }

    fn sort_into_bands(&mut self) {
        let (columns, rows) = (self.width as f32, self.height as f32);
        for (i, triangle) in self.anatomy.triangles.iter().enumerate() {
            if triangle.iter().any(|&k| self.points[k as usize].z < NEAR_MM) {
                continue;
            }
            let corners = triangle.map(|k| self.screen[k as usize]);
            let low = corners[0].min(corners[1]).min(corners[2]);
            let high = corners[0].max(corners[1]).max(corners[2]);
            if high.x < 0.0 || high.y < 0.0 || low.x >= columns || low.y >= rows {
                continue;
            }
            let (first, last) = (low.y.max(0.0) as usize / BAND, high.y.min(rows - 1.0) as usize / BAND);
            self.bands[first..=last].iter_mut().for_each(|band| band.push(i as u32));
        }
    }

    /// Calls `use_rows`(first row, hits) for every `step` rows of samples, in parallel, and gathers the
    /// results in order. `BAND` must be a multiple of `step`.
    pub(super) fn map_rows<T: Send>(
        &self,
        step: usize,
        use_rows: impl Fn(usize, &[Hit]) -> Vec<T> + Sync,
    ) -> Vec<T> {
        let bands: Vec<Vec<T>> = (0..self.bands.len())
            .into_par_iter()
            .map(|band| {
                let hits = self.cover(band);
                let rows = hits.chunks(step * self.width).enumerate();
                rows.flat_map(|(k, hits)| use_rows(band * BAND + k * step, hits)).collect()
            })
            .collect();
        bands.into_iter().flatten().collect()
    }

    /// Runs the depth test: returns the hit of each sample of a band.
    fn cover(&self, band: usize) -> Vec<Hit> {
        let rows = band * BAND..((band + 1) * BAND).min(self.height);
        let mut hits = vec![Hit { triangle: 0, inverse_z: 0.0 }; rows.len() * self.width];
        for &i in &self.bands[band] {
            let [a, b, c] = self.anatomy.triangles[i as usize].map(|k| self.screen[k as usize]);
            let area = cross(b - a, c - a);
            if area == 0.0 {
                continue;
            }
            let (low, high) = (a.min(b).min(c), a.max(b).max(c));
            // Samples lie at +0.5.
            let first = |v: f32| (v - 0.5).ceil().max(0.0) as usize;
            let end = |v: f32| ((v - 0.5).floor() + 1.0).max(0.0) as usize;
            for y in first(low.y).max(rows.start)..end(high.y).min(rows.end) {
                for x in first(low.x)..end(high.x).min(self.width) {
                    let p = Vec3::new(x as f32 + 0.5, y as f32 + 0.5, 0.0);
                    let share =
                        Vec3::new(cross(b - p, c - p), cross(c - p, a - p), cross(a - p, b - p)) / area;
                    // A little tolerance, so that no gap opens along shared edges.
                    if share.min_element() < -1e-4 {
                        continue;
                    }
                    let inverse_z = share.dot(Vec3::new(a.z, b.z, c.z));
                    let hit = &mut hits[(y - rows.start) * self.width + x];
                    if inverse_z > hit.inverse_z {
                        *hit = Hit { triangle: i, inverse_z };
                    }
                }
            }
        }
        hits
    }

    /// Returns the vertices of the triangle and their perspective-correct shares at the sample (column, row).
    pub(super) fn shares(&self, triangle: u32, sample: Vec2) -> ([usize; 3], Vec3) {
        let corners = self.anatomy.triangles[triangle as usize].map(|k| k as usize);
        let [a, b, c] = corners.map(|k| self.screen[k]);
        let p = sample.extend(0.0);
        let share =
            Vec3::new(cross(b - p, c - p) * a.z, cross(c - p, a - p) * b.z, cross(a - p, b - p) * c.z);
        (corners, share / (share.x + share.y + share.z))
    }
}

fn cross(a: Vec3, b: Vec3) -> f32 {
    a.x * b.y - a.y * b.x
}

/// Interpolates a point within a triangle.
pub(super) fn blend(values: &[Vec3], corners: [usize; 3], share: Vec3) -> Vec3 {
    share.x * values[corners[0]] + share.y * values[corners[1]] + share.z * values[corners[2]]
}

/// Returns smooth vertex normals (not of unit length), all on the same side of the mesh as its
/// triangles' winding.
pub(super) fn normals(anatomy: &Anatomy, points: &[Vec3]) -> Vec<Vec3> {
    let mut normals = vec![Vec3::ZERO; points.len()];
    for triangle in &anatomy.triangles {
        let [a, b, c] = triangle.map(|k| points[k as usize]);
        let normal = (b - a).cross(c - a);
        triangle.iter().for_each(|&k| normals[k as usize] += normal);
    }
    normals
}

/// Returns the hidden share of the lamp for each of `points` (camera axes), 0–1, with a soft border.
pub(super) fn shadows(anatomy: &Anatomy, points: &[Vec3]) -> Vec<f32> {
    let from_lamp: Vec<Vec3> = points.iter().map(|p| p - LAMP).collect();
    let map = ShadowMap::new(anatomy, &from_lamp);
    from_lamp.par_iter().map(|&p| map.hidden(p)).collect()
}

/// Distances of the visible surfaces from the lamp along the camera's axis.
struct ShadowMap {
    depth: Vec<f32>,
}

impl ShadowMap {
    const SIZE: usize = 512;
    const FOCAL: f32 = 350.0;

    fn new(anatomy: &Anatomy, from_lamp: &[Vec3]) -> Self {
        let size = (Self::SIZE, Self::SIZE);
        let view = EyeView::new(anatomy, from_lamp, size, Self::FOCAL, Vec2::splat(0.5 * Self::SIZE as f32));
        Self { depth: view.map_rows(1, |_, hits| hits.iter().map(|h| 1.0 / h.inverse_z).collect()) }
    }

    /// Returns the share of map points around `p` that lie clearly in front of it.
    fn hidden(&self, p: Vec3) -> f32 {
        let position = Self::FOCAL * p.truncate() / p.z + 0.5 * Self::SIZE as f32 - 0.5;
        let corner = position.floor();
        let (mut hidden, mut total) = (0.0, 0.0);
        for (i, j) in (-2..=3).flat_map(|j| (-2..=3).map(move |i| (i, j))) {
            let tap = corner + Vec2::new(i as f32, j as f32);
            let near = Vec2::ONE - (tap - position).abs() / 3.0;
            let weight = near.x.max(0.0) * near.y.max(0.0);
            let inside = tap.min_element() >= 0.0 && tap.max_element() < Self::SIZE as f32;
            if inside {
                let z = self.depth[tap.y as usize * Self::SIZE + tap.x as usize];
                hidden += weight * smoothstep(1.2, 4.0, p.z - z);
            }
            total += weight;
        }
        hidden / total
    }
}

/// One shaded sample.
pub(super) struct Spot {
    pub(super) part: ScenePart,
    /// Position relative to the eye, in camera axes.
    pub(super) position: Vec3,
    /// Normal of unit length, on the side of the eye.
    pub(super) normal: Vec3,
    /// Position in rest axes.
    pub(super) rest: Vec3,
    pub(super) open: f32,
    /// Hidden share of the lamp, 0–1.
    pub(super) shadow: f32,
}

/// Returns the light that the spot sends to the eye, linear, 0–1.
pub(super) fn shade(spot: &Spot, seed: u32) -> Vec3 {
    let material = material(spot.part, spot.rest, spot.open, seed);
    let to_eye = -spot.position.normalize();
    let to_lamp = LAMP - spot.position;
    let distance = to_lamp.length();
    let to_lamp = to_lamp / distance;
    let slope = material.relief - spot.normal * spot.normal.dot(material.relief);
    let normal = (spot.normal - slope).normalize();
    // The inverse-square law, softened by scattered light in the cavity.
    let reach = 80.0 / distance;
    let lamp = reach * reach * (0.12 + 0.88 * reach * reach) * (1.0 - 0.65 * spot.shadow);
    let half = (to_lamp + to_eye).normalize();
    let colour = if material.metal {
        mirror(&material, normal, to_eye, to_lamp) * lamp.min(1.6)
    } else {
        // Light that enters wet tissue leaves it around the edge and is redder.
        let facing = normal.dot(to_lamp);
        let wrap = Vec3::new(0.22, 0.14, 0.13);
        let diffuse = ((Vec3::splat(facing) + wrap) / (Vec3::ONE + wrap)).max(Vec3::ZERO);
        let shine = material.gloss * highlight(normal.dot(half), 6);
        let sheen = 0.10 * material.gloss * highlight(normal.dot(half), 4);
        lamp * (material.albedo * diffuse * spot.open
            + Vec3::new(1.0, 0.98, 0.95) * (0.75 * shine + 0.3 * sheen))
    };
    let light = 2.6 * (colour + 0.02 * material.albedo * spot.open);
    // Bright areas saturate gently, as in a camera.
    let light = light * (Vec3::ONE + light / 8.0) / (Vec3::ONE + light);
    light * (0.55 + 0.75 * light)
}

/// Computes cos^(2^squarings), the profile of a highlight.
fn highlight(cosine: f32, squarings: u32) -> f32 {
    (0..squarings).fold(cosine.max(0.0), |c, _| c * c)
}

/// Shades metal, which mirrors the lit tissue below, the dark above, and the lamp.
fn mirror(material: &Material, normal: Vec3, to_eye: Vec3, to_lamp: Vec3) -> Vec3 {
    let seen = 2.0 * normal.dot(to_eye) * normal - to_eye;
    let below = smoothstep(-0.2, 0.9, seen.y);
    let around = Vec3::new(0.03, 0.02, 0.022) + below * Vec3::new(0.40, 0.22, 0.12);
    let facing = normal.dot(to_lamp).max(0.0);
    let lamp = 0.25 * highlight(seen.dot(to_lamp), 2) + 0.9 * highlight(seen.dot(to_lamp), 5);
    material.albedo * (0.08 + 0.5 * facing) + material.gloss * (around + Vec3::splat(lamp))
}

/// Returns the picture as a quick motion to the side blurs it: each pixel is the mean of those around it in
/// its row, over a twentieth of the width.
pub(super) fn blurred(picture: &RgbImage) -> RgbImage {
    let (width, height) = picture.dimensions();
    let reach = width / 40;
    RgbImage::from_fn(width, height, |x, y| {
        let row = x.saturating_sub(reach)..=(x + reach).min(width - 1);
        let count = row.clone().count() as u32;
        let sum = |c: usize| row.clone().map(|x| u32::from(picture.get_pixel(x, y)[c])).sum::<u32>();
        Rgb([0, 1, 2].map(|c| (sum(c) / count) as u8))
    })
}
