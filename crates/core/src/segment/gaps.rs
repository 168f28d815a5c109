//! What no mask covers: dim, even surfaces that a network is unsure of when it is asked at one point. Asked at several
//! points that must belong together, it usually finds them.

use super::{
    BitMask, FoundMask, MaskSettings, PointSegmenter,
    generate::answers,
    regions::{largest_island, without_small_regions},
};
use crate::{
    Result,
    grid::{Grid, Mask},
    mask::PixelRect,
};

/// Gaps below this share of the pixels that matter are left alone.
const MIN_SHARE: f64 = 0.01;
/// Points per prompt.
const POINTS: usize = 3;
/// Share of an answer, and of the gap, that they must have in common.
const MIN_SHARED: f64 = 0.5;
/// The network's rating of an answer must be above this: half of what the grid's answers need.
const MIN_PREDICTED_IOU: f32 = 0.35;

/// Masks for the largest gaps between `masks`, each without what other masks cover.
pub(super) fn fill(
    segmenter: &mut dyn PointSegmenter,
    masks: &[FoundMask],
    keep: &Mask,
    settings: &MaskSettings,
) -> Result<Vec<FoundMask>> {
    let (width, height) = (keep.width, keep.height);
    let mut open = keep.clone();
    masks.iter().flat_map(|f| f.mask.pixels()).for_each(|(x, y)| open.set(x, y, false));
    let least_px = ((keep.count() as f64 * MIN_SHARE) as usize).max(settings.min_region_px);
    let whole = PixelRect { x: 0, y: 0, width, height };
    let mut filled: Vec<FoundMask> = Vec::new();
    for _ in 0..settings.gap_prompts {
        let Some(gap) = largest_part(&open, least_px) else { break };
        let prompt = vec![points_inside(&gap)];
        let answers = answers(segmenter, &prompt, [width, height], whole, settings)?;
        let fits = |mask: &BitMask| {
            let with_open = mask.pixels().filter(|&(x, y)| open.at(x, y)).count() as f64;
            let with_gap = mask.pixels().filter(|&(x, y)| gap.at(x, y)).count() as f64;
            with_open >= MIN_SHARED * mask.area_px() as f64 && with_gap >= MIN_SHARED * gap.count() as f64
        };
        let fitting = answers.into_iter().map(|(_, f)| f);
        let best = fitting
            .filter(|f| f.predicted_iou > MIN_PREDICTED_IOU && fits(&f.mask))
            .max_by(|a, b| a.predicted_iou.total_cmp(&b.predicted_iou));
        let taken = best.as_ref().and_then(|best| only_where(&best.mask, &open));
        // A gap without a good answer is not asked about again.
        let closed = taken.as_ref().map_or(gap, BitMask::to_mask);
        open.data.iter_mut().zip(&closed.data).for_each(|(open, closed)| *open &= !closed);
        let mend = |mask: BitMask| without_small_regions(&mask, settings.min_region_px).unwrap_or(mask);
        filled.extend(taken.zip(best).map(|(mask, best)| FoundMask { mask: mend(mask), ..best }));
    }
    Ok(filled)
}

fn only_where(mask: &BitMask, open: &Mask) -> Option<BitMask> {
    let mut left = Grid::filled(open.width, open.height, false);
    mask.pixels().filter(|&(x, y)| open.at(x, y)).for_each(|(x, y)| left.set(x, y, true));
    BitMask::of(&left)
}

/// The largest part that hangs together by more than a thread; `None` if it has fewer than `least_px` pixels.
fn largest_part(open: &Mask, least_px: usize) -> Option<Mask> {
    /// Threads up to twice this width do not join parts, in pixels.
    const THREAD_PX: u32 = 4;
    let depths = depths(open);
    let thick = BitMask::of(&depths.map(|depth| *depth > THREAD_PX))?;
    // Back to the width it had.
    let core = largest_island(&thick).to_mask();
    let near = self::depths(&core.map(|inside| !inside));
    let mut part = open.clone();
    part.data.iter_mut().zip(&near.data).for_each(|(part, near)| *part &= *near <= THREAD_PX);
    (part.count() >= least_px).then_some(part)
}

/// For each `true` pixel the number of steps (right, left, up, down) to the nearest `false` one; the image's border
/// counts as `true`. 0 for `false`.
fn depths(mask: &Mask) -> Grid<u32> {
    let far = (mask.width + mask.height) as u32;
    let mut depths = mask.map(|inside| if *inside { far } else { 0 });
    let (w, h) = (mask.width, mask.height);
    let mut step = |i: usize, neighbour: Option<usize>| {
        if let Some(n) = neighbour {
            depths.data[i] = depths.data[i].min(depths.data[n] + 1);
        }
    };
    for i in 0..w * h {
        step(i, (i % w > 0).then(|| i - 1));
        step(i, i.checked_sub(w));
    }
    for i in (0..w * h).rev() {
        step(i, (i % w + 1 < w).then_some(i + 1));
        step(i, (i + w < w * h).then_some(i + w));
    }
    depths
}

/// Points deep inside the part and far from each other, in pixels.
fn points_inside(part: &Mask) -> Vec<[f32; 2]> {
    let depths = depths(part);
    let w = part.width;
    let place = |i: usize| [(i % w) as f32 + 0.5, (i / w) as f32 + 0.5];
    let distance = |a: [f32; 2], b: [f32; 2]| ((a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2)).sqrt();
    let mut points: Vec<[f32; 2]> = Vec::new();
    for _ in 0..POINTS {
        // Far from the others counts as far as the point is three times less deep.
        let worth = |i: usize| {
            let depth = depths.data[i] as f32;
            points.iter().map(|p| distance(*p, place(i))).fold(3.0 * depth, f32::min)
        };
        let inside = (0..part.data.len()).filter(|&i| part.data[i]);
        points.extend(inside.max_by(|&a, &b| worth(a).total_cmp(&worth(b))).map(place));
    }
    points
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(rows: &[&str]) -> Mask {
        let data = rows.iter().flat_map(|r| r.chars().map(|c| c == '#')).collect();
        Grid::from_vec(rows[0].len(), rows.len(), data)
    }

    #[test]
    fn depths_count_steps_to_the_outside() {
        let depths = depths(&image(&["#####", "#####", "##.##"]));
        assert_eq!(depths.data, [4, 3, 2, 3, 4, 3, 2, 1, 2, 3, 2, 1, 0, 1, 2]);
    }

    /// Two squares of 30 and 20 pixels joined by a bridge three wide.
    fn dumbbell() -> Mask {
        let inside = |i: usize| {
            let (x, y) = (i % 100, i / 100);
            let bridge = (30..60).contains(&x) && (10..13).contains(&y);
            (x < 30 && y < 30) || ((60..80).contains(&x) && y < 20) || bridge
        };
        Grid::from_vec(100, 40, (0..4000).map(inside).collect())
    }

    #[test]
    fn threads_do_not_join_parts() {
        let part = largest_part(&dumbbell(), 100).unwrap();
        assert!((850..1000).contains(&part.count()), "{}", part.count());
        assert!(!part.at(70, 10), "the other square is another part");
        assert!(largest_part(&dumbbell(), 2000).is_none());
        assert!(largest_part(&Grid::filled(9, 9, false), 1).is_none());
    }

    #[test]
    fn points_lie_deep_and_apart() {
        let part = largest_part(&dumbbell(), 100).unwrap();
        let points = points_inside(&part);
        assert_eq!(points.len(), POINTS);
        for (i, p) in points.iter().enumerate() {
            assert!(part.at(p[0] as usize, p[1] as usize));
            let apart = |q: &[f32; 2]| (p[0] - q[0]).hypot(p[1] - q[1]) > 6.0;
            assert!(points[..i].iter().all(apart), "{points:?}");
        }
    }
}
