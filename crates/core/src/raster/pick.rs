//! The Gaussian at one pixel; twin of `shaders/pick.wgsl`.

use super::{MAX_ALPHA, MIN_ALPHA, MIN_TRANSMITTANCE, TILE, bin::Bins, project::Splat};

/// The Gaussian that contributes most to a pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pick {
    /// Index of the Gaussian in the scene.
    pub gaussian: usize,
    /// Its share of the pixel, 0–1.
    pub weight: f32,
    /// Depth of its centre, scene units.
    pub depth: f32,
}

/// Returns the Gaussian at column `x`, row `y`; `None` outside the picture and if nothing contributes.
pub fn pick(splats: &[Splat<f32>], bins: &Bins, [x, y]: [usize; 2]) -> Option<Pick> {
    let (tile_x, tile_y) = (x / TILE, y / TILE);
    if tile_x >= bins.columns || tile_y >= bins.rows {
        return None;
    }
    let mut transmittance = 1.0;
    let mut best: Option<Pick> = None;
    for &gaussian in &bins.splat[bins.tile(tile_x, tile_y)] {
        let s = &splats[gaussian as usize];
        let alpha = s.at_pixel(x, y).1.min(MAX_ALPHA);
        if alpha < MIN_ALPHA {
            continue;
        }
        let weight = alpha * transmittance;
        let next = transmittance - weight;
        if next < MIN_TRANSMITTANCE {
            break;
        }
        if best.is_none_or(|b| weight > b.weight) {
            best = Some(Pick { gaussian: gaussian as usize, weight, depth: s.depth });
        }
        transmittance = next;
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::raster::bin::bin;

    fn splat(x: f32, depth: f32, opacity: f32) -> Splat<f32> {
        let (centre, conic, colour) = ([x, 8.0], [0.1, 0.0, 0.1], [0.5; 3]);
        Splat { centre, conic, depth, opacity, colour, extent: [8.0; 2] }
    }

    #[test]
    fn the_largest_share_wins_not_the_nearest() {
        let splats = [splat(8.0, 3.0, 0.9), splat(8.0, 1.0, 0.1), splat(8.0, 5.0, 0.9)];
        let bins = bin(&splats, 40, 20);
        let found = pick(&splats, &bins, [8, 8]).unwrap();
        assert_eq!((found.gaussian, found.depth), (0, 3.0));
        assert!((found.weight - 0.9 * 0.9).abs() < 0.05, "{}", found.weight);
        assert_eq!(pick(&splats, &bins, [39, 19]), None);
        assert_eq!(pick(&splats, &bins, [400, 8]), None);
    }
}
