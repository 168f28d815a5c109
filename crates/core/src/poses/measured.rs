//! Depth at the points that are followed, where the recording has some.

use super::{adjust::Landmark, lens::Lens, tracks::Track};
use crate::{Result, grid::Grid, num::median, sequence::Sequence};

/// Largest ratio of the depths around a point: beyond it, one of them is of another surface.
const SAME_SURFACE: f32 = 1.1;

/// Returns the typical depth of the points, in units of the recording; `None` if it has no depth. If that was
/// measured, every observation gets its own, in units of the typical one: what a network estimates is for the
/// scale alone. `used` are the frames of the tracks.
///
/// # Errors
/// A depth map that cannot be read.
pub(super) fn take(
    landmarks: &mut [Landmark],
    tracks: &[Track],
    lens: &Lens,
    sequence: &Sequence,
    used: &[usize],
) -> Result<Option<f64>> {
    if !sequence.has_depth() {
        return Ok(None);
    }
    let mut seen: Vec<Vec<(usize, usize)>> = vec![Vec::new(); used.len()];
    for (mark, track) in tracks.iter().enumerate() {
        track.iter().enumerate().for_each(|(k, (slot, _))| seen[*slot].push((mark, k)));
    }
    let mut depths = Vec::new();
    for (&frame, seen) in used.iter().zip(&seen) {
        let Some(map) = sequence.depth(frame)? else { continue };
        for &(mark, k) in seen {
            let depth = depth_at(&map, lens.pixel(tracks[mark][k].1));
            landmarks[mark].observations[k].depth = depth;
            depths.extend(depth);
        }
    }
    let typical = median(&mut depths);
    let is_measured = sequence.depth_origin().is_measured();
    for observation in landmarks.iter_mut().flat_map(|mark| &mut mark.observations) {
        observation.depth =
            observation.depth.filter(|_| is_measured).zip(typical).map(|(depth, typical)| depth / typical);
    }
    Ok(typical)
}

/// Returns the depth of a pixel; `None` if it or one beside it is not known, or is of another surface.
fn depth_at(map: &Grid<f32>, [u, v]: [f64; 2]) -> Option<f64> {
    let [x, y] = [u, v].map(|p| p.floor().max(0.0) as usize);
    if x == 0 || y == 0 || x + 1 >= map.width || y + 1 >= map.height {
        return None;
    }
    let around = || (y - 1..=y + 1).flat_map(|y| (x - 1..=x + 1).map(move |x| map.at(x, y)));
    let (near, far) = around().fold((f32::MAX, 0.0_f32), |(near, far), z| (near.min(z), far.max(z)));
    (near > 0.0 && far <= SAME_SURFACE * near).then(|| f64::from(map.at(x, y)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn depth_at_an_edge_or_beside_a_hole_is_not_known() {
        let mut map = Grid::filled(9, 9, 80.0);
        map.data[2 * 9 + 2] = 0.0;
        map.data[7 * 9 + 7] = 120.0;
        assert_eq!(depth_at(&map, [5.5, 4.2]), Some(80.0));
        for hidden in [[3.5, 2.5], [6.5, 7.5], [0.2, 4.0], [4.0, 8.9], [-1.0, 4.0]] {
            assert_eq!(depth_at(&map, hidden), None, "{hidden:?}");
        }
    }
}
