//! One entry point of a compute shader, ready to be dispatched.

use crate::{buffers::Bound, device::Gpu, shader::Shader};
use surgtpgs_core::Result;

/// A compiled entry point of one shader file.
#[derive(Debug)]
pub(crate) struct Kernel {
    pipeline: wgpu::ComputePipeline,
    layout: wgpu::BindGroupLayout,
    max_groups: u32,
}

/// A pass that is being encoded.
#[derive(Debug)]
pub(crate) struct Pass<'a> {
    commands: wgpu::ComputePass<'a>,
    /// Number of bytes that its dispatches read and write, if that is counted.
    moved: Option<&'a mut u64>,
}

impl<'a> Pass<'a> {
    /// Wraps a pass; the bytes that its dispatches read and write are added to `moved`.
    pub(crate) fn new(commands: wgpu::ComputePass<'a>, moved: Option<&'a mut u64>) -> Self {
        Self { commands, moved }
    }

    /// Begins a pass that is neither timed nor counted.
    pub(crate) fn begin(encoder: &'a mut wgpu::CommandEncoder) -> Self {
        Self::new(encoder.begin_compute_pass(&Default::default()), None)
    }
}

impl Kernel {
    /// Compiles `entry` of a shader for a latent dimension.
    pub(crate) fn new(gpu: &Gpu, shader: &Shader, entry: &str, latent_dim: usize) -> Result<Self> {
        let source = shader.wgsl(latent_dim)?;
        let device = gpu.device();
        let descriptor = wgpu::ShaderModuleDescriptor {
            label: Some(shader.file),
            source: wgpu::ShaderSource::Wgsl(source.into()),
        };
        let checks =
            wgpu::ShaderRuntimeChecks { force_loop_bounding: false, ..wgpu::ShaderRuntimeChecks::checked() };
        // SAFETY: loops that are not bounded must end by themselves. A test sees to it that all of them count up
        // to a number. Accesses are still checked.
        #[expect(unsafe_code, reason = "a bound in every loop makes passes 2 to 3.5 times slower on a H200")]
        let module = unsafe { device.create_shader_module_trusted(descriptor, checks) };
        let pipeline = device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some(entry),
            layout: None,
            module: &module,
            entry_point: Some(entry),
            compilation_options: Default::default(),
            cache: None,
        });
        let layout = pipeline.get_bind_group_layout(0);
        let max_groups = device.limits().max_compute_workgroups_per_dimension;
        Ok(Self { pipeline, layout, max_groups })
    }

    /// Adds a dispatch of `groups` workgroups in a row (folded into two dimensions if there are too
    /// many). `bindings` are those that the entry point uses, made by the functions of its `shader!`.
    pub(crate) fn dispatch(&self, gpu: &Gpu, pass: &mut Pass<'_>, bindings: &[Bound<'_>], groups: u32) {
        // If there is nothing to do, the shader finds that out, and still writes its counts.
        let groups = groups.max(1);
        let columns = groups.min(self.max_groups);
        self.dispatch_2d(gpu, pass, bindings, [columns, groups.div_ceil(columns)]);
    }

    /// Adds a dispatch of `groups` workgroups along x and y.
    pub(crate) fn dispatch_2d(
        &self,
        gpu: &Gpu,
        pass: &mut Pass<'_>,
        bindings: &[Bound<'_>],
        groups: [u32; 2],
    ) {
        let entries: Vec<wgpu::BindGroupEntry<'_>> = bindings.iter().map(|b| b.entry.clone()).collect();
        let group = gpu.device().create_bind_group(&wgpu::BindGroupDescriptor {
            label: None,
            layout: &self.layout,
            entries: &entries,
        });
        pass.commands.set_pipeline(&self.pipeline);
        pass.commands.set_bind_group(0, &group, &[]);
        pass.commands.dispatch_workgroups(groups[0], groups[1], 1);
        if let Some(moved) = &mut pass.moved {
            **moved += bindings.iter().map(|b| b.moved).sum::<u64>();
        }
    }
}

/// Submits one compute pass.
pub(crate) fn run(gpu: &Gpu, encode: impl FnOnce(&mut Pass<'_>)) {
    let mut encoder = gpu.device().create_command_encoder(&Default::default());
    encode(&mut Pass::begin(&mut encoder));
    gpu.submit(encoder);
}
