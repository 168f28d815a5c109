//! Every .wgsl file compiles, and says the same of every struct and binding as its declaration in Rust.

use naga::{
    AddressSpace, Handle, Module, StorageAccess, TypeInner,
    front::wgsl,
    valid::{Capabilities, ValidationFlags, Validator},
};
use std::{collections::BTreeSet, path::Path};
use surgtpgs_render::{
    shader::{Access, Binding, Field, IMPORTED, Shader, Type},
    shaders,
};

fn files_on_disk() -> BTreeSet<String> {
    // Tests run in the folder of their crate, wherever it was compiled.
    let root = Path::new("../../shaders").to_owned();
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
fn every_shader_on_disk_is_declared_or_imported() {
    let declared: Vec<String> = shaders().map(|shader| shader.file.to_owned()).collect();
    let known: BTreeSet<String> =
        declared.iter().cloned().chain(IMPORTED.iter().map(|(file, _)| file.to_string())).collect();
    assert!(!declared.is_empty());
    assert_eq!(files_on_disk(), known);
    assert_eq!(known.len(), declared.len() + IMPORTED.len(), "a file is declared twice");
    for (file, _) in IMPORTED {
        let line = format!("#import {file}\n");
        assert!(shaders().any(|shader| shader.source.contains(&line)), "nothing imports {file}");
    }
}

/// Parses and validates a shader with nothing beyond core WGSL.
fn parse(shader: &Shader, latent_dim: usize) -> Module {
    let (file, source) = (shader.file, shader.wgsl(latent_dim).unwrap());
    let module = wgsl::parse_str(&source).unwrap_or_else(|e| panic!("{file}: {}", e.emit_to_string(&source)));
    Validator::new(ValidationFlags::all(), Capabilities::empty())
        .validate(&module)
        .unwrap_or_else(|e| panic!("{file}: {}", e.emit_to_string(&source)));
    module
}

#[test]
fn every_shader_is_valid_core_wgsl_for_every_latent_dimension() {
    for shader in shaders() {
        for latent_dim in 0..=16 {
            assert!(!parse(shader, latent_dim).entry_points.is_empty(), "{}", shader.file);
        }
    }
}

/// Returns `true` if the loop that begins in a line counts up to a number, or halves down to 0.
fn counts_to_an_end(line: &str) -> bool {
    let Some((_, head)) = line.split_once("for (") else { return false };
    let parts: Vec<&str> = head.split(';').map(str::trim).collect();
    let &[_, condition, change] = &parts[..] else { return false };
    let counter: String = change.chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect();
    let grows = ["++", " += ", " <<= 1u"].iter().any(|by| change[counter.len()..].starts_with(by));
    let halves = change[counter.len()..].starts_with(" /= 2u");
    let ends =
        |relation: &str| condition.split(" && ").any(|c| c.starts_with(&format!("{counter}{relation}")));
    grows && (ends(" < ") || ends(" <= ")) || halves && ends(" > 0u")
}

#[test]
fn every_loop_ends_by_itself_because_nothing_else_ends_it() {
    for file in files_on_disk() {
        let source = std::fs::read_to_string(Path::new("../../shaders").join(&file)).unwrap();
        for line in source.lines().filter_map(|line| line.split("//").next()) {
            let is_loop = |word: &str| ["for", "loop", "while"].contains(&word);
            if line.split(|c: char| !c.is_alphanumeric() && c != '_').any(is_loop) {
                assert!(counts_to_an_end(line), "{file}: {line}");
            }
        }
    }
    for endless in [
        "loop {",
        "while true {",
        "for (;;) {",
        "for (var i = 0u; i < 9u; j++) {",
        "for (var i = 9u; i > 0u; i++) {",
    ] {
        assert!(!counts_to_an_end(endless), "{endless}");
    }
}

#[test]
fn workgroup_memory_fits_the_smallest_adapters() {
    for shader in shaders() {
        let (file, module) = (shader.file, parse(shader, 16));
        let mut layouter = naga::proc::Layouter::default();
        layouter.update(module.to_ctx()).unwrap();
        let bytes: u32 = module
            .global_variables
            .iter()
            .filter(|(_, v)| v.space == AddressSpace::WorkGroup)
            .map(|(_, v)| layouter[v.ty].size)
            .sum();
        assert!(bytes <= 16_384, "{file}: {bytes} bytes of workgroup memory");
    }
}

#[test]
fn an_entry_point_binds_no_more_storage_buffers_than_the_smallest_adapters_have() {
    for shader in shaders() {
        let (file, module) = (shader.file, parse(shader, 16));
        let info = Validator::new(ValidationFlags::all(), Capabilities::empty()).validate(&module).unwrap();
        for (k, entry) in module.entry_points.iter().enumerate() {
            let used = info.get_entry_point(k);
            let is_storage = |v: &naga::GlobalVariable| matches!(v.space, AddressSpace::Storage { .. });
            let variables = module.global_variables.iter();
            let bound = variables.filter(|(handle, v)| is_storage(v) && !used[*handle].is_empty()).count();
            assert!(bound <= 8, "{file}, {}: {bound} storage buffers", entry.name);
        }
    }
}

/// Name of a type in WGSL.
fn name_of(module: &Module, of: Handle<naga::Type>) -> String {
    let scalar = |scalar: naga::Scalar| match scalar.kind {
        naga::ScalarKind::Float => "f",
        naga::ScalarKind::Uint => "u",
        other => panic!("{other:?} is not shared"),
    };
    let ty = &module.types[of];
    match ty.inner {
        TypeInner::Scalar(of) => format!("{}32", scalar(of)),
        TypeInner::Vector { size, scalar: of } => format!("vec{}{}", size as u8, scalar(of)),
        TypeInner::Atomic(of) => format!("atomic<{}32>", scalar(of)),
        TypeInner::Array { base, size: naga::ArraySize::Dynamic, .. } => {
            format!("array<{}>", name_of(module, base))
        }
        TypeInner::Array { base, size: naga::ArraySize::Constant(n), .. } => {
            format!("array<{}, {n}>", name_of(module, base))
        }
        TypeInner::Struct { .. } => ty.name.clone().unwrap_or_default(),
        _ => panic!("{ty:?} is not shared"),
    }
}

/// Compares the compiler's view of a shader with its declaration.
fn compare(shader: &Shader, module: &Module) -> Result<(), String> {
    let found: Vec<_> = module
        .global_variables
        .iter()
        .filter_map(|(_, v)| {
            let at = v.binding?;
            Some((at.group, at.binding, v.name.clone()?, v.space, name_of(module, v.ty), v.ty))
        })
        .collect();
    if found.len() != shader.bindings.len() {
        return Err(format!(
            "{}: {} bindings instead of {}",
            shader.file,
            found.len(),
            shader.bindings.len()
        ));
    }
    for (number, Binding { name, access, of }) in (0..).zip(shader.bindings) {
        let storage = |access| AddressSpace::Storage { access };
        let read_write = StorageAccess::LOAD | StorageAccess::STORE;
        let (space, type_name) = match access {
            Access::Uniform => (AddressSpace::Uniform, of.name.to_owned()),
            Access::Read => (storage(StorageAccess::LOAD), format!("array<{}>", of.name)),
            Access::Write => (storage(read_write), format!("array<{}>", of.name)),
            Access::Atomic => (storage(read_write), format!("array<atomic<{}>>", of.name)),
        };
        let expected = (0, number, name.to_string(), space, type_name);
        let is_same = |(group, number, name, space, of, _): &&(u32, u32, String, _, String, _)| {
            (*group, *number, name, *space, of)
                == (expected.0, expected.1, &expected.2, expected.3, &expected.4)
        };
        let Some((.., handle)) = found.iter().find(is_same) else {
            return Err(format!("{}: {expected:?} is not among {found:?}", shader.file));
        };
        compare_type(module, of, *handle).map_err(|e| format!("{}, {name}: {e}", shader.file))?;
    }
    Ok(())
}

fn compare_type(module: &Module, declared: &Type, found: Handle<naga::Type>) -> Result<(), String> {
    let mut layouter = naga::proc::Layouter::default();
    layouter.update(module.to_ctx()).map_err(|e| e.to_string())?;
    let (base, stride) = match module.types[found].inner {
        TypeInner::Array { base, stride, size: naga::ArraySize::Dynamic } => (base, stride),
        _ => (found, layouter[found].size),
    };
    let mut fields = Vec::new();
    if let TypeInner::Struct { members, .. } = &module.types[base].inner {
        for m in members {
            fields.push((m.name.clone().unwrap_or_default(), m.offset as usize, name_of(module, m.ty)));
        }
    }
    let expected: Vec<_> =
        declared.fields.iter().map(|f| (f.name.to_string(), f.offset, f.of.name.to_string())).collect();
    let sizes = [layouter[base].size, stride].map(|n| n as usize);
    if fields != expected || sizes != [declared.size; 2] {
        return Err(format!("{fields:?} of {sizes:?} bytes instead of {expected:?} of {}", declared.size));
    }
    Ok(())
}

#[test]
fn structs_and_bindings_are_the_same_in_rust_and_in_wgsl() {
    for shader in shaders() {
        compare(shader, &parse(shader, 3)).unwrap();
    }
}

#[test]
fn a_declaration_that_differs_from_the_shader_is_refused() {
    let shader = shaders().find(|shader| shader.file == "lattice.wgsl").unwrap();
    let module = parse(shader, 3);
    compare(shader, &module).unwrap();
    let changed = |at: usize, change: &dyn Fn(&mut Binding)| {
        let mut bindings = shader.bindings.to_vec();
        change(&mut bindings[at]);
        compare(&Shader { bindings: bindings.leak(), ..*shader }, &module)
    };
    let field = |change: &'static dyn Fn(&mut Field)| {
        changed(0, &move |binding| {
            let mut fields = binding.of.fields.to_vec();
            change(&mut fields[3]);
            binding.of.fields = fields.leak();
        })
    };
    let of = |name: &str| shader.bindings.iter().find(|b| b.of.name == name).unwrap().of;
    let (u32_type, struct_type) = (of("u32"), of("OpenPixel"));
    assert!(changed(0, &|_| ()).is_ok() && field(&|_| ()).is_ok());
    assert!(changed(1, &|b| b.name = "plane").is_err(), "name of a binding");
    assert!(changed(1, &|b| b.access = Access::Write).is_err(), "access");
    assert!(changed(0, &|b| b.access = Access::Read).is_err(), "kind");
    assert!(changed(1, &|b| b.of = u32_type).is_err(), "type of the values");
    assert!(changed(0, &|b| b.of = struct_type).is_err(), "another struct");
    assert!(changed(0, &|b| b.of.size += 16).is_err(), "size of a struct");
    assert!(field(&|f| f.name = "max_alpha").is_err(), "name of a field");
    assert!(field(&|f| f.offset += 4).is_err(), "offset of a field");
    assert!(field(&|f| f.of.name = "u32").is_err(), "type of a field");
    let mut bindings = shader.bindings.to_vec();
    bindings.swap(1, 2);
    assert!(compare(&Shader { bindings: bindings.leak(), ..*shader }, &module).is_err(), "numbers");
    let source = "@group(0) @binding(9) var<storage, read> by_hand: array<u32>;\n".to_owned() + shader.source;
    let by_hand = parse(&Shader { source: source.leak(), ..*shader }, 3);
    assert!(compare(shader, &by_hand).is_err(), "a binding that is not declared");
}
