//! Shaders of `/shaders`, each with one declaration of everything that it shares with Rust: constants,
//! structs and bindings. The declaration becomes WGSL, and typed functions that bind buffers, so that the
//! two sides cannot differ. It stands in the file of the pass.

use std::fmt::Write;
use surgtpgs_core::{
    Error, Result,
    deform::{self, BasisShape},
    gaussian,
    raster::{self, sh},
};

/// Invocations per workgroup of the passes that run over rows.
pub const GROUP: u32 = 256;

/// A shader file and its declaration.
#[derive(Clone, Copy, Debug)]
pub struct Shader {
    /// Name in `/shaders`.
    pub file: &'static str,
    /// Text of the file.
    pub source: &'static str,
    /// Makes the constants that only this shader reads.
    pub constants: fn() -> Vec<(&'static str, Number)>,
    /// Bindings of group 0, in the order of their numbers.
    pub bindings: &'static [Binding],
}

/// A constant of a shader.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Number {
    /// An index or a count.
    Integer(u32),
    /// Any other number.
    Real(f32),
}

/// A variable that is bound to a buffer.
#[derive(Clone, Copy, Debug)]
pub struct Binding {
    /// Name in WGSL, and of the function that binds it.
    pub name: &'static str,
    /// Access of the shader.
    pub access: Access,
    /// Type of the value, or of each value of an array.
    pub of: Type,
}

/// Access of a shader to a bound variable.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Access {
    /// One value that all invocations read.
    Uniform,
    /// An array that is read.
    Read,
    /// An array that is read and written.
    Write,
    /// An array that is read and written by atomic operations.
    Atomic,
}

/// A type of Rust and WGSL with the same bytes in both.
#[derive(Clone, Copy, Debug)]
pub struct Type {
    /// Name in WGSL.
    pub name: &'static str,
    /// Size in bytes.
    pub size: usize,
    /// Alignment in WGSL, bytes.
    pub align: usize,
    /// Fields of a struct, in order; empty for other types.
    pub fields: &'static [Field],
}

/// A field of a struct.
#[derive(Clone, Copy, Debug)]
pub struct Field {
    /// Name in Rust and in WGSL.
    pub name: &'static str,
    /// Offset in bytes.
    pub offset: usize,
    /// Type.
    pub of: Type,
}

/// A Rust type that shaders can read.
pub trait Shared: bytemuck::Pod {
    /// The same type in WGSL.
    const TYPE: Type;
}

macro_rules! share {
    ($($rust:ty => $name:literal, $align:literal;)*) => {
        $(impl Shared for $rust {
            const TYPE: Type = Type { name: $name, size: size_of::<$rust>(), align: $align, fields: &[] };
        })*
    };
}

share! {
    f32 => "f32", 4;
    u32 => "u32", 4;
    [f32; 2] => "vec2f", 8;
    [f32; 3] => "vec3f", 16;
    [f32; 4] => "vec4f", 16;
    [u32; 2] => "vec2u", 8;
    [[f32; 4]; 2] => "array<vec4f, 2>", 16;
    [[f32; 4]; 3] => "array<vec4f, 3>", 16;
}

impl Type {
    /// Type of a Rust struct. Refuses to compile if WGSL would place a field elsewhere, or end elsewhere.
    pub(crate) const fn of_struct(name: &'static str, size: usize, fields: &'static [Field]) -> Self {
        let (mut align, mut end, mut i) = (1, 0, 0);
        while i < fields.len() {
            let Field { offset, of, .. } = fields[i];
            assert!(
                offset == end && offset.is_multiple_of(of.align),
                "WGSL places a field elsewhere: add padding"
            );
            align = if of.align > align { of.align } else { align };
            end = offset + of.size;
            i += 1;
        }
        assert!(
            size == end && size.is_multiple_of(align),
            "the struct has another size in WGSL: add padding"
        );
        Self { name, size, align, fields }
    }

    /// Type of the values of an array. Refuses to compile if WGSL would put gaps between them.
    pub(crate) const fn in_array(self) -> Self {
        assert!(self.size.is_multiple_of(self.align), "WGSL places the values of this array further apart");
        self
    }
}

/// Declares a struct that exists in Rust and in WGSL under the same name.
macro_rules! shader_struct {
    ($(#[$meta:meta])* $vis:vis struct $name:ident { $($(#[$doc:meta])* $field:ident: $of:ty,)* }) => {
        $(#[$meta])*
        #[repr(C)]
        #[derive(Clone, Copy, Debug, Default, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
        $vis struct $name { $($(#[$doc])* $vis $field: $of,)* }

        impl $name {
            const FIELDS: &'static [$crate::shader::Field] = &[$($crate::shader::Field {
                name: stringify!($field),
                offset: std::mem::offset_of!($name, $field),
                of: <$of as $crate::shader::Shared>::TYPE,
            }),*];
        }

        impl $crate::shader::Shared for $name {
            const TYPE: $crate::shader::Type =
                $crate::shader::Type::of_struct(stringify!($name), size_of::<$name>(), $name::FIELDS);
        }
    };
}

/// Declares a shader: a struct with the constant `SHADER`, and one function per binding that binds a buffer
/// of the right type. Bindings are numbered in their order:
///
/// ```text
/// shader! {
///     Wgsl = "blur.wgsl";
///     const RADIUS = RADIUS;                 u32 or f32
///     var<uniform> params: BlurParams;       one struct
///     var<read> planes: [f32];               array, also write and atomic
/// }
/// ```
macro_rules! shader {
    (
        $vis:vis $wgsl:ident = $file:literal;
        $(const $constant:ident = $value:expr;)*
        $($(#[$doc:meta])* var<$access:ident> $name:ident: $of:tt;)*
    ) => {
        #[doc = concat!("Declaration of `shaders/", $file, "`.")]
        $vis struct $wgsl;

        impl $wgsl {
            $vis const SHADER: $crate::shader::Shader = $crate::shader::Shader {
                file: $file,
                // The shaders lie outside the crate's folder, which is no fault in a crate that is never
                // published.
                source: include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/../../shaders/", $file)),
                constants: || vec![$((stringify!($constant), $value.into())),*],
                bindings: Self::BINDINGS,
            };

            const BINDINGS: &'static [$crate::shader::Binding] = &[$($crate::shader::Binding {
                name: stringify!($name),
                access: $crate::shader::shader!(@access $access),
                of: $crate::shader::shader!(@type $access $of),
            }),*];

            $($crate::shader::shader!(@bind [$(#[$doc])*] $access $name $of);)*
        }
    };
    (@access uniform) => { $crate::shader::Access::Uniform };
    (@access read) => { $crate::shader::Access::Read };
    (@access write) => { $crate::shader::Access::Write };
    (@access atomic) => { $crate::shader::Access::Atomic };
    (@type uniform $of:ident) => { <$of as $crate::shader::Shared>::TYPE };
    (@type $access:ident [$of:ty]) => { <$of as $crate::shader::Shared>::TYPE.in_array() };
    (@bind [$(#[$doc:meta])*] uniform $name:ident $of:ident) => {
        $(#[$doc])*
        fn $name(value: &$crate::buffers::Uniform<$of>) -> $crate::buffers::Bound<'_> {
            value.bound_to(const { $crate::shader::number_of(stringify!($name), Self::BINDINGS) })
        }
    };
    (@bind [$(#[$doc:meta])*] $access:ident $name:ident [$of:ty]) => {
        $(#[$doc])*
        fn $name<'a>(array: impl Into<$crate::buffers::Array<'a, $of>>) -> $crate::buffers::Bound<'a> {
            array.into().bound_to(const { $crate::shader::number_of(stringify!($name), Self::BINDINGS) })
        }
    };
}

pub(crate) use {shader, shader_struct};

/// Files that shaders import.
pub const IMPORTED: &[(&str, &str)] = &[
    ("shared/alpha.wgsl", include_str!("../../../shaders/shared/alpha.wgsl")),
    ("shared/basis.wgsl", include_str!("../../../shaders/shared/basis.wgsl")),
    ("shared/dispatch.wgsl", include_str!("../../../shaders/shared/dispatch.wgsl")),
    ("shared/num.wgsl", include_str!("../../../shaders/shared/num.wgsl")),
    ("shared/random.wgsl", include_str!("../../../shaders/shared/random.wgsl")),
    ("shared/rotation.wgsl", include_str!("../../../shaders/shared/rotation.wgsl")),
    ("shared/sh.wgsl", include_str!("../../../shaders/shared/sh.wgsl")),
    ("shared/slot.wgsl", include_str!("../../../shaders/shared/slot.wgsl")),
    ("shared/sum.wgsl", include_str!("../../../shaders/shared/sum.wgsl")),
];

impl Shader {
    /// Whole source for latent dimension D: the declaration, then the file with each `#import path` line
    /// replaced by that file, once.
    pub fn wgsl(&self, latent_dim: usize) -> Result<String> {
        let mut out = common_constants(latent_dim);
        for (name, value) in (self.constants)() {
            out.push_str(&constant(name, value));
        }
        let mut structs: Vec<&str> = Vec::new();
        for Binding { of, .. } in self.bindings {
            if !of.fields.is_empty() && !structs.contains(&of.name) {
                structs.push(of.name);
                let _ = writeln!(out, "struct {} {{", of.name);
                for Field { name, of, .. } in of.fields {
                    let _ = writeln!(out, "    {name}: {},", of.name);
                }
                out.push_str("}\n");
            }
        }
        for (number, Binding { name, access, of }) in self.bindings.iter().enumerate() {
            let (space, of) = match access {
                Access::Uniform => ("uniform", of.name.to_owned()),
                Access::Read => ("storage, read", format!("array<{}>", of.name)),
                Access::Write => ("storage, read_write", format!("array<{}>", of.name)),
                Access::Atomic => ("storage, read_write", format!("array<atomic<{}>>", of.name)),
            };
            let _ = writeln!(out, "@group(0) @binding({number}) var<{space}> {name}: {of};");
        }
        append(self.source, &mut Vec::new(), &mut out)?;
        Ok(out)
    }
}

fn append<'a>(source: &'a str, seen: &mut Vec<&'a str>, out: &mut String) -> Result<()> {
    for line in source.lines() {
        let Some(import) = line.strip_prefix("#import ") else {
            out.push_str(line);
            out.push('\n');
            continue;
        };
        let (file, source) = IMPORTED.iter().find(|(file, _)| *file == import).ok_or_else(|| {
            Error::input(format!("no shader is called {import:?}"), "Add it to `shader::IMPORTED`")
        })?;
        if !seen.contains(file) {
            seen.push(file);
            append(source, seen, out)?;
        }
    }
    Ok(())
}

/// Number of the binding with this name.
pub(crate) const fn number_of(name: &str, bindings: &[Binding]) -> u32 {
    let mut number = 0;
    while !is_same(bindings[number].name.as_bytes(), name.as_bytes()) {
        number += 1;
    }
    number as u32
}

const fn is_same(a: &[u8], b: &[u8]) -> bool {
    let mut i = 0;
    while i < a.len() && i < b.len() && a[i] == b[i] {
        i += 1;
    }
    i == a.len() && i == b.len()
}

/// Constants that all shaders can read.
fn common_constants(latent_dim: usize) -> String {
    let integers = [
        ("LATENT_DIM", latent_dim),
        ("GROUP", GROUP as usize),
        ("TILE", raster::TILE),
        ("DEPTH_PLANE", raster::DEPTH_PLANE),
        ("ALPHA_PLANE", raster::ALPHA_PLANE),
        ("FEATURE_PLANE", raster::FEATURE_PLANE),
        ("MEAN_CHANNEL", deform::MEAN_CHANNEL),
        ("ROTATION_CHANNEL", deform::ROTATION_CHANNEL),
        ("SCALE_CHANNEL", deform::SCALE_CHANNEL),
        ("COLOUR_CHANNEL", deform::COLOUR_CHANNEL),
        ("GATE_CHANNEL", deform::GATE_CHANNEL),
        ("SHAPE_QUARTIC", BasisShape::Quartic as usize),
        ("SHAPE_SPLINE", BasisShape::Spline as usize),
    ];
    let reals = [
        ("DILATION", raster::DILATION),
        ("MIN_ALPHA", raster::MIN_ALPHA),
        ("MAX_ALPHA", raster::MAX_ALPHA),
        ("MIN_TRANSMITTANCE", raster::MIN_TRANSMITTANCE),
        ("MIN_WIDTH", deform::MIN_WIDTH as f32),
        ("QUARTIC_EPSILON", deform::QUARTIC_EPSILON as f32),
        ("SH_C0", gaussian::SH_C0),
        ("SH_C1", sh::C1 as f32),
    ];
    let mut out = String::new();
    integers.iter().for_each(|(name, value)| out.push_str(&constant(name, Number::Integer(*value as u32))));
    reals.iter().for_each(|(name, value)| out.push_str(&constant(name, Number::Real(*value))));
    for (name, values) in [("SH_C2", sh::C2.as_slice()), ("SH_C3", &sh::C3)] {
        let values: Vec<String> = values.iter().map(|v| format!("{:?}f", *v as f32)).collect();
        let _ = writeln!(out, "const {name} = array<f32, {}>({});", values.len(), values.join(", "));
    }
    out
}

fn constant(name: &str, value: Number) -> String {
    match value {
        Number::Integer(value) => format!("const {name}: u32 = {value}u;\n"),
        // `{:?}` prints the shortest number that reads back as the same f32.
        Number::Real(value) => format!("const {name}: f32 = {value:?}f;\n"),
    }
}

impl From<u32> for Number {
    fn from(value: u32) -> Self {
        Self::Integer(value)
    }
}

impl From<f32> for Number {
    fn from(value: f32) -> Self {
        Self::Real(value)
    }
}

#[cfg(test)]
#[expect(dead_code, reason = "nothing is bound to the made-up shader")]
mod tests {
    use super::*;

    shader_struct! {
        /// Row of a made-up shader.
        struct Row {
            mean: [f32; 3],
            weight: f32,
        }
    }

    shader! {
        Wgsl = "scan.wgsl";
        const BLOCK = 7;
        const SHARE = 1.0 / 255.0_f32;
        var<uniform> params: Row;
        var<read> rows: [Row];
        var<atomic> counts: [u32];
    }

    #[test]
    fn a_declaration_becomes_wgsl() {
        let source = Wgsl::SHADER.wgsl(3).unwrap();
        for line in [
            "const LATENT_DIM: u32 = 3u;",
            "const BLOCK: u32 = 7u;",
            "const SHARE: f32 = 0.003921569f;",
            "struct Row {\n    mean: vec3f,\n    weight: f32,\n}",
            "@group(0) @binding(0) var<uniform> params: Row;",
            "@group(0) @binding(1) var<storage, read> rows: array<Row>;",
            "@group(0) @binding(2) var<storage, read_write> counts: array<atomic<u32>>;",
        ] {
            assert_eq!(source.matches(line).count(), 1, "{line}");
        }
        assert_eq!(number_of("counts", Wgsl::BINDINGS), 2);
    }

    #[test]
    fn a_struct_that_wgsl_would_lay_out_otherwise_does_not_compile() {
        const FIELD: Field = Field { name: "a", offset: 0, of: <[f32; 3]>::TYPE };
        let of_struct = |size, fields| std::panic::catch_unwind(|| Type::of_struct("S", size, fields));
        assert!(of_struct(16, &[FIELD, Field { name: "b", offset: 12, of: f32::TYPE }]).is_ok());
        assert!(of_struct(12, &[FIELD]).is_err(), "it has 16 bytes in WGSL");
        assert!(of_struct(32, &[FIELD, Field { name: "b", offset: 12, of: <[f32; 4]>::TYPE }]).is_err());
        assert!(std::panic::catch_unwind(|| <[f32; 3]>::TYPE.in_array()).is_err(), "16 bytes apart in WGSL");
    }

    #[test]
    fn an_import_is_resolved_once_and_an_unknown_one_is_refused_by_name() {
        let wgsl = |source| Shader { source, ..Wgsl::SHADER }.wgsl(0);
        let twice = wgsl("#import shared/num.wgsl\n#import shared/num.wgsl\n").unwrap();
        assert_eq!(twice.matches("fn is_finite").count(), 1);
        assert!(!twice.contains("#import"));
        assert!(wgsl("#import nothing.wgsl").unwrap_err().to_string().contains("nothing.wgsl"));
    }
}
