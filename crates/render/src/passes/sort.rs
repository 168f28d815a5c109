//! Stable radix sort of (key, value) pairs (`shaders/sort.wgsl`).

use super::scan::{Levels, Scan};
use crate::{
    Gpu,
    buffers::{DeviceVec, uniform},
    kernel::Kernel,
    layout::Digit,
    shader_source::SORT_BLOCK,
};
use surgtpgs_core::Result;

const DIGIT_BITS: u32 = 4;

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
        let places = capacity.div_ceil(SORT_BLOCK as usize).max(1) << DIGIT_BITS;
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
            histogram: Kernel::new(gpu, "sort.wgsl", "histogram", 0)?,
            scatter: Kernel::new(gpu, "sort.wgsl", "scatter", 0)?,
        })
    }

    /// Adds a stable sort by the lowest `key_bits` bits of the first `num_wanted[0]` pairs, as far as
    /// they fit.
    pub(crate) fn encode(
        &self,
        gpu: &Gpu,
        pass: &mut wgpu::ComputePass<'_>,
        scan: &Scan,
        buffers: &mut SortBuffers,
        num_wanted: &DeviceVec<u32>,
        key_bits: u32,
    ) {
        let capacity = buffers.keys[0].len() as u32;
        let num_blocks = capacity.div_ceil(SORT_BLOCK);
        for shift in (0..key_bits).step_by(DIGIT_BITS as usize) {
            let digit = uniform(gpu, &Digit { shift, num_blocks, capacity, padding: 0 });
            let (from, to) = (buffers.current, 1 - buffers.current);
            let common = [
                (0, digit.as_entire_binding()),
                (1, num_wanted.binding()),
                (2, buffers.keys[from].binding()),
                (6, buffers.places.binding()),
            ];
            self.histogram.dispatch(gpu, pass, &common, num_blocks);
            scan.encode(gpu, pass, &buffers.places, &buffers.levels);
            let moved = [
                (3, buffers.values[from].binding()),
                (4, buffers.keys[to].binding()),
                (5, buffers.values[to].binding()),
            ];
            self.scatter.dispatch(gpu, pass, &[common.as_slice(), &moved].concat(), num_blocks);
            buffers.current = to;
        }
    }
}
