//! Assignment of splats to the tiles they touch, front to back (`shaders/bin.wgsl`).

use super::{
    scan::{Levels, Scan},
    sort::{Sort, SortBuffers},
};
use crate::{
    buffers::{DeviceVec, Uniform, max_bytes},
    device::Gpu,
    kernel::{Kernel, Pass},
    rows::{SplatRow, ViewParams},
    shader::{GROUP, shader},
};
use surgtpgs_core::{Error, Remedy, Result, raster::bin::Bins};

shader! {
    pub(super) Wgsl = "bin.wgsl";
    var<uniform> view: ViewParams;
    var<read> splats: [SplatRow];
    /// Depth keys and indices of the splats; front to back after the sort.
    var<write> depth_keys_out: [u32];
    var<write> depth_order: [u32];
    /// Number of tiles of each rank in depth_order; after the scan its first pair.
    var<write> first_pair: [u32];
    var<read> num_pairs_wanted: [u32];
    var<write> pair_tiles: [u32];
    /// Sorted payload of each splat-tile pair: a Gaussian, or a slot when training.
    var<write> pair_values: [u32];
    /// [first, end) of each tile; must have been cleared.
    var<write> tile_ranges: [[u32; 2]];
    /// Gaussian of each slot.
    var<write> slot_gaussians: [u32];
    /// Gaussian of each pair whose slot is in pair_values.
    var<write> pair_gaussians: [u32];
}

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
    slot_gaussians: DeviceVec<u32>,
    /// Output if pairs have slots: Gaussian of each pair, tile by tile and front to back.
    pub pair_gaussians: DeviceVec<u32>,
    /// Output: [first, end) of each tile in the pairs.
    pub ranges: DeviceVec<[u32; 2]>,
}

/// Number of pairs that fit before anything is known of the scene.
const FIRST_CAPACITY: usize = 1 << 16;

impl BinPass {
    pub(crate) fn new(gpu: &Gpu) -> Result<Self> {
        let kernel = |entry| Kernel::new(gpu, &Wgsl::SHADER, entry, 0);
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
            slot_gaussians: DeviceVec::new(gpu, "splat-tile pairs"),
            pair_gaussians: DeviceVec::new(gpu, "splat-tile pairs"),
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
    pub(crate) fn prepare(&mut self, gpu: &Gpu, view: &ViewParams) -> Result<()> {
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
    pub(crate) fn num_pairs_wanted(&self) -> &DeviceVec<u32> {
        self.levels.total().unwrap_or(&self.num_splats)
    }

    /// Output: Gaussian indices front to back, and the first pair of each, which is its first slot.
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
        pass: &mut Pass<'_>,
        view_buffer: &Uniform<ViewParams>,
        view: &ViewParams,
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
        pass: &mut Pass<'_>,
        view_buffer: &Uniform<ViewParams>,
        view: &ViewParams,
        splats: &DeviceVec<SplatRow>,
    ) -> Result<()> {
        self.slot_gaussians.resize(gpu, self.capacity)?;
        self.pair_gaussians.resize(gpu, self.capacity)?;
        let per_pair = (self.capacity as u32).div_ceil(GROUP);
        self.emit(gpu, pass, view_buffer, view, splats);
        let common = [Wgsl::view(view_buffer), Wgsl::num_pairs_wanted(self.num_pairs_wanted())];
        let emitted = [Wgsl::pair_values(self.pairs()), Wgsl::slot_gaussians(&self.slot_gaussians)];
        self.number_pairs.dispatch(gpu, pass, &[common, emitted].concat(), per_pair);
        self.sort_by_tile(gpu, pass, view_buffer, view);
        let bindings = [
            Wgsl::view(view_buffer),
            Wgsl::num_pairs_wanted(self.num_pairs_wanted()),
            Wgsl::pair_values(self.pairs()),
            Wgsl::slot_gaussians(&self.slot_gaussians),
            Wgsl::pair_gaussians(&self.pair_gaussians),
        ];
        self.resolve_pairs.dispatch(gpu, pass, &bindings, per_pair);
        Ok(())
    }

    /// Adds the pairs of all splats, front to back.
    fn emit(
        &mut self,
        gpu: &Gpu,
        pass: &mut Pass<'_>,
        view_buffer: &Uniform<ViewParams>,
        view: &ViewParams,
        splats: &DeviceVec<SplatRow>,
    ) {
        let per_splat = view.num_gaussians.div_ceil(GROUP);
        let common = [Wgsl::view(view_buffer), Wgsl::splats(splats)];

        let keys = [Wgsl::depth_keys_out(self.by_depth.keys()), Wgsl::depth_order(self.by_depth.values())];
        self.depth_keys.dispatch(gpu, pass, &[common.clone(), keys].concat(), per_splat);
        self.sort.encode(gpu, pass, &self.scan, &mut self.by_depth, &self.num_splats, u32::BITS);

        let order = [Wgsl::depth_order(self.by_depth.values()), Wgsl::first_pair(&self.first_pair)];
        let ordered = [common, order].concat();
        self.count_tiles.dispatch(gpu, pass, &ordered, per_splat);
        self.scan.encode(gpu, pass, &self.first_pair, &self.levels);

        let pairs = [
            Wgsl::num_pairs_wanted(self.num_pairs_wanted()),
            Wgsl::pair_tiles(self.pairs.keys()),
            Wgsl::pair_values(self.pairs.values()),
        ];
        self.emit_pairs.dispatch(gpu, pass, &[&ordered[..], &pairs].concat(), per_splat);
    }

    fn sort_by_tile(
        &mut self,
        gpu: &Gpu,
        pass: &mut Pass<'_>,
        view_buffer: &Uniform<ViewParams>,
        view: &ViewParams,
    ) {
        let num_pairs_wanted = self.levels.total().unwrap_or(&self.num_splats);
        // One tile more than there are: see the end of emit_pairs.
        let tile_bits = u32::BITS - (view.tiles[0] * view.tiles[1]).leading_zeros();
        self.sort.encode(gpu, pass, &self.scan, &mut self.pairs, num_pairs_wanted, tile_bits);

        let bindings = [
            Wgsl::view(view_buffer),
            Wgsl::num_pairs_wanted(num_pairs_wanted),
            Wgsl::pair_tiles(self.pairs.keys()),
            Wgsl::tile_ranges(&self.ranges),
        ];
        self.find_ranges.dispatch(gpu, pass, &bindings, (self.capacity as u32).div_ceil(GROUP));
    }

    /// Waits for the device and copies out the result.
    pub(crate) fn read(&self, gpu: &Gpu, view: &ViewParams) -> Result<Bins> {
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
