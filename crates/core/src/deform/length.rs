//! Length of recordings: the basis functions that their motion takes, and the loss beyond the longest.

/// Number of frames per basis function of time.
const FRAMES_PER_BASIS: usize = 3;
/// Largest number of basis functions.
const MAX_BASES: usize = 64;
/// Length of the longest recording that has as many basis functions as it needs.
pub(crate) const LONGEST: usize = MAX_BASES * FRAMES_PER_BASIS - 1;
/// Held-out PSNR in dB of the demo after 1500 steps, for several numbers of frames.
const PSNR_OF_LENGTH: [(f64, f64); 5] =
    [(48.0, 36.7), (96.0, 34.9), (200.0, 32.7), (800.0, 24.6), (2000.0, 24.4)];

/// Loss of PSNR in comparison with a recording of [`LONGEST`] frames, dB, as measured on the demo.
fn length_loss_db(num_frames: usize) -> f64 {
    let psnr = |frames: f64| {
        let [(_, first), .., (_, last)] = PSNR_OF_LENGTH;
        let between = PSNR_OF_LENGTH.windows(2).find(|pair| (pair[0].0..pair[1].0).contains(&frames));
        match between {
            Some(pair) => {
                let share = (frames / pair[0].0).ln() / (pair[1].0 / pair[0].0).ln();
                pair[0].1 + share * (pair[1].1 - pair[0].1)
            }
            None => {
                if frames < PSNR_OF_LENGTH[0].0 {
                    first
                } else {
                    last
                }
            }
        }
    };
    (psnr(LONGEST as f64) - psnr(num_frames as f64)).max(0.0)
}

/// Number of basis functions for a recording of `num_frames` frames.
pub(crate) fn default_bases(num_frames: usize) -> usize {
    (num_frames / FRAMES_PER_BASIS + 1).clamp(5, MAX_BASES)
}

/// Warning about the loss on a recording of `num_frames` frames, with the default number of basis functions;
/// `None` if it is not too long.
pub(crate) fn length_warning(num_frames: usize) -> Option<String> {
    if num_frames <= LONGEST {
        return None;
    }
    let every = num_frames.div_ceil(LONGEST);
    Some(format!(
        "The recording has {num_frames} frames, and motion is learned in full up to {LONGEST}: beyond that a reconstruction \
         gets worse, here by about {:.0} dB. Use one frame in {every} (`every = {every}` under `[time]` in its settings file), \
         a part of it (`first` and `last` under `[frames]`), or cut it into parts of at most {LONGEST} frames",
        length_loss_db(num_frames)
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_length_costs_is_told_from_where_bases_run_out() {
        assert_eq!(default_bases(LONGEST), LONGEST / FRAMES_PER_BASIS + 1);
        const { assert!(LONGEST / FRAMES_PER_BASIS < MAX_BASES) };
        const { assert!((LONGEST + 1) / FRAMES_PER_BASIS + 1 > MAX_BASES) };
        assert_eq!(length_warning(LONGEST), None);
        let text = length_warning(800).unwrap();
        assert!(
            text.contains("800 frames") && text.contains("up to 191") && text.contains("about 8 dB"),
            "{text}"
        );
        assert!(text.contains("`every = 5`"), "{text}");
    }

    #[test]
    fn losses_grow_with_length_between_what_was_measured() {
        assert_eq!(length_loss_db(48), 0.0);
        let losses = [192, 250, 400, 800, 1500, 2000, 100_000].map(length_loss_db);
        assert!(losses.is_sorted(), "{losses:?}");
        assert!((losses[3] - losses[5]).abs() < 0.3 && (8.0..8.5).contains(&losses[5]), "{losses:?}");
    }
}
