//! Exclusive prefix sums of any length (`shaders/scan.wgsl`).

use crate::{
    buffers::DeviceVec,
    device::Gpu,
    kernel::{Kernel, Pass},
    shader::shader,
};
use surgtpgs_core::Result;

shader! {
    pub(super) Wgsl = "scan.wgsl";
    const SCAN_BLOCK = BLOCK;
    var<write> items: [u32];
    var<write> block_sums: [u32];
}

/// Number of items that one workgroup scans: enough that the counts of half a million pairs are one block.
const BLOCK: u32 = 4096;

#[derive(Debug)]
pub(crate) struct Scan {
    scan_blocks: Kernel,
    add_offsets: Kernel,
}

/// Sums of blocks, of blocks of blocks, and so on; the last holds one number, the sum of all.
#[derive(Debug, Default)]
pub(crate) struct Levels(Vec<DeviceVec<u32>>);

impl Levels {
    /// Makes room for a scan of `len` items.
    pub(crate) fn prepare(&mut self, gpu: &Gpu, len: usize) -> Result<()> {
        let mut len = len;
        let mut depth = 0;
        loop {
            len = len.div_ceil(BLOCK as usize).max(1);
            if depth == self.0.len() {
                self.0.push(DeviceVec::new(gpu, "block sums"));
            }
            self.0[depth].resize(gpu, len)?;
            depth += 1;
            if len == 1 {
                self.0.truncate(depth);
                return Ok(());
            }
        }
    }

    /// One number: the sum of all items, after the scan.
    pub(crate) fn total(&self) -> Option<&DeviceVec<u32>> {
        self.0.last()
    }
}

impl Scan {
    pub(crate) fn new(gpu: &Gpu) -> Result<Self> {
        Ok(Self {
            scan_blocks: Kernel::new(gpu, &Wgsl::SHADER, "scan_blocks", 0)?,
            add_offsets: Kernel::new(gpu, &Wgsl::SHADER, "add_offsets", 0)?,
        })
    }

    /// Adds a scan of `items` in place; `levels` must have been prepared for their number.
    pub(crate) fn encode(&self, gpu: &Gpu, pass: &mut Pass<'_>, items: &DeviceVec<u32>, levels: &Levels) {
        let chain: Vec<&DeviceVec<u32>> = std::iter::once(items).chain(&levels.0).collect();
        let steps: Vec<_> = chain.windows(2).map(|pair| (pair[0], pair[1])).collect();
        for (items, sums) in &steps {
            let bindings = [Wgsl::items(items.in_place()), Wgsl::block_sums(*sums)];
            self.scan_blocks.dispatch(gpu, pass, &bindings, sums.len() as u32);
        }
        for (items, sums) in steps.iter().rev().filter(|(_, sums)| sums.len() > 1) {
            let bindings = [Wgsl::items(items.in_place()), Wgsl::block_sums(*sums)];
            self.add_offsets.dispatch(gpu, pass, &bindings, sums.len() as u32);
        }
    }
}
