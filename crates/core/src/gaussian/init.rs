//! The first Gaussians: pixels of training frames, back-projected (method §2.1). Each spot is covered once.

use super::{Gaussians, SH_C0};
use crate::{camera::Camera, grid::Grid, num::logit};
use image::RgbImage;
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::num::NonZeroUsize;

/// Smallest channel of a Gaussian's first colour, 8-bit. At 0, colour has no gradient (method §4.2), and a
/// Gaussian would stay black.
const DARKEST: u8 = 1;

/// A frame to seed from.
#[derive(Debug)]
pub struct SeedFrame {
    /// Camera of the frame.
    pub camera: Camera,
    /// Colours of the frame.
    pub colour: RgbImage,
    /// Pixels that may be seeded: `true` = yes.
    pub mask: Grid<bool>,
    /// z in scene units, 0 where unknown; `None` without depth.
    pub depth: Option<Grid<f32>>,
}

/// Placement of the first Gaussians.
#[derive(Clone, Copy, Debug)]
pub struct SeedSettings {
    /// Pixels between neighbours.
    pub spacing_px: f32,
    /// Depth of pixels of unknown depth, scene units.
    pub default_depth: f32,
    /// Opacity of all Gaussians.
    pub opacity: f32,
    /// `true` to derive sizes from the distances to the three nearest neighbours (method §2.2) instead of
    /// from the spacing.
    pub neighbour_sizes: bool,
    /// Latent numbers per Gaussian, D.
    pub latent_dim: usize,
    /// Spherical-harmonic degree.
    pub sh_degree: usize,
    /// Seed of the places within the cells.
    pub seed: u64,
}

/// Places one Gaussian in every cell of `spacing_px`² pixels that is supervised and not yet covered by a
/// Gaussian from an earlier frame. Pixels of unknown depth lie on the fronto-parallel plane at the
/// default depth.
pub fn seed(frames: &[SeedFrame], settings: &SeedSettings) -> Gaussians {
    let mut rng = ChaCha8Rng::seed_from_u64(settings.seed);
    let mut gaussians =
        Gaussians { latent_dim: settings.latent_dim, sh_degree: settings.sh_degree, ..Gaussians::default() };
    for frame in frames {
        seed_frame(frame, settings, &mut gaussians, |cell| Some(cell.place(&mut rng)));
    }
    // So little is kept by the masks that chance missed all of it.
    if gaussians.is_empty() {
        for frame in frames {
            seed_frame(frame, settings, &mut gaussians, |cell| {
                cell.pixels().find(|[x, y]| frame.mask.at(*x, *y))
            });
        }
    }
    let n = gaussians.len();
    gaussians.opacity_logits = vec![logit(settings.opacity); n];
    gaussians.features = vec![0.0; n * settings.latent_dim];
    gaussians.sh_rest = vec![0.0; n * gaussians.sh_bands() * 3];
    if settings.neighbour_sizes {
        gaussians.log_scales = neighbour_log_scales(&gaussians.means);
    }
    gaussians
}

/// ½ ln of the mean squared distance to the three nearest neighbours; the mean is at least 1e-7.
fn neighbour_log_scales(means: &[[f32; 3]]) -> Vec<[f32; 3]> {
    const SMALLEST: f32 = 1e-7;
    let Ok(tree) = ImmutableKdTree::<f32, 3>::new_from_slice(means) else {
        // There are no points to build a tree from.
        return vec![[0.5 * SMALLEST.ln(); 3]; means.len()];
    };
    let count = NonZeroUsize::new(4).unwrap_or(NonZeroUsize::MIN);
    let log_scale = |mean: &[f32; 3]| {
        // The nearest point is the point itself.
        let near = tree.query(mean).nearest_n::<SquaredEuclidean<f32>>(count).execute();
        let others = near.iter().skip(1).map(|n| n.distance);
        let mean = others.clone().sum::<f32>() / (others.count().max(1) as f32);
        0.5 * mean.max(SMALLEST).ln()
    };
    means.iter().map(|mean| [log_scale(mean); 3]).collect()
}

/// A square of a frame, cut off where the frame ends: [first, end] of its columns and rows, px.
struct Cell([[f32; 2]; 2]);

impl Cell {
    /// Returns a pixel in its middle, at random.
    fn place(&self, rng: &mut ChaCha8Rng) -> [usize; 2] {
        self.0.map(|[start, end]| (start + rng.random_range(0.2..0.8) * (end - start)) as usize)
    }

    fn pixels(&self) -> impl Iterator<Item = [usize; 2]> {
        let [columns, rows] = self.0.map(|[start, end]| start as usize..end.ceil() as usize);
        rows.flat_map(move |y| columns.clone().map(move |x| [x, y]))
    }
}

/// Adds a Gaussian in each cell that shows none yet, at the `place` in it, if the mask keeps that.
fn seed_frame(
    frame: &SeedFrame,
    settings: &SeedSettings,
    gaussians: &mut Gaussians,
    mut place: impl FnMut(Cell) -> Option<[usize; 2]>,
) {
    let spacing_px = settings.spacing_px.max(1.0);
    let (width, height) = (frame.mask.width, frame.mask.height);
    let columns = (width as f32 / spacing_px).ceil() as usize;
    let rows = (height as f32 / spacing_px).ceil() as usize;
    let cell_of = |u: f32, v: f32| {
        let inside = u >= 0.0 && v >= 0.0 && u < width as f32 && v < height as f32;
        inside.then(|| (v / spacing_px) as usize * columns + (u / spacing_px) as usize)
    };
    let mut covered = vec![false; columns * rows];
    for mean in &gaussians.means {
        if let Some(cell) = frame.camera.project((*mean).into()).and_then(|(u, v, _)| cell_of(u, v)) {
            covered[cell] = true;
        }
    }
    let covered = grown(&covered, columns, rows);
    for cell in (0..columns * rows).filter(|&c| !covered[c]) {
        let side = |k: usize, size: usize| {
            let start = k as f32 * spacing_px;
            [start, (start + spacing_px).min(size as f32)]
        };
        let cell = Cell([side(cell % columns, width), side(cell / columns, height)]);
        let Some([x, y]) = place(cell) else { continue };
        let (x, y) = (x.min(width - 1), y.min(height - 1));
        if frame.mask.at(x, y) {
            push(frame, x, y, spacing_px, settings.default_depth, gaussians);
        }
    }
}

/// Marks the neighbours of covered cells as covered too, so that frames do not seed each other's gaps twice.
fn grown(covered: &[bool], columns: usize, rows: usize) -> Vec<bool> {
    let near = |c: usize| {
        let (x, y) = (c % columns, c / columns);
        (y.saturating_sub(1)..=(y + 1).min(rows - 1))
            .any(|v| (x.saturating_sub(1)..=(x + 1).min(columns - 1)).any(|u| covered[v * columns + u]))
    };
    (0..covered.len()).map(near).collect()
}

fn push(
    frame: &SeedFrame,
    x: usize,
    y: usize,
    spacing_px: f32,
    default_depth: f32,
    gaussians: &mut Gaussians,
) {
    let known = frame.depth.as_ref().map(|d| d.at(x, y)).filter(|z| *z > 0.0 && z.is_finite());
    let depth = known.unwrap_or(default_depth);
    let colour = frame.colour.get_pixel(x as u32, y as u32).0;
    let radius = 0.6 * spacing_px * depth / frame.camera.fx;
    gaussians.means.push(frame.camera.unproject(x as f32 + 0.5, y as f32 + 0.5, depth).into());
    gaussians.rotations.push([1.0, 0.0, 0.0, 0.0]);
    gaussians.log_scales.push([radius.max(1e-6).ln(); 3]);
    gaussians.colours.push(colour.map(|c| (f32::from(c.max(DARKEST)) / 255.0 - 0.5) / SH_C0));
}

#[cfg(test)]
mod tests {
    use super::*;

    fn settings(latent_dim: usize) -> SeedSettings {
        SeedSettings {
            spacing_px: 4.0,
            default_depth: 1.0,
            opacity: 0.6,
            neighbour_sizes: false,
            latent_dim,
            sh_degree: 0,
            seed: 1,
        }
    }

    fn frame(depth: Option<f32>, mask: impl Fn(usize, usize) -> bool) -> SeedFrame {
        let data = (0..48).flat_map(|y| (0..64).map(move |x| (x, y))).map(|(x, y)| mask(x, y)).collect();
        SeedFrame {
            camera: Camera::with_field_of_view(64, 48, 60.0),
            colour: RgbImage::from_fn(64, 48, |x, y| image::Rgb([x as u8, y as u8, 9])),
            mask: Grid::from_vec(64, 48, data),
            depth: depth.map(|d| Grid::filled(64, 48, d)),
        }
    }

    #[test]
    fn every_gaussian_shows_the_pixel_it_came_from() {
        let g = seed(&[frame(Some(5.0), |_, _| true)], &settings(3));
        assert_eq!(g.len(), 16 * 12);
        for (mean, colour) in g.means.iter().zip(&g.colours) {
            let (u, v, z) = Camera::with_field_of_view(64, 48, 60.0).project((*mean).into()).unwrap();
            assert!((z - 5.0).abs() < 1e-4);
            let shown = colour.map(|c| ((0.5 + SH_C0 * c) * 255.0).round() as i32);
            assert_eq!(shown, [(u as i32).max(1), (v as i32).max(1), 9]);
        }
        assert_eq!(g.features.len(), g.len() * 3);
    }

    #[test]
    fn no_gaussian_is_so_black_that_its_colour_has_no_gradient() {
        let black = SeedFrame { colour: RgbImage::new(64, 48), ..frame(None, |_, _| true) };
        let g = seed(&[black], &settings(0));
        let shown: Vec<f32> = g.colours.as_flattened().iter().map(|c| 255.0 * (0.5 + SH_C0 * c)).collect();
        assert!(!shown.is_empty() && shown.iter().all(|c| *c > 0.5 && *c < 1.5), "{shown:?}");
    }

    #[test]
    fn what_chance_misses_is_begun_with_if_nothing_else_is_kept() {
        let few = seed(&[frame(None, |x, y| x == 0 && y % 4 == 0 && y < 12)], &settings(0));
        assert_eq!(few.len(), 3, "one in each cell");
        let camera = Camera::with_field_of_view(64, 48, 60.0);
        assert!(few.means.iter().all(|mean| camera.project((*mean).into()).unwrap().0 < 1.0));
        assert!(seed(&[frame(None, |_, _| false)], &settings(0)).is_empty());
    }

    #[test]
    fn later_frames_only_fill_what_earlier_ones_left() {
        let left = frame(None, |x, _| x < 32);
        let all = frame(None, |_, _| true);
        let once = seed(std::slice::from_ref(&left), &settings(0)).len();
        let both = seed(&[left, all], &settings(0)).len();
        assert_eq!(once, 8 * 12);
        assert_eq!(both, 8 * 12 + 7 * 12);
    }

    #[test]
    fn sizes_follow_from_neighbours() {
        let means: Vec<[f32; 3]> = (0..9).map(|i| [(i % 3) as f32, (i / 3) as f32, 7.0]).collect();
        let sizes = neighbour_log_scales(&means);
        // The middle point has four neighbours at distance 1. A corner has two, and one at √2.
        assert!(sizes[4][0].abs() < 1e-6 && (sizes[0][0] - 0.5 * (4.0f32 / 3.0).ln()).abs() < 1e-6);
        assert!((neighbour_log_scales(&[[1.0; 3]; 5])[0][0] - 0.5 * 1e-7f32.ln()).abs() < 1e-4);
    }
}
