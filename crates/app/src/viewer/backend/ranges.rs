//! Ranges of frames that are left out, each by its first and last frame, in order and apart.

/// Removes the frames of `out` from the ranges.
pub(crate) fn cut(ranges: &[(usize, usize)], out: (usize, usize)) -> Vec<(usize, usize)> {
    let parts = |&(from, to): &(usize, usize)| {
        let before = out.0.checked_sub(1).map(|end| (from, to.min(end)));
        let after = Some((from.max(out.1 + 1), to));
        [before, after].into_iter().flatten().filter(|(from, to)| from <= to)
    };
    ranges.iter().flat_map(parts).collect()
}

/// Adds `more` to the ranges, keeps them in order, and joins neighbours.
pub(crate) fn joined(mut ranges: Vec<(usize, usize)>, more: (usize, usize)) -> Vec<(usize, usize)> {
    ranges.push(more);
    ranges.sort_unstable();
    let mut whole: Vec<(usize, usize)> = Vec::new();
    for (from, to) in ranges {
        match whole.last_mut() {
            Some(last) if from <= last.1 + 1 => last.1 = last.1.max(to),
            _ => whole.push((from, to)),
        }
    }
    whole
}

/// Limits the ranges to what is possible for `num_frames` frames, because files may hold any values.
pub(crate) fn mended(ranges: Vec<(usize, usize)>, num_frames: usize) -> Vec<(usize, usize)> {
    ranges.into_iter().filter(|(from, to)| from <= to && *to < num_frames).fold(Vec::new(), joined)
}

/// Returns the frames from `from` to `to` that are not excluded.
pub(crate) fn included((from, to): (usize, usize), excluded: &[(usize, usize)]) -> Vec<usize> {
    (from..=to).filter(|frame| !excluded.iter().any(|(a, b)| (*a..=*b).contains(frame))).collect()
}
