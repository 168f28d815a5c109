//! A small window for tests, drawn by the adapter.

use eframe::{
    egui_wgpu::{Renderer, RendererOptions, ScreenDescriptor},
    wgpu,
};
use egui::{Context, LayerId, Painter, Pos2, RawInput, Rect, vec2};
use std::any::Any;
use surgtpgs_render::Gpu;

/// Size of the window, pixels.
pub(super) const WINDOW: [u32; 2] = [64, 48];
pub(super) const UNORM: wgpu::TextureFormat = wgpu::TextureFormat::Rgba8Unorm;
pub(super) const SRGB: wgpu::TextureFormat = wgpu::TextureFormat::Rgba8UnormSrgb;

/// Paints the window with a shader of our own at hand; returns its pixels.
pub(super) fn painted(
    gpu: &Gpu,
    format: wgpu::TextureFormat,
    ctx: &Context,
    shader: impl Any + Send + Sync,
    paint: impl Fn(&Painter),
) -> Vec<[u8; 4]> {
    let (device, queue) = (gpu.device(), gpu.queue());
    let size = vec2(WINDOW[0] as f32, WINDOW[1] as f32);
    let input = RawInput { screen_rect: Some(Rect::from_min_size(Pos2::ZERO, size)), ..Default::default() };
    let mut output = ctx.run_ui(input, |ui| paint(&ui.ctx().layer_painter(LayerId::background())));
    let jobs = ctx.tessellate(output.shapes, 1.0);
    let mut renderer = Renderer::new(device, format, RendererOptions::default());
    for (id, deltas) in output.textures_delta.set.drain() {
        deltas.iter().for_each(|delta| renderer.update_texture(device, queue, id, delta));
    }
    output.textures_delta.clear();
    renderer.callback_resources.insert(shader);
    let screen = ScreenDescriptor { size_in_pixels: WINDOW, pixels_per_point: 1.0 };
    let extent = wgpu::Extent3d { width: WINDOW[0], height: WINDOW[1], depth_or_array_layers: 1 };
    let target = device.create_texture(&wgpu::TextureDescriptor {
        label: None,
        size: extent,
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format,
        usage: wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::COPY_SRC,
        view_formats: &[],
    });
    let bytes_per_row = 4 * WINDOW[0];
    let read = device.create_buffer(&wgpu::BufferDescriptor {
        label: None,
        size: u64::from(bytes_per_row * WINDOW[1]),
        usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
        mapped_at_creation: false,
    });
    let mut encoder = device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    renderer.update_buffers(device, queue, &mut encoder, &jobs, &screen);
    let view = target.create_view(&wgpu::TextureViewDescriptor::default());
    let pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
        color_attachments: &[Some(wgpu::RenderPassColorAttachment {
            view: &view,
            resolve_target: None,
            depth_slice: None,
            ops: wgpu::Operations {
                load: wgpu::LoadOp::Clear(wgpu::Color::TRANSPARENT),
                store: wgpu::StoreOp::Store,
            },
        })],
        ..Default::default()
    });
    renderer.render(&mut pass.forget_lifetime(), &jobs, &screen);
    let layout =
        wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(bytes_per_row), rows_per_image: None };
    let into = wgpu::TexelCopyBufferInfo { buffer: &read, layout };
    encoder.copy_texture_to_buffer(target.as_image_copy(), into, extent);
    queue.submit([encoder.finish()]);
    read.map_async(wgpu::MapMode::Read, .., |mapped| mapped.unwrap());
    device.poll(wgpu::PollType::wait_indefinitely()).unwrap();
    read.get_mapped_range(..).unwrap().chunks_exact(4).map(|pixel| pixel.try_into().unwrap()).collect()
}
