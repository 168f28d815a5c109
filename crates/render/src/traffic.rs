//! Bytes that go to and from a device, and the bandwidth of its memory.

use crate::{
    buffers::{DeviceVec, max_bytes},
    device::Gpu,
    kernel::{Kernel, run},
    shader::{GROUP, shader},
};
use std::{
    sync::atomic::{AtomicU64, Ordering},
    time::Instant,
};
use surgtpgs_core::Result;

/// Number of bytes that crossed between this program and a device since the device was opened.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Traffic {
    /// Bytes written to the device.
    pub uploaded: u64,
    /// Bytes copied out of it.
    pub read_back: u64,
}

impl Traffic {
    /// Returns the bytes that crossed after `earlier`.
    pub fn since(&self, earlier: &Self) -> Self {
        Self { uploaded: self.uploaded - earlier.uploaded, read_back: self.read_back - earlier.read_back }
    }
}

/// Counters behind [`Traffic`], shared by all clones of a device.
#[derive(Debug, Default)]
pub(crate) struct Counters {
    uploaded: AtomicU64,
    read_back: AtomicU64,
}

impl Counters {
    pub(crate) fn count_upload(&self, bytes: usize) {
        self.uploaded.fetch_add(bytes as u64, Ordering::Relaxed);
    }

    pub(crate) fn count_read_back(&self, bytes: u64) {
        self.read_back.fetch_add(bytes, Ordering::Relaxed);
    }

    pub(crate) fn total(&self) -> Traffic {
        let of = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        Traffic { uploaded: of(&self.uploaded), read_back: of(&self.read_back) }
    }
}

shader! {
    pub(crate) Wgsl = "copy.wgsl";
    var<read> source: [[f32; 4]];
    var<write> copied: [[f32; 4]];
}

/// Bytes of an array that is copied to measure the bandwidth: more than a cache holds. A software adapter has
/// the CPU's caches and bandwidth.
const COPIED_BYTES: u64 = 256 << 20;
const COPIED_BYTES_IN_SOFTWARE: u64 = 32 << 20;
/// Number of copies in one submission, which makes the time of the submission itself negligible.
const COPIES: u64 = 16;
/// Number of submissions, of which the fastest counts: nothing but disturbances make one slower.
const ROUNDS: usize = 5;

impl Gpu {
    /// Measures the bandwidth of the device's memory by copying an array, bytes read and written a second. No
    /// pass can be faster than the bytes that it must move at this bandwidth, unless they stay in a cache.
    ///
    /// A shader copies: the driver's own way to copy came to 843 of 3023 GB/s on an NVIDIA H200.
    pub fn copy_bandwidth(&self) -> Result<f64> {
        self.guarded(|| {
            let wanted = if self.is_software() { COPIED_BYTES_IN_SOFTWARE } else { COPIED_BYTES };
            let len = (wanted.min(max_bytes(self)) / size_of::<[f32; 4]>() as u64) as usize;
            let kernel = Kernel::new(self, &Wgsl::SHADER, "copy", 0)?;
            let [mut source, mut copied] =
                ["the bandwidth's source", "its copy"].map(|name| DeviceVec::new(self, name));
            source.resize(self, len)?;
            copied.resize(self, len)?;
            let bindings = [Wgsl::source(&source), Wgsl::copied(&copied)];
            let groups = (len as u32).div_ceil(GROUP);
            let mut fastest = f64::INFINITY;
            // The first submission clears the arrays.
            for _ in 0..=ROUNDS {
                let started = Instant::now();
                run(self, |pass| (0..COPIES).for_each(|_| kernel.dispatch(self, pass, &bindings, groups)));
                self.wait()?;
                fastest = fastest.min(started.elapsed().as_secs_f64());
            }
            Ok((2 * source.num_bytes() * COPIES) as f64 / fastest.max(1e-9))
        })
    }
}
