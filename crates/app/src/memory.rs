//! Memory that the system reports (Linux; elsewhere nothing is known), and checks that it is enough
//! for work to come.

use std::path::Path;
use surgtpgs_core::{
    Error, Result,
    deform::stride_for,
    scene::{RELEASED_BASES, Scene},
    sequence::Sequence,
    train::{REFIT_FRAME_BYTES, TrainSettings},
};

/// Returns the most memory this process has had, bytes.
pub fn peak_rss_bytes() -> Option<u64> {
    field(&read("/proc/self/status")?, "VmHWM:")
}

/// Starts the measurement of [`peak_rss_bytes`] anew, where the system can do that.
pub fn forget_peak() {
    let _ = std::fs::write("/proc/self/clear_refs", "5");
}

/// Gives memory that nothing uses back to the system. GNU's C library keeps what a training had.
pub(crate) fn give_back() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    #[expect(
        unsafe_code,
        reason = "552 MB became 400 MB in the window after training on 63 frames of 640×512"
    )]
    // SAFETY: it takes no pointers, and may be called at any time and from any thread.
    unsafe {
        libc::malloc_trim(0);
    }
}

/// Returns the memory that is left for this program, bytes: what the system can give before it has to write
/// memory to disk or to end a program, at most what the container or job may have, and at most what the
/// process's own limit leaves.
pub fn available_bytes() -> Option<u64> {
    let free = field(&read("/proc/meminfo")?, "MemAvailable:");
    let group =
        read("/proc/self/cgroup").and_then(|groups| left_of_groups(Path::new("/sys/fs/cgroup"), &groups));
    let own = address_space_left().map(|left| left.saturating_sub(LATER_THREADS * ARENA));
    [free, group, own].into_iter().flatten().min()
}

/// Returns the addresses that the process's own limit leaves, bytes; `None` without a limit.
fn address_space_left() -> Option<u64> {
    let most = field_bytes(&read("/proc/self/limits")?, "Max address space ")?;
    Some(most.saturating_sub(field(&read("/proc/self/status")?, "VmSize:")?))
}

/// Returns the memory that the process's control groups leave it, bytes: the least of what each group, and
/// those above it, leave. `groups` is /proc/self/cgroup, of either version: `0::/job` or `4:memory:/job`.
fn left_of_groups(root: &Path, groups: &str) -> Option<u64> {
    let lefts = groups.lines().filter_map(|line| {
        let (controllers, group) = line.split_once(':')?.1.split_once(':')?;
        let (root, files) = match controllers {
            "" => (root.to_owned(), ["memory.max", "memory.current", "inactive_file ", "active_file "]),
            c if c.split(',').any(|c| c == "memory") => (
                root.join("memory"),
                [
                    "memory.limit_in_bytes",
                    "memory.usage_in_bytes",
                    "total_inactive_file ",
                    "total_active_file ",
                ],
            ),
            _ => return None,
        };
        let own = root.join(group.trim_start_matches('/'));
        own.ancestors().take_while(|folder| folder.starts_with(&root)).filter_map(|g| left_of(g, files)).min()
    });
    lefts.min()
}

/// Returns the memory that a group leaves: its limit less its use, where cached files do not count as used.
fn left_of(group: &Path, [most, used, inactive, active]: [&str; 4]) -> Option<u64> {
    let read = |file: &str| std::fs::read_to_string(group.join(file)).ok();
    let stat = read("memory.stat")?;
    let cached: u64 = [inactive, active].iter().filter_map(|name| field_bytes(&stat, name)).sum();
    Some(number(&read(most)?)?.saturating_add(cached).saturating_sub(number(&read(used)?)?))
}

/// Addresses that the C library sets aside for a thread that asks for memory, bytes.
const ARENA: u64 = 64 << 20;
/// Number of threads besides those that compute: they wait for signals, draw, and read.
const LATER_THREADS: u64 = 3;
/// Share of the addresses left by a limit that computing threads set aside at most: one in this number.
const SHARE_OF_THREADS: u64 = 4;

/// Starts the threads that compute: one for each processor, fewer if a limit on addresses leaves no room for
/// them. The addresses that they set aside are taken at once, so that [`available_bytes`] counts them.
pub fn start_threads() -> Result<()> {
    // A thread that finds no memory for its stack ends the program.
    require("any work", ANY_WORK + ARENA, available_bytes())?;
    let all = std::thread::available_parallelism().map_or(1, usize::from);
    let room = address_space_left().map_or(u64::MAX, |left| left / SHARE_OF_THREADS / ARENA).max(1);
    let mut pool = rayon::ThreadPoolBuilder::new();
    // A number that the user has set is kept.
    if std::env::var_os("RAYON_NUM_THREADS").is_none() {
        pool = pool.num_threads(all.min(usize::try_from(room).unwrap_or(usize::MAX)));
    }
    // It is fine if the threads run already.
    if let Err(e) = pool.build_global()
        && std::error::Error::source(&e).is_some()
    {
        return Err(Error::Missing {
            what: format!("the threads that compute could not be started ({e})"),
            hint: "There is too little memory, or a limit (`ulimit -v`, `ulimit -u`) is too low.".into(),
        });
    }
    rayon::broadcast(|_| std::hint::black_box(vec![0_u8; 4096]).len());
    // Small files are read before a verb knows what its work takes.
    require("any work", ANY_WORK, available_bytes())
}

/// Bytes that each pixel was seen to take, on pictures of 1024×1024 to 8192×8192 with a Gaussian for every 14
/// pixels: all images of one view, asked and written; all passes of a training step, both ways.
const SHOWN_PIXEL: u64 = 130;
const TRAINED_PIXEL: u64 = 250;
/// Bytes that each pixel of a frame takes at least for each name that is carried to it: a share and a score.
const MARKED_PIXEL: u64 = 8;
/// Bytes for each pixel of a decoded frame, of full and half size.
const CACHED_PIXEL: u64 = 13;
/// Bytes for each pixel of a frame with its mask, depth and labels, as often as frames are read side by side.
const READ_PIXEL: u64 = 8 * 16;
/// Bytes that a verb takes of its own: tables, a text encoder, caches of libraries.
const ANY_WORK: u64 = 48 << 20;
/// Count of numbers kept for every number that is learned: itself, its gradient, and two means.
const LEARNED: u64 = 4;

/// Work to be done, as far as memory goes.
pub enum Work<'a> {
    /// A scene file is read, and perhaps written in another form.
    Scene(&'a Path),
    /// Pictures of this size are rendered.
    Pictures(u32, u32),
    /// Marks of this number of names are carried to frames of this size.
    Marks(u32, u32, usize),
    /// The frames of a recording are read.
    Reading(&'a Sequence),
    /// A recording of this size is made.
    Recording(u32, u32),
    /// A recording is trained on.
    Training(&'a Sequence, &'a TrainSettings),
    /// Another form of a scene is fitted to its pictures.
    Fitting(&'a Scene),
}

/// Fails if the work takes more than the memory that is left; every verb and the window ask before it begins.
pub fn require_for(work: &Work<'_>) -> Result<()> {
    let (what, bytes) = match *work {
        Work::Scene(path) => ("reading the scene".into(), 3 * Scene::read_bytes(path)),
        Work::Pictures(width, height) => {
            (format!("rendering {width}×{height} pixels"), u64::from(width) * u64::from(height) * SHOWN_PIXEL)
        }
        Work::Marks(width, height, names) => {
            let pixels = u64::from(width) * u64::from(height);
            (format!("carrying marks of {names} names"), pixels * names as u64 * MARKED_PIXEL)
        }
        Work::Reading(sequence) => {
            (format!("reading {} frames", size(sequence)), pixels(sequence) * READ_PIXEL)
        }
        Work::Recording(width, height) => {
            (format!("recording {width}×{height} pixels"), u64::from(width) * u64::from(height) * SHOWN_PIXEL)
        }
        Work::Training(sequence, settings) => {
            (format!("training on {} pixels", size(sequence)), training_bytes(sequence, settings))
        }
        Work::Fitting(scene) => {
            (format!("fitting {} Gaussians", scene.gaussians.len()), fitting_bytes(scene))
        }
    };
    require(&what, bytes.saturating_add(ANY_WORK), available_bytes())?;
    match *work {
        // The memory for the scene itself is known once the file is looked at.
        Work::Scene(path) => {
            require(&what, Scene::memory_bytes(path).saturating_add(ANY_WORK), available_bytes())
        }
        _ => Ok(()),
    }
}

fn pixels(sequence: &Sequence) -> u64 {
    (sequence.width() * sequence.height()) as u64
}

fn size(sequence: &Sequence) -> String {
    format!("{}×{}", sequence.width(), sequence.height())
}

fn training_bytes(sequence: &Sequence, settings: &TrainSettings) -> u64 {
    let (pixels, frames) = (pixels(sequence), settings.frames_together(sequence.num_frames()));
    let cached = (pixels * frames as u64 * CACHED_PIXEL).min(settings.frame_cache_bytes as u64);
    let densify = &settings.densify;
    let room = pixels as f64 / f64::from(densify.min_px_per_gaussian.max(1.0));
    let gaussians = (room as u64).min(densify.max_gaussians as u64);
    let weights = settings.num_bases(frames) as u64 * stride_for(LATENT_DIM) as u64 * size_of::<f32>() as u64;
    pixels * TRAINED_PIXEL + cached + gaussians * weights * LEARNED
}

fn fitting_bytes(scene: &Scene) -> u64 {
    let pixels = scene.cameras.first().map_or(0, |c| u64::from(c.width) * u64::from(c.height));
    let frames = (pixels * scene.num_frames() as u64 * CACHED_PIXEL).min(REFIT_FRAME_BYTES as u64);
    let weights = (RELEASED_BASES * stride_for(LATENT_DIM) * size_of::<f32>()) as u64;
    pixels * TRAINED_PIXEL + frames + scene.gaussians.len() as u64 * weights * LEARNED
}

/// Latent dimension of most recordings.
pub(crate) const LATENT_DIM: usize = 3;

fn require(work: &str, bytes: u64, available: Option<u64>) -> Result<()> {
    match available {
        Some(left) if left < bytes => Err(Error::Missing {
            what: format!("{work} takes about {} MB of memory, {} MB are left", bytes >> 20, left >> 20),
            hint: "Close other programs, raise the limit where there is one, or use smaller pictures".into(),
        }),
        _ => Ok(()),
    }
}

fn read(path: &str) -> Option<String> {
    std::fs::read_to_string(path).ok()
}

/// Returns the value of a line such as "MemAvailable:  1024 kB", in bytes.
fn field(text: &str, name: &str) -> Option<u64> {
    field_bytes(text, name).map(|kib| kib * 1024)
}

/// Returns the value of a line such as "inactive_file 1024".
fn field_bytes(text: &str, name: &str) -> Option<u64> {
    number(text.lines().find_map(|l| l.strip_prefix(name))?)
}

/// Returns the first word, if it is a number and not, for example, "unlimited".
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
    fn the_groups_of_a_container_and_those_above_count() {
        let root = tempfile::tempdir().unwrap();
        let write = |group: &str, files: &[(&str, &str)]| {
            let folder = root.path().join(group);
            std::fs::create_dir_all(&folder).unwrap();
            files.iter().for_each(|(name, text)| std::fs::write(folder.join(name), text).unwrap());
        };
        let left = |groups: &str| left_of_groups(root.path(), groups);
        let stat = (
            "memory.stat",
            "anon 5\ninactive_file 70\nactive_file 30\ntotal_inactive_file 6\ntotal_active_file 4\n",
        );
        write("a", &[("memory.max", "3000\n"), ("memory.current", "1000\n"), stat]);
        write("a/b", &[("memory.max", "max\n"), ("memory.current", "900\n"), stat]);
        write("a/c", &[("memory.max", "1000\n"), ("memory.current", "900\n"), stat]);
        write("memory/d", &[("memory.limit_in_bytes", "500\n"), ("memory.usage_in_bytes", "450\n"), stat]);
        assert_eq!((left("0::/a/b\n"), left("0::/a/c\n")), (Some(2100), Some(200)));
        assert_eq!(left("9:name=systemd:/x\n4:cpu,memory:/d/not/there\n0::/\n"), Some(60));
        assert_eq!((left("0::/\n"), left("1:cpu:/a\n"), left("")), (None, None, None));
    }

    #[test]
    fn what_does_not_fit_is_refused_before() {
        let message = require("training", 3 << 30, Some(1 << 30)).unwrap_err().to_string();
        assert!(message.contains("training takes about 3072 MB of memory, 1024 MB are left"), "{message}");
        assert!(require("training", 1 << 30, Some(1 << 30)).is_ok());
        assert!(require("training", u64::MAX, None).is_ok(), "where nothing is known nothing is refused");
        let marks = |names: usize| require_for(&Work::Marks(8192, 8192, names)).map_err(|e| e.to_string());
        if cfg!(target_os = "linux") {
            assert!(marks(1_000_000).unwrap_err().contains("carrying marks of 1000000 names takes about"));
        }
    }
}
