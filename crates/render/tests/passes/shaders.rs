//! Every .wgsl file compiles, and Rust and WGSL agree on every struct.

use naga::{
    front::wgsl,
    valid::{Capabilities, ValidationFlags, Validator},
};
use std::{collections::BTreeSet, path::Path};
use surgtpgs_render::{
    layout::{
        Chain, Compose, CopyRows, Deform, DeformedRow, Dense, Densify, Digit, Gather, LookUp, Loss, Network,
        OpenPixel, Overlay, Picked, PromptRow, Region, RegionBlock, Regions, RestRow, Scoring, Settle,
        Settled, ShaderStruct, SplatGradientRow, SplatRow, Summarise, Update, View,
    },
    shader_source::{FILES, assemble},
};

fn files_on_disk() -> BTreeSet<String> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shaders");
    let mut folders = vec![root.clone()];
    let mut files = BTreeSet::new();
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|e| e == "wgsl") {
                files.insert(path.strip_prefix(&root).unwrap().to_str().unwrap().replace('\\', "/"));
            }
        }
    }
    files
}

#[test]
fn every_shader_on_disk_is_embedded() {
    let embedded: BTreeSet<String> = FILES.iter().map(|(name, _)| name.to_string()).collect();
    assert!(!embedded.is_empty());
    assert_eq!(files_on_disk(), embedded);
}

/// Parses and validates a file with nothing beyond core WGSL.
fn parse(file: &str, latent_dim: usize) -> naga::Module {
    let source = assemble(file, latent_dim).unwrap();
    let module = wgsl::parse_str(&source).unwrap_or_else(|e| panic!("{file}: {}", e.emit_to_string(&source)));
    Validator::new(ValidationFlags::all(), Capabilities::empty())
        .validate(&module)
        .unwrap_or_else(|e| panic!("{file}: {}", e.emit_to_string(&source)));
    module
}

#[test]
fn every_shader_is_valid_core_wgsl_for_every_latent_dimension() {
    for (file, _) in FILES {
        for latent_dim in 0..=16 {
            let module = parse(file, latent_dim);
            assert_eq!(module.entry_points.is_empty(), file.starts_with("shared/"), "{file}");
        }
    }
}

#[test]
fn workgroup_memory_fits_the_smallest_adapters() {
    for (file, _) in FILES {
        let module = parse(file, 16);
        let mut layouter = naga::proc::Layouter::default();
        layouter.update(module.to_ctx()).unwrap();
        let bytes: u32 = module
            .global_variables
            .iter()
            .filter(|(_, v)| v.space == naga::AddressSpace::WorkGroup)
            .map(|(_, v)| layouter[v.ty].size)
            .sum();
        assert!(bytes <= 16_384, "{file}: {bytes} bytes of workgroup memory");
    }
}

#[test]
fn an_entry_point_binds_no_more_storage_buffers_than_the_smallest_adapters_have() {
    for (file, _) in FILES {
        let module = parse(file, 16);
        let info = Validator::new(ValidationFlags::all(), Capabilities::empty()).validate(&module).unwrap();
        for (k, entry) in module.entry_points.iter().enumerate() {
            let used = info.get_entry_point(k);
            let is_storage = |v: &naga::GlobalVariable| matches!(v.space, naga::AddressSpace::Storage { .. });
            let variables = module.global_variables.iter();
            let bound = variables.filter(|(handle, v)| is_storage(v) && !used[*handle].is_empty()).count();
            assert!(bound <= 8, "{file}, {}: {bound} storage buffers", entry.name);
        }
    }
}

fn check_struct<T: ShaderStruct>(file: &str) {
    let module = parse(file, 3);
    let (_, ty) = module
        .types
        .iter()
        .find(|(_, ty)| ty.name.as_deref() == Some(T::NAME))
        .unwrap_or_else(|| panic!("{file} has no struct {}", T::NAME));
    let naga::TypeInner::Struct { members, span } = &ty.inner else { panic!("{} is no struct", T::NAME) };
    let in_shader: Vec<_> =
        members.iter().map(|m| (m.name.as_deref().unwrap_or_default(), m.offset as usize)).collect();
    assert_eq!(in_shader, T::FIELDS, "{}", T::NAME);
    assert_eq!(*span as usize, T::SIZE, "size of {}", T::NAME);
}

#[test]
fn structs_have_the_same_layout_in_rust_and_in_wgsl() {
    check_struct::<View>("shared/view.wgsl");
    check_struct::<RestRow>("shared/gaussian.wgsl");
    check_struct::<DeformedRow>("shared/gaussian.wgsl");
    check_struct::<SplatRow>("shared/gaussian.wgsl");
    check_struct::<SplatGradientRow>("shared/gaussian.wgsl");
    check_struct::<Deform>("shared/deform.wgsl");
    check_struct::<Digit>("sort.wgsl");
    check_struct::<Dense>("dense.wgsl");
    check_struct::<Scoring>("relevancy.wgsl");
    check_struct::<Overlay>("overlay.wgsl");
    check_struct::<PromptRow>("overlay.wgsl");
    check_struct::<PromptRow>("summary.wgsl");
    check_struct::<Compose>("compose.wgsl");
    check_struct::<LookUp>("lattice.wgsl");
    check_struct::<OpenPixel>("lattice.wgsl");
    check_struct::<Summarise>("summary.wgsl");
    check_struct::<Picked>("pick.wgsl");
    check_struct::<Loss>("loss.wgsl");
    check_struct::<Regions>("regions.wgsl");
    check_struct::<RegionBlock>("regions.wgsl");
    check_struct::<Region>("regions.wgsl");
    check_struct::<Gather>("gather.wgsl");
    check_struct::<Chain>("chain.wgsl");
    check_struct::<Network>("network.wgsl");
    check_struct::<Settle>("settle.wgsl");
    check_struct::<Settled>("settle.wgsl");
    check_struct::<Update>("update.wgsl");
    check_struct::<Densify>("densify.wgsl");
    check_struct::<CopyRows>("densify.wgsl");
}

#[test]
fn a_struct_that_is_too_short_or_has_a_moved_field_is_noticed() {
    struct TooShort;
    impl ShaderStruct for TooShort {
        const NAME: &'static str = "Digit";
        const FIELDS: &'static [(&'static str, usize)] = Digit::FIELDS;
        const SIZE: usize = Digit::SIZE - 4;
    }
    struct Moved;
    impl ShaderStruct for Moved {
        const NAME: &'static str = "Digit";
        const FIELDS: &'static [(&'static str, usize)] =
            &[("num_blocks", 0), ("shift", 4), ("capacity", 8), ("padding", 12)];
        const SIZE: usize = Digit::SIZE;
    }
    assert!(std::panic::catch_unwind(|| check_struct::<TooShort>("sort.wgsl")).is_err());
    assert!(std::panic::catch_unwind(|| check_struct::<Moved>("sort.wgsl")).is_err());
}
