//! What the system tells about memory (Linux; elsewhere nothing is known), and whether it is enough for work to come.

use surgtpgs_core::{Error, Result, sequence::Sequence, train::TrainSettings};

/// The most memory this process has had, bytes.
pub fn peak_rss_bytes() -> Option<u64> {
    field(&read("/proc/self/status")?, "VmHWM:")
}

/// From now on [`peak_rss_bytes`] is about what comes, where the system can do that.
pub fn forget_peak() {
    let _ = std::fs::write("/proc/self/clear_refs", "5");
}

/// Memory that is left for this program, bytes: before the system has to write it to disk or to end a program, within what
/// the container or job may have, and within the process's own limit.
pub fn available_bytes() -> Option<u64> {
    let free = field(&read("/proc/meminfo")?, "MemAvailable:");
    let group = || {
        let [most, used] =
            ["memory.max", "memory.current"].map(|file| read(&format!("/sys/fs/cgroup/{file}")));
        // What is only cached can be had.
        let cached = field_bytes(&read("/sys/fs/cgroup/memory.stat")?, "inactive_file ")?;
        Some((number(&most?)? + cached).saturating_sub(number(&used?)?))
    };
    let own = || {
        let most = field_bytes(&read("/proc/self/limits")?, "Max address space ")?;
        Some(most.saturating_sub(field(&read("/proc/self/status")?, "VmSize:")?))
    };
    [free, group(), own()].into_iter().flatten().min()
}

/// What each pixel was seen to take, bytes, on pictures of 1024×1024 to 8192×8192 with a Gaussian for every 14 pixels: all
/// images of one view, asked and written; all passes of a training step, both ways.
const SHOWN_PIXEL: u64 = 130;
const TRAINED_PIXEL: u64 = 250;
/// A decoded frame, of full and half size.
const CACHED_PIXEL: u64 = 13;

/// Errs where pictures of this size are too large to be rendered in the memory that is left.
pub fn require_for_pictures(width: u32, height: u32) -> Result<()> {
    let pixels = u64::from(width) * u64::from(height);
    require(&format!("rendering {width}×{height} pixels"), pixels * SHOWN_PIXEL, available_bytes())
}

/// Errs where training on the recording takes more than the memory that is left.
pub fn require_for_training(sequence: &Sequence, settings: &TrainSettings) -> Result<()> {
    let (width, height) = (sequence.width(), sequence.height());
    let pixels = (width * height) as u64;
    let frames =
        (pixels * sequence.num_frames() as u64 * CACHED_PIXEL).min(settings.frame_cache_bytes as u64);
    require(
        &format!("training on {width}×{height} pixels"),
        pixels * TRAINED_PIXEL + frames,
        available_bytes(),
    )
}

fn require(work: &str, bytes: u64, available: Option<u64>) -> Result<()> {
    match available {
        Some(left) if left < bytes => Err(Error::Missing {
            what: format!("{work} takes about {} MB of memory, {} MB are left", bytes >> 20, left >> 20),
            hint: "Close other programs, or use smaller pictures".into(),
        }),
        _ => Ok(()),
    }
}

fn read(path: &str) -> Option<String> {
    std::fs::read_to_string(path).ok()
}

/// A line such as "MemAvailable:  1024 kB", in bytes.
fn field(text: &str, name: &str) -> Option<u64> {
    field_bytes(text, name).map(|kib| kib * 1024)
}

/// A line such as "inactive_file 1024".
fn field_bytes(text: &str, name: &str) -> Option<u64> {
    number(text.lines().find_map(|l| l.strip_prefix(name))?)
}

/// The first word, if it is a number and not, for example, "unlimited".
fn number(text: &str) -> Option<u64> {
    text.split_whitespace().next()?.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_field_is_found_by_its_name() {
        let text =
            "MemTotal:       4 kB\nMemAvailable:   3 kB\nMax address space  unlimited  unlimited  bytes\n";
        assert_eq!(field(text, "MemAvailable:"), Some(3072));
        assert_eq!((field(text, "Swap:"), field("MemAvailable: much", "MemAvailable:")), (None, None));
        assert_eq!(
            (field_bytes(text, "Max address space "), number("max\n"), number("17\n")),
            (None, None, Some(17))
        );
        if cfg!(target_os = "linux") {
            assert!(peak_rss_bytes().unwrap() > 1_000_000 && available_bytes().unwrap() > 1_000_000);
        }
    }

    #[test]
    fn what_does_not_fit_is_refused_before() {
        let message = require("training", 3 << 30, Some(1 << 30)).unwrap_err().to_string();
        assert!(message.contains("training takes about 3072 MB of memory, 1024 MB are left"), "{message}");
        assert!(require("training", 1 << 30, Some(1 << 30)).is_ok());
        assert!(require("training", u64::MAX, None).is_ok(), "where nothing is known nothing is refused");
    }
}
