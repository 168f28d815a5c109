//! Adds and removes Gaussians on the device (`shaders/densify.wgsl`); twin:
//! [`surgtpgs_core::train::densify`].

use super::resident::{Moments, Resident};
use crate::{
    buffers::{DeviceVec, uniform},
    device::Gpu,
    kernel::{Kernel, run},
    planes::{Levels, Scan, Sort, SortBuffers},
    rows::RestRow,
    scene_buffers::{Planes, parts, unread},
    shader::{GROUP, shader, shader_struct},
};
use bytemuck::Pod;
use std::{ops::Range, slice::from_ref};
use surgtpgs_core::{
    Result,
    train::{self, Densify, Model},
};

shader! {
    pub(super) Wgsl = "densify.wgsl";
    const LN_SPLIT = train::LN_SPLIT;
    const SPLIT_DISTANCE = train::SPLIT_DISTANCE;
    const CLONE_DISTANCE = train::CLONE_DISTANCE;
    var<uniform> params: DensifyParams;
    var<read> rest: [RestRow];
    var<read> pull_sums: [f32];
    var<read> times_seen: [u32];
    /// [N + 1], the last 0: 1 if the Gaussian is kept; after the scan its row in the new set.
    var<write> places: [u32];
    /// Keys and indices of the Gaussians; most pulled first after the sort.
    var<write> pull_keys: [u32];
    var<write> ranked: [u32];
    /// Numbers of kept and of pulled Gaussians.
    var<atomic> counts: [u32];
    /// Row of the old set that each row of the new set copies, with FRESH if its moments start afresh.
    var<write> parents: [u32];
    var<uniform> copied: CopyParams;
    var<read> source: [f32];
    var<write> rows: [f32];
    var<write> new_rest: [RestRow];
    /// [N + 1], the last 0: 1 if the Gaussian is divided; after the scan the child's number.
    var<write> children: [u32];
}

shader_struct! {
    /// One densification.
    pub(crate) struct DensifyParams {
        /// Number of Gaussians, N.
        num_gaussians: u32,
        /// Number of Gaussians that are kept.
        num_kept: u32,
        /// Number of kept Gaussians that are divided into two.
        num_children: u32,
        /// 1 to place both halves at random, with fresh moments.
        split_only: u32,
        /// Smallest logit of opacity; Gaussians with a lower one are removed.
        min_opacity_logit: f32,
        /// Smallest pull of a Gaussian that is divided.
        min_pull: f32,
        /// Log-scale above which a Gaussian is split.
        split_log_scale: f32,
        /// Padding to a multiple of 8 bytes.
        padding: u32,
        /// Seed of the random numbers.
        seed: [u32; 2],
        /// Padding to a multiple of 8 bytes.
        padding_2: [u32; 2],
    }
}

shader_struct! {
    /// An array that is rebuilt for the new set of Gaussians.
    pub(crate) struct CopyParams {
        /// Number of planes, each of the same number of rows.
        num_planes: u32,
        /// Number of rows of the new array in this part.
        num_rows: u32,
        /// Number of values of a row.
        width: u32,
        /// First row of the new array in this part.
        first_row: u32,
        /// Number of rows of the old array in this part.
        old_num_rows: u32,
        /// First row of the old array in this part.
        old_first_row: u32,
        /// 1 for moments, whose fresh rows become 0.
        clears_fresh: u32,
        /// Padding to a multiple of 16 bytes.
        padding: u32,
    }
}

/// The kernels, and the buffers between them.
#[derive(Debug)]
pub(super) struct DensifyPass {
    decide: Kernel,
    choose: Kernel,
    list: Kernel,
    copy_rows: Kernel,
    part: Kernel,
    scan: Scan,
    sort: Sort,
    places: DeviceVec<u32>,
    children: DeviceVec<u32>,
    levels: Levels,
    ranked: SortBuffers,
    num_gaussians: DeviceVec<u32>,
    counts: DeviceVec<u32>,
    parents: DeviceVec<u32>,
}

impl DensifyPass {
    pub(super) fn new(gpu: &Gpu) -> Result<Self> {
        let kernel = |entry| Kernel::new(gpu, &Wgsl::SHADER, entry, 0);
        let numbers = || DeviceVec::new(gpu, "Gaussians");
        Ok(Self {
            decide: kernel("decide")?,
            choose: kernel("choose")?,
            list: kernel("list")?,
            copy_rows: kernel("copy_rows")?,
            part: kernel("part")?,
            scan: Scan::new(gpu)?,
            sort: Sort::new(gpu)?,
            places: numbers(),
            children: numbers(),
            levels: Levels::default(),
            ranked: SortBuffers::new(gpu),
            num_gaussians: numbers(),
            counts: numbers(),
            parents: numbers(),
        })
    }

    /// Decides on one densification and carries it out; the outcome of all steps before it must be known.
    /// Only the sizes of `model` are read.
    pub(super) fn run(
        &mut self,
        gpu: &Gpu,
        resident: &mut Resident,
        model: &Model,
        how: &Densify,
    ) -> Result<()> {
        let n = resident.num_gaussians;
        let mut params = DensifyParams {
            num_gaussians: n as u32,
            split_only: u32::from(how.split_only),
            min_opacity_logit: how.min_opacity_logit,
            min_pull: how.min_pull,
            split_log_scale: how.split_log_scale,
            seed: how.seed,
            ..Default::default()
        };
        let [num_kept, num_pulled] = self.rank(gpu, resident, &params)?;
        let num_children = how.num_children(num_kept, num_pulled);
        (params.num_kept, params.num_children) = (num_kept as u32, num_children as u32);
        self.list(gpu, &params, num_kept + num_children)?;
        Follow { gpu, pass: self, old: n, new: num_kept + num_children }.model(resident, model)?;
        self.part(gpu, resident, &params);
        Ok(())
    }

    /// Determines the Gaussians to keep, and the order in which Gaussians would be divided. Returns the
    /// numbers of those kept and of those pulled.
    fn rank(&mut self, gpu: &Gpu, resident: &Resident, params: &DensifyParams) -> Result<[usize; 2]> {
        let n = params.num_gaussians as usize;
        self.places.resize(gpu, n + 1)?;
        self.levels.prepare(gpu, n + 1)?;
        self.ranked.prepare(gpu, n)?;
        self.num_gaussians.write(gpu, &[params.num_gaussians])?;
        self.counts.write(gpu, &[0; 2])?;
        let params = uniform(gpu, params);
        run(gpu, |pass| {
            let bindings = [
                Wgsl::params(&params),
                Wgsl::rest(&resident.scene.rest),
                Wgsl::pull_sums(&resident.pull_sums),
                Wgsl::times_seen(&resident.times_seen),
                Wgsl::places(&self.places),
                Wgsl::pull_keys(self.ranked.keys()),
                Wgsl::ranked(self.ranked.values()),
                Wgsl::counts(&self.counts),
            ];
            self.decide.dispatch(gpu, pass, &bindings, (n as u32 + 1).div_ceil(GROUP));
            self.scan.encode(gpu, pass, &self.places, &self.levels);
            self.sort.encode(gpu, pass, &self.scan, &mut self.ranked, &self.num_gaussians, u32::BITS);
        });
        let counts = self.counts.read(gpu, 2)?;
        Ok([counts[0] as usize, counts[1] as usize])
    }

    /// Lists the parents of the `new` rows.
    fn list(&mut self, gpu: &Gpu, params: &DensifyParams, new: usize) -> Result<()> {
        self.children.resize(gpu, params.num_gaussians as usize + 1)?;
        self.parents.resize(gpu, new)?;
        let groups = (params.num_gaussians + 1).div_ceil(GROUP);
        let params = uniform(gpu, params);
        let common = [Wgsl::params(&params), Wgsl::children(&self.children)];
        run(gpu, |pass| {
            let bindings = [&common[..], &[Wgsl::ranked(self.ranked.values())]].concat();
            self.choose.dispatch(gpu, pass, &bindings, groups);
            self.scan.encode(gpu, pass, &self.children, &self.levels);
            let rows = [Wgsl::places(&self.places), Wgsl::parents(&self.parents)];
            self.list.dispatch(gpu, pass, &[common, rows].concat(), groups);
        });
        Ok(())
    }

    /// Moves the two Gaussians of each pair apart.
    fn part(&self, gpu: &Gpu, resident: &Resident, params: &DensifyParams) {
        let groups = params.num_gaussians.div_ceil(GROUP);
        let params = uniform(gpu, params);
        let bindings = [
            Wgsl::params(&params),
            Wgsl::places(&self.places),
            Wgsl::new_rest(&resident.scene.rest),
            Wgsl::children(&self.children),
        ];
        run(gpu, |pass| self.part.dispatch(gpu, pass, &bindings, groups));
    }
}

/// Rebuilds arrays for the change from `old` rows to `new` ones. They are rebuilt one by one, so that the
/// memory of each old array is free for the next.
struct Follow<'a> {
    gpu: &'a Gpu,
    pass: &'a DensifyPass,
    old: usize,
    new: usize,
}

impl Follow<'_> {
    fn model(&self, resident: &mut Resident, model: &Model) -> Result<()> {
        let Model { gaussians, deformation, .. } = model;
        let (bands, dim, stride) = (gaussians.sh_bands() * 3, gaussians.latent_dim, deformation.stride);
        let scene = &mut resident.scene;
        self.array(&mut scene.rest, size_of::<RestRow>() / size_of::<f32>(), false)?;
        self.array(&mut scene.sh_rest, bands, false)?;
        self.array(&mut scene.features, dim, false)?;
        self.moments(&mut resident.rest, size_of::<RestRow>() / size_of::<f32>())?;
        self.moments(&mut resident.sh_rest, bands)?;
        self.moments(&mut resident.features, dim)?;

        let old_parts = std::mem::replace(&mut scene.parts, parts(self.gpu, self.new, deformation));
        let cut =
            Cut { old: &old_parts, new: &scene.parts, num_planes: deformation.num_bases, width: stride };
        let planes = |array: &mut Planes, clears_fresh| self.planes(array, &cut, clears_fresh);
        let both = |moments: &mut Moments<Planes>| {
            planes(&mut moments.first, true)?;
            planes(&mut moments.second, true)
        };
        planes(&mut scene.weights, false)?;
        both(&mut resident.weights)?;
        if let Some(own) = &mut resident.own_bases {
            planes(&mut scene.centres, false)?;
            planes(&mut scene.widths, false)?;
            own.iter_mut().try_for_each(both)?;
        } else {
            scene.centres = unread(self.gpu, "basis centres", cut.new.len());
            scene.widths = unread(self.gpu, "basis widths", cut.new.len());
        }
        resident.pull_sums.write(self.gpu, &vec![0.0; self.new])?;
        resident.times_seen.write(self.gpu, &vec![0; self.new])?;
        resident.num_gaussians = self.new;
        resident.is_known = false;
        Ok(())
    }

    /// Rebuilds an array [N][width].
    fn array<T: Pod>(&self, array: &mut DeviceVec<T>, width: usize, clears_fresh: bool) -> Result<()> {
        let (old, new) = (0..self.old, 0..self.new);
        let cut = Cut { old: from_ref(&old), new: from_ref(&new), num_planes: 1, width };
        let len = self.new * width * size_of::<f32>() / size_of::<T>();
        *array = self.part(&[&*array], 0..self.new, len, &cut, clears_fresh)?;
        Ok(())
    }

    fn moments(&self, moments: &mut Moments, width: usize) -> Result<()> {
        self.array(&mut moments.first, width, true)?;
        self.array(&mut moments.second, width, true)
    }

    /// Rebuilds an array [B][N][stride] in parts.
    fn planes(&self, array: &mut Planes, cut: &Cut<'_>, clears_fresh: bool) -> Result<()> {
        let old: Vec<&DeviceVec<f32>> = array.iter().collect();
        let part = |rows: &Range<usize>| {
            let len = cut.num_planes * rows.len() * cut.width;
            self.part(&old, rows.clone(), len, cut, clears_fresh)
        };
        *array = cut.new.iter().map(part).collect::<Result<_>>()?;
        Ok(())
    }

    /// Makes one new part of `len` values from all old ones.
    fn part<T: Pod>(
        &self,
        old: &[&DeviceVec<T>],
        rows: Range<usize>,
        len: usize,
        cut: &Cut<'_>,
        clears_fresh: bool,
    ) -> Result<DeviceVec<T>> {
        let Self { gpu, pass, .. } = self;
        let mut part = old.first().map_or_else(|| DeviceVec::new(gpu, "Gaussians"), |p| p.same_kind(gpu));
        part.resize(gpu, len)?;
        let numbers = (cut.num_planes * rows.len() * cut.width) as u32;
        for (source, old_rows) in old.iter().zip(cut.old).filter(|_| numbers > 0) {
            let params = CopyParams {
                num_planes: cut.num_planes as u32,
                num_rows: rows.len() as u32,
                width: cut.width as u32,
                first_row: rows.start as u32,
                old_num_rows: old_rows.len() as u32,
                old_first_row: old_rows.start as u32,
                clears_fresh: u32::from(clears_fresh),
                padding: 0,
            };
            let params = uniform(gpu, &params);
            let bindings = [
                Wgsl::parents(&pass.parents),
                Wgsl::copied(&params),
                Wgsl::source(source.numbers()),
                Wgsl::rows(part.numbers()),
            ];
            run(gpu, |commands| pass.copy_rows.dispatch(gpu, commands, &bindings, numbers.div_ceil(GROUP)));
        }
        Ok(part)
    }
}

/// Parts of an array [planes][N][width], before and after the change.
struct Cut<'a> {
    old: &'a [Range<usize>],
    new: &'a [Range<usize>],
    num_planes: usize,
    width: usize,
}
