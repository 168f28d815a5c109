//! Assignment of splats to the tiles they touch, front to back (`shaders/bin.wgsl`).

use super::{
    scan::{Levels, Scan},
    sort::{Sort, SortBuffers},
};
use crate::{
    Gpu,
    buffers::{DeviceVec, max_bytes},
    kernel::Kernel,
    layout::{SplatRow, View},
    shader_source::GROUP,
};
use surgtpgs_core::{Error, Remedy, Result, raster::bin::Bins};

#[derive(Debug)]
pub(crate) struct BinPass {
    depth_keys: Kernel,
    count_tiles: Kernel,
    emit_pairs: Kernel,
    find_ranges: Kernel,
    number_pairs: Kernel,
    resolve_pairs: Kernel,
    scan: Scan,
    sort: Sort,
    /// Number of splats, for the sort by depth.
    num_splats: DeviceVec<u32>,
    by_depth: SortBuffers,
    first_pair: DeviceVec<u32>,
    levels: Levels,
    pairs: SortBuffers,
    capacity: usize,
    slot_owners: DeviceVec<u32>,
    /// Output if pairs have slots: Gaussian of each pair, tile by tile and front to back.
    pub pair_owners: DeviceVec<u32>,
    /// Output: [first, end) of each tile in the pairs.
    pub ranges: DeviceVec<[u32; 2]>,
}

/// Number of pairs that fit before anything is known of the scene.
const FIRST_CAPACITY: usize = 1 << 16;

impl BinPass {
    pub(crate) fn new(gpu: &Gpu) -> Result<Self> {
        let kernel = |entry| Kernel::new(gpu, "bin.wgsl", entry, 0);
        Ok(Self {
            depth_keys: kernel("depth_keys")?,
            count_tiles: kernel("count_tiles")?,
            emit_pairs: kernel("emit_pairs")?,
            find_ranges: kernel("find_ranges")?,
            number_pairs: kernel("number_pairs")?,
            resolve_pairs: kernel("resolve_pairs")?,
            scan: Scan::new(gpu)?,
            sort: Sort::new(gpu)?,
            num_splats: DeviceVec::new(gpu, "counts"),
            by_depth: SortBuffers::new(gpu),
            first_pair: DeviceVec::new(gpu, "splats"),
            levels: Levels::default(),
            pairs: SortBuffers::new(gpu),
            capacity: FIRST_CAPACITY,
            slot_owners: DeviceVec::new(gpu, "splat-tile pairs"),
            pair_owners: DeviceVec::new(gpu, "splat-tile pairs"),
            ranges: DeviceVec::new(gpu, "tiles"),
        })
    }

    pub(crate) fn capacity(&self) -> usize {
        self.capacity
    }

    /// Sets the room to `capacity` pairs from the next frame on.
    pub(crate) fn set_capacity(&mut self, gpu: &Gpu, capacity: usize) -> Result<()> {
        let limit = (max_bytes(gpu) / size_of::<u32>() as u64) as usize;
        if capacity > limit {
            return Err(Error::input(
                format!("the picture needs {capacity} splat-tile pairs, the GPU holds {limit}"),
                Remedy::UseCpu.after("Use a smaller picture or scene."),
            ));
        }
        self.capacity = capacity.max(1);
        Ok(())
    }

    /// Returns `true` if `wanted` pairs did not fit. There is then more room, and the frame must be repeated.
    pub(crate) fn grow_if_full(&mut self, gpu: &Gpu, wanted: u32) -> Result<bool> {
        let wanted = wanted as usize;
        if wanted <= self.capacity {
            return Ok(false);
        }
        let limit = (max_bytes(gpu) / size_of::<u32>() as u64) as usize;
        // A quarter more, so that the next frame fits too.
        self.set_capacity(gpu, wanted.max((wanted + wanted / 4).min(limit)))?;
        Ok(true)
    }

    /// Makes room for the frame.
    pub(crate) fn prepare(&mut self, gpu: &Gpu, view: &View) -> Result<()> {
        let n = view.num_gaussians as usize;
        self.num_splats.write(gpu, &[view.num_gaussians])?;
        self.by_depth.prepare(gpu, n)?;
        self.first_pair.resize(gpu, n)?;
        self.levels.prepare(gpu, n)?;
        self.pairs.prepare(gpu, self.capacity)?;
        let num_tiles = (view.tiles[0] * view.tiles[1]) as usize;
        self.ranges.write(gpu, &vec![[0; 2]; num_tiles])
    }

    /// Number of pairs that the last frame wanted.
    pub(crate) fn num_wanted(&self) -> &DeviceVec<u32> {
        self.levels.total().unwrap_or(&self.num_splats)
    }

    /// Output: Gaussian indices front to back, and the first slot of each.
    pub(crate) fn slots(&self) -> [&DeviceVec<u32>; 2] {
        [self.by_depth.values(), &self.first_pair]
    }

    /// Output: Gaussian indices, or slots, tile by tile and front to back.
    pub(crate) fn pairs(&self) -> &DeviceVec<u32> {
        self.pairs.values()
    }

    /// Adds the pass; [`Self::prepare`] must have been called.
    pub(crate) fn encode(
        &mut self,
        gpu: &Gpu,
        pass: &mut wgpu::ComputePass<'_>,
        view_buffer: &wgpu::Buffer,
        view: &View,
        splats: &DeviceVec<SplatRow>,
    ) {
        self.emit(gpu, pass, view_buffer, view, splats);
        self.sort_by_tile(gpu, pass, view_buffer, view);
    }

    /// Adds the pass as [`Self::encode`] does, with a slot for every pair. The slots of a Gaussian lie
    /// together, in the order of its tiles.
    pub(crate) fn encode_with_slots(
        &mut self,
        gpu: &Gpu,
        pass: &mut wgpu::ComputePass<'_>,
        view_buffer: &wgpu::Buffer,
        view: &View,
        splats: &DeviceVec<SplatRow>,
    ) -> Result<()> {
        self.slot_owners.resize(gpu, self.capacity)?;
        self.pair_owners.resize(gpu, self.capacity)?;
        let per_pair = (self.capacity as u32).div_ceil(GROUP);
        self.emit(gpu, pass, view_buffer, view, splats);
        let common = [(0, view_buffer.as_entire_binding()), (5, self.num_wanted().binding())];
        let owners = (9, self.slot_owners.binding());
        let emitted = [(7, self.pairs.values().binding()), owners.clone()];
        self.number_pairs.dispatch(gpu, pass, &[&common[..], &emitted].concat(), per_pair);
        self.sort_by_tile(gpu, pass, view_buffer, view);
        let common = [(0, view_buffer.as_entire_binding()), (5, self.num_wanted().binding())];
        let owners = (9, self.slot_owners.binding());
        let sorted = [(7, self.pairs.values().binding()), owners, (10, self.pair_owners.binding())];
        self.resolve_pairs.dispatch(gpu, pass, &[&common[..], &sorted].concat(), per_pair);
        Ok(())
    }

    /// Adds the pairs of all splats, front to back.
    fn emit(
        &mut self,
        gpu: &Gpu,
        pass: &mut wgpu::ComputePass<'_>,
        view_buffer: &wgpu::Buffer,
        view: &View,
        splats: &DeviceVec<SplatRow>,
    ) {
        let per_splat = view.num_gaussians.div_ceil(GROUP);
        let bind_view = (0, view_buffer.as_entire_binding());
        let bind_splats = (1, splats.binding());

        let keys = [(2, self.by_depth.keys().binding()), (3, self.by_depth.values().binding())];
        let bindings = [bind_view.clone(), bind_splats.clone(), keys[0].clone(), keys[1].clone()];
        self.depth_keys.dispatch(gpu, pass, &bindings, per_splat);
        self.sort.encode(gpu, pass, &self.scan, &mut self.by_depth, &self.num_splats, u32::BITS);

        let bind_order = (3, self.by_depth.values().binding());
        let bind_first = (4, self.first_pair.binding());
        let bindings = [bind_view.clone(), bind_splats.clone(), bind_order.clone(), bind_first.clone()];
        self.count_tiles.dispatch(gpu, pass, &bindings, per_splat);
        self.scan.encode(gpu, pass, &self.first_pair, &self.levels);

        let num_wanted = self.levels.total().unwrap_or(&self.num_splats);
        let bind_wanted = (5, num_wanted.binding());
        let pairs = [(6, self.pairs.keys().binding()), (7, self.pairs.values().binding())];
        let bindings = [&[bind_view, bind_splats, bind_order, bind_first, bind_wanted], &pairs[..]].concat();
        self.emit_pairs.dispatch(gpu, pass, &bindings, per_splat);
    }

    fn sort_by_tile(
        &mut self,
        gpu: &Gpu,
        pass: &mut wgpu::ComputePass<'_>,
        view_buffer: &wgpu::Buffer,
        view: &View,
    ) {
        let bind_view = (0, view_buffer.as_entire_binding());
        let num_wanted = self.levels.total().unwrap_or(&self.num_splats);
        let bind_wanted = (5, num_wanted.binding());
        // One tile more than there are: see the end of emit_pairs.
        let tile_bits = u32::BITS - (view.tiles[0] * view.tiles[1]).leading_zeros();
        self.sort.encode(gpu, pass, &self.scan, &mut self.pairs, num_wanted, tile_bits);

        let bindings = [bind_view, bind_wanted, (6, self.pairs.keys().binding()), (8, self.ranges.binding())];
        self.find_ranges.dispatch(gpu, pass, &bindings, (self.capacity as u32).div_ceil(GROUP));
    }

    /// Waits for the device and copies out the result.
    pub(crate) fn read(&self, gpu: &Gpu, view: &View) -> Result<Bins> {
        let ranges = self.ranges.read(gpu, usize::MAX)?;
        let pairs = self.pairs().read(gpu, usize::MAX)?;
        let mut bins = Bins {
            columns: view.tiles[0] as usize,
            rows: view.tiles[1] as usize,
            first: vec![0],
            splat: Vec::new(),
        };
        for [first, end] in ranges {
            bins.splat.extend_from_slice(&pairs[first as usize..end as usize]);
            bins.first.push(bins.splat.len() as u32);
        }
        Ok(bins)
    }
}
