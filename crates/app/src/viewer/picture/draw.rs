//! Common to the shaders that draw into the window.

use eframe::wgpu;
use egui::PaintCallbackInfo;

/// Makes a pipeline that draws with `vertex` and another entry of a shader, over what is there. Colours are
/// premultiplied.
pub(super) fn pipeline(
    device: &wgpu::Device,
    module: &wgpu::ShaderModule,
    entry: &str,
    buffers: &[Option<wgpu::VertexBufferLayout<'_>>],
    topology: wgpu::PrimitiveTopology,
    target: wgpu::TextureFormat,
) -> wgpu::RenderPipeline {
    let compilation_options = wgpu::PipelineCompilationOptions::default;
    device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some(entry),
        layout: None,
        vertex: wgpu::VertexState {
            module,
            entry_point: Some("vertex"),
            compilation_options: compilation_options(),
            buffers,
        },
        primitive: wgpu::PrimitiveState { topology, ..Default::default() },
        depth_stencil: None,
        multisample: wgpu::MultisampleState::default(),
        fragment: Some(wgpu::FragmentState {
            module,
            entry_point: Some(entry),
            compilation_options: compilation_options(),
            targets: &[Some(wgpu::ColorTargetState {
                format: target,
                blend: Some(wgpu::BlendState::PREMULTIPLIED_ALPHA_BLENDING),
                write_mask: wgpu::ColorWrites::ALL,
            })],
        }),
        multiview_mask: None,
        cache: None,
    })
}

/// Begins to draw with a pipeline whose positions are those in the whole window.
pub(super) fn begin(
    pass: &mut wgpu::RenderPass<'static>,
    info: &PaintCallbackInfo,
    pipeline: &wgpu::RenderPipeline,
) {
    let [width, height] = info.screen_size_px.map(|n| n as f32);
    pass.set_viewport(0.0, 0.0, width, height, 0.0, 1.0);
    pass.set_pipeline(pipeline);
}
