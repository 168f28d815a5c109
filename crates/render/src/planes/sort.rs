//! Stable radix sort of (key, value) pairs (`shaders/sort.wgsl`).

use super::scan::{Levels, Scan};
use crate::{
    buffers::{DeviceVec, uniform},
    device::Gpu,
    kernel::{Kernel, Pass},
    shader::{shader, shader_struct},
};
use surgtpgs_core::Result;

shader! {
    pub(super) Wgsl = "sort.wgsl";
    const SORT_GROUP = GROUP;
    const SORT_BLOCK = BLOCK;
    var<uniform> params: SortParams;
    /// Number of pairs that were wanted; may exceed the capacity.
    var<read> num_pairs_wanted: [u32];
    var<read> keys_in: [u32];
    var<read> values_in: [u32];
    var<write> keys_out: [u32];
    var<write> values_out: [u32];
    /// [DIGITS][num_blocks]: counts; after the scan the places of each block's pairs with that digit.
    var<write> places: [u32];
}

shader_struct! {
    /// One pass of the radix sort.
    pub(crate) struct SortParams {
        /// Lowest bit of the digit.
        shift: u32,
        /// Number of blocks of the whole capacity.
        num_blocks: u32,
        /// Number of pairs that fit.
        capacity: u32,
        /// Padding to a multiple of 16 bytes.
        padding: u32,
    }
}

const DIGIT_BITS: u32 = 4;
/// Invocations per workgroup: few enough that their counters fit into 16 KiB of workgroup memory.
const GROUP: u32 = 128;
/// Number of pairs that one workgroup sorts.
const BLOCK: u32 = 2048;

#[derive(Debug)]
pub(crate) struct Sort {
    histogram: Kernel,
    scatter: Kernel,
}

/// Two places for the pairs; each pass sorts them from one into the other.
#[derive(Debug)]
pub(crate) struct SortBuffers {
    keys: [DeviceVec<u32>; 2],
    values: [DeviceVec<u32>; 2],
    places: DeviceVec<u32>,
    levels: Levels,
    /// Index of the place that holds the pairs.
    current: usize,
}

impl SortBuffers {
    pub(crate) fn new(gpu: &Gpu) -> Self {
        let array = || DeviceVec::new(gpu, "splat-tile pairs");
        Self {
            keys: [array(), array()],
            values: [array(), array()],
            places: array(),
            levels: Levels::default(),
            current: 0,
        }
    }

    /// Makes room for `capacity` pairs, to be written before the sort.
    pub(crate) fn prepare(&mut self, gpu: &Gpu, capacity: usize) -> Result<()> {
        for array in self.keys.iter_mut().chain(&mut self.values) {
            array.resize(gpu, capacity)?;
        }
        let places = capacity.div_ceil(BLOCK as usize).max(1) << DIGIT_BITS;
        self.places.resize(gpu, places)?;
        self.levels.prepare(gpu, places)?;
        self.current = 0;
        Ok(())
    }

    pub(crate) fn keys(&self) -> &DeviceVec<u32> {
        &self.keys[self.current]
    }

    pub(crate) fn values(&self) -> &DeviceVec<u32> {
        &self.values[self.current]
    }
}

impl Sort {
    pub(crate) fn new(gpu: &Gpu) -> Result<Self> {
        Ok(Self {
            histogram: Kernel::new(gpu, &Wgsl::SHADER, "histogram", 0)?,
            scatter: Kernel::new(gpu, &Wgsl::SHADER, "scatter", 0)?,
        })
    }

    /// Adds a stable sort by the lowest `key_bits` bits of the first `num_pairs_wanted[0]` pairs, as far as
    /// they fit.
    pub(crate) fn encode(
        &self,
        gpu: &Gpu,
        pass: &mut Pass<'_>,
        scan: &Scan,
        buffers: &mut SortBuffers,
        num_pairs_wanted: &DeviceVec<u32>,
        key_bits: u32,
    ) {
        let capacity = buffers.keys[0].len() as u32;
        let num_blocks = capacity.div_ceil(BLOCK);
        for shift in (0..key_bits).step_by(DIGIT_BITS as usize) {
            let params = uniform(gpu, &SortParams { shift, num_blocks, capacity, padding: 0 });
            let (from, to) = (buffers.current, 1 - buffers.current);
            let common = [
                Wgsl::params(&params),
                Wgsl::num_pairs_wanted(num_pairs_wanted),
                Wgsl::keys_in(&buffers.keys[from]),
                Wgsl::places(&buffers.places),
            ];
            self.histogram.dispatch(gpu, pass, &common, num_blocks);
            scan.encode(gpu, pass, &buffers.places, &buffers.levels);
            let moved = [
                Wgsl::values_in(&buffers.values[from]),
                Wgsl::keys_out(&buffers.keys[to]),
                Wgsl::values_out(&buffers.values[to]),
            ];
            self.scatter.dispatch(gpu, pass, &[common.as_slice(), &moved].concat(), num_blocks);
            buffers.current = to;
        }
    }
}
